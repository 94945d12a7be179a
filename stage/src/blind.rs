//! `flexstage blind`.

/// Options of `flexstage blind`.
#[derive(clap::Args)]
pub struct Args {}

/// Run the command.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("blind is not built yet")
}
