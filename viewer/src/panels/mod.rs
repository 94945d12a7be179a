//! One panel a file. Each draws from plain data and says what the person asked for; none talks to the board.

pub mod drive;
pub mod files;
pub mod gains;
pub mod generator;
pub mod histogram;
pub mod log;
pub mod log_axis;
pub mod measure;
pub mod probe;
pub mod response;
pub mod spectrum;
pub mod status;
pub mod timing;
pub mod traces;
pub mod xy;

use eframe::egui::Color32;

/// Colours of the three axes, distinguishable for most colour-blind people (Okabe and Ito 2008).
pub const AXIS_COLORS: [Color32; 3] = [
    Color32::from_rgb(86, 180, 233),
    Color32::from_rgb(230, 159, 0),
    Color32::from_rgb(0, 190, 130),
];

/// Something bad.
pub const BAD: Color32 = Color32::from_rgb(235, 80, 70);
/// Something to look at.
pub const WARN: Color32 = Color32::from_rgb(240, 190, 60);
/// Something good.
pub const GOOD: Color32 = Color32::from_rgb(70, 190, 110);

/// The colour of an axis, dimmed for the second trace of a pair.
pub fn axis_color(axis: usize, is_second: bool) -> Color32 {
    let color = AXIS_COLORS[axis % AXIS_COLORS.len()];
    if is_second { color.gamma_multiply(0.55) } else { color }
}
