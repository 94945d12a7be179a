//! `flexstage identify`.

/// Options of `flexstage identify`.
#[derive(clap::Args)]
pub struct Args {}

/// Run the command.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("identify is not built yet")
}
