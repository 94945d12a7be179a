//! The generator's own nominal rig against recordings of the same rig by somebody else's simulator, and parts of it that act together.

use recording::Session;
use truth::excitation::{Drive, Experiment};
use truth::rig::Rig;
use truth::simulate::{Options, run};
use truth::world::{Lowpass, World};

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

/// A low-pass behind the gauge delays what the gauge sees of other axes too; it does not take it away.
#[test]
fn crosstalk_passes_the_low_pass_of_its_gauge() {
    let rig = Rig::handley();
    let ticks = 4000;
    let drive = |axis: usize| -> Vec<f32> {
        let volts =
            |tick: usize| 40.0 * (1.0 - (tick as f32 / 1000.0 * std::f32::consts::PI).cos());
        (0..ticks).map(|tick| if axis == 1 { volts(tick) } else { 0.0 }).collect()
    };
    let experiment = Experiment {
        name: "crosstalk".into(),
        sample_rate_hz: 1.0e4,
        settle_s: 0.0,
        start_s: 0.0,
        period_s: None,
        monitor: false,
        drive: Drive::Open((0..3).map(drive).collect()),
        seed: 7,
    };
    let read = |share: f64, lowpass: Option<Lowpass>| -> Vec<f32> {
        let mut world = World::nominal(&rig);
        world.sensor_cross[0][1] = share;
        world.axes[0].lowpass = lowpass;
        let options = Options { noise: false, ..Options::FINE };
        run(&mut world, &experiment, 0.0, options).position_um[0].clone().expect("recorded")
    };
    // The stack's own memory shows in both.
    let of_other = |lowpass: Option<Lowpass>| -> Vec<f32> {
        let (with, without) = (read(0.02, lowpass), read(0.0, lowpass));
        with.iter().zip(&without).map(|(with, without)| with - without).collect()
    };
    let plain = of_other(None);
    let peak = plain.iter().copied().fold(0.0, f32::max);
    assert!((0.1..0.3).contains(&peak), "2 % of about 9 um, found {peak} um");
    for second_order in [false, true] {
        let slow = of_other(Some(Lowpass { corner_hz: 1000.0, second_order }));
        // The filter starts at zero, the other axis where its memory put it.
        let settled = plain.iter().zip(&slow).skip(100);
        let worst = settled.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        // 0.16 ms late of a sine of 5 Hz, and steps of 0.5 nm.
        assert!(worst < 0.015 * peak, "second order {second_order}: {worst} of {peak} um");
    }
}
