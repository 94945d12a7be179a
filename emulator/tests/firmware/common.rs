//! The image under test, and small helpers.

use std::rc::Rc;

use emulator::bench::Bench;
use emulator::cpu::image::Image;
use flexstage::link::message::Command;
use flexstage::{GeneratorSettings, Settings};
use host_sim::Rig;

/// The image, or `None` when the test has to be skipped.
pub fn image() -> Option<Rc<Image>> {
    let Some(path) = std::env::var_os("FLEXSTAGE_FIRMWARE_ELF") else {
        shared_data::skip("FLEXSTAGE_FIRMWARE_ELF names no image: run `cargo xtask test`");
        return None;
    };
    Some(Rc::new(Image::load(path).expect("firmware image")))
}

/// The rig of the first paper.
pub fn rig() -> Rig {
    Rig::named("handley").expect("rig handley")
}

/// The settings that suit it.
pub fn settings() -> Settings {
    host_sim::controller_settings(&rig())
}

/// A booted board with an enumerated device.
pub fn bench(image: &Rc<Image>, seed: u64) -> Bench {
    let mut bench = Bench::handley(image.clone(), seed).expect("bench");
    bench.enumerate().expect("enumeration");
    bench
}

/// A booted board that runs its loop with the rig's settings and streams nothing yet.
pub fn armed(image: &Rc<Image>, seed: u64, change: impl FnOnce(&mut Settings)) -> Bench {
    let mut bench = bench(image, seed);
    let mut settings = settings();
    change(&mut settings);
    bench.command(&Command::SetSettings(settings)).expect("settings");
    bench.arm().expect("armed");
    bench
}

/// Go to a position with a soft start.
pub fn hold(position_um: f32) -> GeneratorSettings {
    GeneratorSettings::Hold { position_um, blend_s: 0.1 }
}
