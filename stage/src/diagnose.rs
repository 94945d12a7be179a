//! `flexstage diagnose`.

/// Options of `flexstage diagnose`.
#[derive(clap::Args)]
pub struct Args {}

/// Run the command.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("diagnose is not built yet")
}
