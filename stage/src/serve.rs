//! `flexstage serve`: offers a board on a local socket, so that commands and windows can come and go.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use telemetry::serve::{Event, serve};

use crate::board::{BoardArgs, on_interrupt};
use crate::say::say;

/// Options of `flexstage serve`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    board: BoardArgs,
    /// Where: HOST:PORT (port 0: any that is free) or unix:/PATH. Anybody who reaches it can move the stage.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7474")]
    listen: String,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    // A socket buffers seconds of a board that runs ahead, and commands would come that much too late.
    anyhow::ensure!(
        !args.board.fast,
        "serve --fast: a served board runs in real time; use --virtual --fast in the command itself"
    );
    let stop: Arc<AtomicBool> = on_interrupt()?;
    let board = telemetry::device::connect(&args.board.target()?)?;
    let name = board.name();
    let mut printed = Ok(());
    serve(board, &args.listen, &stop, &mut |event| {
        let said = match event {
            Event::Listening(address) => say!("{name}: connect with --connect {address}"),
            Event::Connected => say!("a client connected"),
            Event::Refused => say!("a second client was refused"),
            Event::Left => say!("the client left"),
        };
        // Nobody would learn the address: that ends it.
        if said.is_err() {
            stop.store(true, Ordering::Release);
            printed = said;
        }
    })?;
    printed
}
