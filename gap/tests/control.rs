//! What a controller needs, from a session of the plant that it does not know.

use std::path::PathBuf;

use flexstage::Settings;
use host_sim::closed_loop::Converters;
use host_sim::rig::Axis;
use host_sim::{Options, Place, Plant, Rig};
use recording::{Entry, Meta, Recording, Session};

const RATE_HZ: f64 = 10_000.0;

/// Name of the recording, seconds, drive (V) at a time (s).
type Waveform<'a> = (&'a str, f64, &'a dyn Fn(f64) -> f64);

/// Drive a stage through 12-bit converters: a recording a waveform, one after the other on the same stacks.
fn session(stage: &Rig, waveforms: &[Waveform]) -> Session {
    let mut settings = Settings::default();
    for axis in &mut settings.axes {
        axis.gauge.full_code = 4_095;
        axis.monitor.full_code = 4_095;
    }
    let converters = Converters::new(&settings);
    let mut plant = Plant::new(stage, Options { seed: 3, ..Options::default() }).unwrap();
    let mut start_s = 0.0;
    let recordings = waveforms
        .iter()
        .map(|(name, seconds, wave)| {
            let meta = Meta { start_s, ..Meta::new(*name, RATE_HZ) };
            let mut recording = Recording::empty(meta, 3);
            for axis in 0..3 {
                recording.monitor_v[axis] = Some(Vec::new());
                recording.position_um[axis] = Some(Vec::new());
            }
            for n in 0..(seconds * RATE_HZ) as u64 {
                let readings = plant.sample().to_vec();
                let volts = wave(n as f64 / RATE_HZ);
                let mut drive = [0.0; 3];
                recording.tick.push(n);
                for axis in 0..3 {
                    drive[axis] = converters.drive_v(axis, converters.dac_code(axis, volts));
                    recording.drive_v[axis].push(drive[axis] as f32);
                    let line = |code: i32, at_zero: f32, at_full: f32| {
                        at_zero + code as f32 * (at_full - at_zero) / 4_095.0
                    };
                    let (gauge, monitor) =
                        (&settings.axes[axis].gauge, &settings.axes[axis].monitor);
                    let position = converters.gauge_code(axis, readings[axis].sensed_m);
                    let output = converters.monitor_code(axis, readings[axis].monitor_v);
                    let position = line(position, gauge.at_zero, gauge.at_full);
                    let output = line(output, monitor.at_zero, monitor.at_full);
                    recording.position_um[axis].as_mut().unwrap().push(position);
                    recording.monitor_v[axis].as_mut().unwrap().push(output);
                }
                plant.advance(&drive);
            }
            start_s += seconds;
            let file = format!("{name}.parquet");
            Entry { path: PathBuf::from(&file), file, recording }
        })
        .collect();
    Session { recordings, ..Session::default() }
}

fn triangle(low_v: f64, high_v: f64, hz: f64) -> impl Fn(f64) -> f64 {
    move |t| {
        let phase = (t * hz).fract();
        low_v + (high_v - low_v) * (1.0 - (2.0 * phase - 1.0).abs())
    }
}

/// Tones with phases that keep the peak low (Schroeder 1970).
fn multisine(center_v: f64, amplitude_v: f64, base_hz: f64, tones: &[u32]) -> impl Fn(f64) -> f64 {
    let tones = tones.to_vec();
    move |t| {
        let n = tones.len() as f64;
        let sum: f64 = tones
            .iter()
            .enumerate()
            .map(|(k, &tone)| {
                let phase = -std::f64::consts::PI * (k * k) as f64 / n;
                (std::f64::consts::TAU * f64::from(tone) * base_hz * t + phase).cos()
            })
            .sum();
        center_v + amplitude_v * sum / n.sqrt() * (t / 0.2).min(1.0)
    }
}

/// Slow triangles of several heights, fast tones, a held step: as little as identifies everything.
fn everything(stage: &Rig) -> Session {
    let (large, medium, small) =
        (triangle(0.0, 100.0, 1.0), triangle(10.0, 75.0, 1.0), triangle(20.0, 55.0, 1.0));
    let slow = move |t: f64| {
        if t < 3.0 {
            large(t)
        } else if t < 6.0 {
            medium(t)
        } else {
            small(t)
        }
    };
    let tones: Vec<u32> = (0..16).map(|k| 2 + 13 * k).collect();
    let fast = multisine(55.0, 3.0, 10.0, &tones);
    let step = |t: f64| if t < 5.0 { 10.0 } else { 90.0 };
    session(stage, &[("a", 8.0, &slow), ("b", 2.0, &fast), ("c", 16.0, &step)])
}

fn near(what: &str, found: f64, truth: f64, tolerance: f64) {
    let off = found / truth - 1.0;
    assert!(
        off.abs() <= tolerance,
        "{what}: {found:.5e}, true {truth:.5e}, {:.1} % off",
        100.0 * off
    );
}

#[test]
fn the_different_plant_is_found() {
    let (stage, nominal) = (Rig::named("different").unwrap(), Rig::named("handley").unwrap());
    let found = gap::for_control(&nominal, &everything(&stage)).unwrap();
    assert!(found.notes.is_empty(), "{:?}", found.notes);
    for axis in 0..3 {
        let findings = found.axes[axis].as_ref().unwrap();
        println!("axis {}: {}", axis + 1, findings.line());
        let (rig, truth) = (&found.rig.axes[axis], &stage.axes[axis]);
        near("amplifier (s)", rig.amplifier.time_constant_s, truth.amplifier.time_constant_s, 0.01);
        let v_s2_per_m = |a: &Axis| a.mechanism.mass_kg / a.piezo.transformer_n_per_v;
        near("mass over transformer ratio (V s2/m)", v_s2_per_m(rig), v_s2_per_m(truth), 0.02);
        // 64 uneven, skewed, rate-dependent elements: what the 16 do not follow shows in how stiff the spring seems.
        let v_per_m = |a: &Axis| {
            (a.piezo.stiffness_n_per_m + a.mechanism.stiffness_n_per_m)
                / a.piezo.transformer_n_per_v
        };
        near("stiffness (V/m)", v_per_m(rig), v_per_m(truth), 0.07);
        // A held drive lets the slip elements take back some of the growth: a position shows less creep than the stack has.
        let creep = |rig: &Rig| rig.get("creep", Place::Axis(axis), "per_decade").unwrap();
        near("creep a decade", creep(&found.rig), creep(&stage), 0.3);
        let inverse = &findings.inverse;
        assert!(inverse.from_depoled);
        let share = inverse.held_out_v / inverse.held_out_linear_v;
        assert!(share < 0.06, "last third: model {share:.3} of the straight line");
    }
}

/// The same from the middle of a life: what the stack went through before is in no recording.
#[test]
fn memory_before_the_session_does_not_matter() {
    let stage = Rig::named("handley").unwrap();
    let mut session = everything(&stage);
    // The first recording from its second triangle on, and all by itself.
    session.recordings.truncate(1);
    let recording = &mut session.recordings[0].recording;
    let cut = 14_000;
    recording.tick.drain(..cut);
    for axis in 0..3 {
        recording.drive_v[axis].drain(..cut);
        recording.monitor_v[axis].as_mut().unwrap().drain(..cut);
        recording.position_um[axis].as_mut().unwrap().drain(..cut);
    }
    let mut believed = stage.clone();
    for axis in &mut believed.axes {
        axis.piezo.transformer_n_per_v *= 1.2;
        axis.piezo.hysteresis.limit_v.iter_mut().for_each(|v| *v *= 0.5);
    }
    let found = gap::for_control(&believed, &session).unwrap();
    let said = found.notes.join("\n");
    assert!(said.contains("no creep") && said.contains("no fast excitation"), "{said}");
    for findings in found.axes.iter().flatten() {
        println!("{}", findings.line());
        let inverse = &findings.inverse;
        assert!(!inverse.from_depoled);
        assert!(inverse.misfit_v < 0.04, "monitor noise is 0.02 V: {:.4} V", inverse.misfit_v);
        assert!(inverse.held_out_v < 0.05, "{:.4} V", inverse.held_out_v);
    }
}

#[test]
fn without_monitors_the_amplifier_stays_and_the_answer_says_so() {
    let (stage, nominal) = (Rig::named("different").unwrap(), Rig::named("handley").unwrap());
    let mut session = everything(&stage);
    for entry in &mut session.recordings {
        entry.recording.monitor_v.fill(None);
    }
    let found = gap::for_control(&nominal, &session).unwrap();
    for axis in 0..3 {
        let findings = found.axes[axis].as_ref().unwrap();
        println!("{}", findings.line());
        let said = found.notes.iter().any(|n| n.contains(&format!("monitor_v_{}", axis + 1)));
        assert!(said, "{:?}", found.notes);
        assert_eq!(found.rig.axes[axis].amplifier, nominal.axes[axis].amplifier);
        let share = findings.inverse.held_out_v / findings.inverse.held_out_linear_v;
        assert!(share < 0.06, "last third: model {share:.3} of the straight line");
    }
}

#[test]
fn a_session_without_slow_motion_is_refused() {
    let nominal = Rig::named("handley").unwrap();
    let tones: Vec<u32> = (0..16).map(|k| 2 + 13 * k).collect();
    let fast = multisine(55.0, 3.0, 10.0, &tones);
    let session = session(&nominal, &[("fast", 2.0, &fast)]);
    let error = gap::for_control(&nominal, &session).err().unwrap().to_string();
    assert!(error.contains("slow motion") && error.contains("flexstage probe"), "{error}");
}
