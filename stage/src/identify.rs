//! `flexstage identify`: refit the nominal parameters of a rig to a session.

use std::path::PathBuf;

use host_sim::AnyRig;

/// Options of `flexstage identify`.
#[derive(clap::Args)]
pub struct Args {
    /// Rig file: the model as it is known.
    #[arg(long)]
    rig: PathBuf,
    /// Folder of recordings of that rig.
    session: PathBuf,
    /// Calibrated rig file to write.
    #[arg(long)]
    out: PathBuf,
    /// Sample rate of CSV recordings, Hz.
    #[arg(long)]
    sample_rate: Option<f64>,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    match AnyRig::load(&args.rig)? {
        AnyRig::Platform(rig) => {
            crate::platform::identify(&rig, &args.session, args.sample_rate, &args.out)
        }
        AnyRig::Stage(_) => anyhow::bail!("identify is not built yet for stages"),
    }
}
