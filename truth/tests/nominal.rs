//! The generator's own nominal rig against recordings of the same rig by somebody else's simulator.

use recording::Session;
use truth::excitation::{Drive, Experiment};
use truth::rig::Rig;
use truth::simulate::{Options, run};
use truth::world::World;

/// Recordings of the nominal rig (nothing is missing) differ from this generator by their noise and converter steps only.
#[test]
fn nominal_rig_agrees_with_an_independent_simulator() {
    let Some(folder) = shared_data::find("data/open/o1") else { return };
    let rig = Rig::handley();
    for entry in Session::read(folder, None).unwrap().recordings {
        let recording = entry.recording;
        if recording.meta.settle_s == 0.0 {
            continue;
        }
        let experiment = Experiment {
            name: entry.file.clone(),
            sample_rate_hz: recording.meta.sample_rate_hz,
            settle_s: recording.meta.settle_s,
            start_s: recording.meta.start_s,
            period_s: None,
            monitor: true,
            drive: Drive::Open(recording.drive_v.clone()),
            seed: 7,
        };
        let options = Options { noise: false, ..Options::FINE };
        let simulated = run(&mut World::nominal(&rig), &experiment, 0.0, options);
        let from = recording.settle_rows();
        let rms = |a: &[f32], b: &[f32]| {
            let sum: f64 =
                a[from..].iter().zip(&b[from..]).map(|(a, b)| f64::from(a - b).powi(2)).sum();
            (sum / (a.len() - from) as f64).sqrt()
        };
        for axis in 0..3 {
            let column = |r: &recording::Recording| r.position_um[axis].clone().unwrap();
            let nm = 1e3 * rms(&column(&recording), &column(&simulated));
            let monitor = |r: &recording::Recording| r.monitor_v[axis].clone().unwrap();
            let volts = rms(&monitor(&recording), &monitor(&simulated));
            println!("{} axis {}: {nm:.3} nm, {volts:.5} V", entry.file, axis + 1);
            // Noise 4.0 nm and a step of 0.5 nm; monitor 20 mV and 10 mV.
            assert!((3.9..4.1).contains(&nm), "{} axis {}: {nm} nm", entry.file, axis + 1);
            assert!(
                (0.0195..0.0215).contains(&volts),
                "{} axis {}: {volts} V",
                entry.file,
                axis + 1
            );
        }
    }
}
