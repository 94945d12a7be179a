//! `flexstage replay`.

/// Options of `flexstage replay`.
#[derive(clap::Args)]
pub struct Args {}

/// Run the command.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("replay is not built yet")
}
