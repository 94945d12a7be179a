//! What the controller learns about an unknown stage: a session of open-loop recordings in, a rig out.
//!
//! The session (33 s, all axes at once, through the same 12-bit converters as the control) is what a person would record: slow
//! triangles and a slow multisine, a multisine to 2 kHz, a step that is held. What is made of it is
//! `flexstage identify --for-control` ([`gap::control`]), nothing else.

use std::path::PathBuf;

use flexstage::generator::{GeneratorSettings, Multisine, Wave};
use flexstage::settings::AxisSettings;
use flexstage::{AXES, Settings};
use gap::ForControl;
use host_sim::closed_loop::{ClosedLoop, Converters};
use host_sim::{Options, Rig};
use recording::{Entry, Meta, Recording, Session};

const RATE_HZ: f64 = 10_000.0;
/// Open loop: reference in um times this is the drive.
const VOLTS_PER_UM: f32 = 10.0;

/// Identify a stage from a session of recordings. `nominal` is the rig as believed before; of `stage` only drives, monitors
/// and gauges are seen.
pub fn identify(stage: &Rig, nominal: &Rig, seed: u64) -> anyhow::Result<ForControl> {
    Ok(gap::for_control(nominal, &record(stage, seed)?)?)
}

/// Settings of the hardware that `bench` uses for unknown stages: 12-bit converters.
pub fn coarse_converters(settings: &mut Settings) {
    for axis in &mut settings.axes {
        axis.gauge.full_code = 4_095;
        axis.monitor.full_code = 4_095;
    }
}

fn record(stage: &Rig, seed: u64) -> anyhow::Result<Session> {
    let mut settings = Settings::uniform(AxisSettings::open_loop(VOLTS_PER_UM));
    coarse_converters(&mut settings);
    let converters = Converters::new(&settings);
    let mut bench = ClosedLoop::new(stage, &settings, Options { seed, ..Options::default() })?;
    bench.arm()?;
    let tones = |center_um, peak_um, base_hz, first, stride, tones, seed| {
        GeneratorSettings::Multisine(Multisine {
            center_um,
            peak_um,
            base_hz,
            first,
            stride,
            tones,
            seed,
            blend_s: 0.2,
            duration_s: 0.0,
        })
    };
    let triangle = |low, high| GeneratorSettings::Triangle(Wave::between(low, high, 1.0));
    let hold = |position_um, blend_s| GeneratorSettings::Hold { position_um, blend_s };
    let slow = [
        (triangle(0.0, 11.0), 3.0),
        (triangle(1.0, 8.0), 2.0),
        (triangle(2.0, 6.0), 2.0),
        (tones(6.0, 5.5, 0.25, 1, 1, 8, 5), 8.0),
    ];
    let fast = [(tones(6.0, 0.8, 10.0, 2, 13, 16, 9), 2.0)];
    let held = [(hold(1.0, 0.05), 6.0), (hold(10.0, 0.02), 12.0)];
    let mut latched = bench.step().record.axes.map(|axis| axis.dac);
    let mut start_s = 0.0;
    let mut recordings = Vec::new();
    for (experiment, waves) in [("slow", &slow[..]), ("fast", &fast), ("held", &held)] {
        let meta = Meta { start_s, rig: stage.name.clone(), ..Meta::new(experiment, RATE_HZ) };
        let mut recording = Recording::empty(meta, AXES);
        let mut columns: [[Vec<f32>; 2]; AXES] = Default::default();
        for (wave, seconds) in waves {
            bench.start(&[(0, *wave), (1, *wave), (2, *wave)])?;
            bench.run((seconds * RATE_HZ) as u64, |step| {
                recording.tick.push(recording.tick.len() as u64);
                for (axis, record) in step.record.axes.iter().enumerate() {
                    // The codes of a tick act from the next one on: what acts now was decided in the tick before.
                    let drive_v = converters.drive_v(axis, latched[axis]);
                    recording.drive_v[axis].push(drive_v as f32);
                    columns[axis][0].push(record.monitor.to_f64() as f32);
                    columns[axis][1].push(record.position.to_f64() as f32);
                }
                latched = step.record.axes.map(|axis| axis.dac);
            });
        }
        start_s += recording.len() as f64 / RATE_HZ;
        for (axis, [monitor_v, position_um]) in columns.into_iter().enumerate() {
            recording.monitor_v[axis] = Some(monitor_v);
            recording.position_um[axis] = Some(position_um);
        }
        let file = format!("{experiment}.parquet");
        recordings.push(Entry { path: PathBuf::from(&file), file, recording });
    }
    Ok(Session { recordings, ..Session::default() })
}
