//! The window alone, against the virtual board: `cargo run --release -p viewer --example virtual_board`.

fn main() -> anyhow::Result<()> {
    let board = telemetry::virtual_board::Options::default();
    viewer::run(viewer::Options {
        source: viewer::Source::Board(telemetry::Target::Virtual(board)),
        history_s: 620.0,
        folder: "recordings".into(),
        rig: None,
    })
}
