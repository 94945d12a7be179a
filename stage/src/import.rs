//! `flexstage import`.

/// Options of `flexstage import`.
#[derive(clap::Args)]
pub struct Args {}

/// Run the command.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("import is not built yet")
}
