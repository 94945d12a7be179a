//! The telemetry viewer window: see, drive, record and probe the stage.
//!
//! [`link`] keeps a board connected and its samples in memory, on threads of its own; [`app`] lays out the window; each file
//! under `panels` draws one panel from plain data. Nothing in the drawing code waits for the board.

pub mod app;
mod clock;
pub mod link;
mod panels;
mod settings_text;
mod view;

use std::path::PathBuf;

use telemetry::Target;

pub use app::App;

/// What the window shows.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a window holds one, and it is not moved in a loop")]
pub enum Source {
    /// A board, real, emulated or virtual; it is connected again whenever it comes back.
    Board(Target),
    /// A recording (Parquet, or CSV with its rate).
    Recording {
        /// The file.
        path: PathBuf,
        /// Rate of a CSV.
        sample_rate_hz: Option<f64>,
    },
}

/// Choices of the person who opens the window.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// What to show.
    pub source: Source,
    /// Seconds of full-rate samples kept in memory.
    pub history_s: f64,
    /// Where recordings and probe sessions go.
    pub folder: PathBuf,
    /// The rig file that a diagnosis starts from; the first paper's rig when there is none.
    pub rig: Option<PathBuf>,
}

/// Open the window; returns when it is closed.
pub fn run(options: Options) -> anyhow::Result<()> {
    let native = eframe::NativeOptions {
        viewport: eframe::egui::ViewportBuilder::default()
            .with_title("flexstage")
            .with_inner_size([1600.0, 960.0])
            .with_min_inner_size([900.0, 560.0]),
        ..Default::default()
    };
    let creator: eframe::AppCreator<'_> =
        Box::new(move |context| Ok(Box::new(App::new(&context.egui_ctx, options)?)));
    eframe::run_native("flexstage", native, creator).map_err(|error| {
        anyhow::anyhow!(
            "no window can be opened ({error}): expected a display with OpenGL; on a machine without one use \
             `flexstage record`, `status` and `measure`"
        )
    })
}
