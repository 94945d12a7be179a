//! `replay`, `identify` and `diagnose` on recordings that this project did not make: an independent simulator's and
//! public measurements. Skipped in one line where they are not at hand.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use host_sim::{AnyRig, Rig};
use recording::{Recording, Session};

/// Run the program; what it prints.
fn flexstage(arguments: &[&str]) -> String {
    let ran = Command::new(env!("CARGO_BIN_EXE_flexstage")).args(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success(), "{arguments:?}: {said}");
    String::from_utf8(ran.stdout).unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn replayed(rig: &Path, recording: &Path, out: &Path) -> Recording {
    flexstage(&["replay", "--rig", text(rig), text(recording), "--out", text(out)]);
    Recording::read(out).unwrap()
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(sum, n), v| (sum + v * v, n + 1.0));
    (sum / n).sqrt()
}

/// The nominal recordings differ from their replay by the noise that their rig file states, and by nothing else.
#[test]
fn nominal_recordings_are_replayed_to_the_noise() {
    let Some(folder) = shared_data::find("data/open/o1") else { return };
    let out = tempfile::tempdir().unwrap();
    let rig = folder.join("rig.toml");
    let AnyRig::Stage(model) = AnyRig::load(&rig).unwrap() else { panic!("a stage expected") };
    let session = Session::read(&folder, None).unwrap();
    assert!(session.recordings.len() >= 10);
    let (mut energy, mut samples) = (0.0, 0.0);
    for entry in &session.recordings {
        let predicted = replayed(&rig, &entry.path, &out.path().join("p.parquet"));
        assert_eq!(predicted.tick, entry.recording.tick);
        assert_eq!(predicted.drive_v, entry.recording.drive_v);
        let from = entry.recording.settle_rows();
        for axis in 0..3 {
            let sensor = &model.axes[axis].sensor;
            let noise_nm = 1.0e9 * sensor.noise_rms_m.hypot(sensor.resolution_m / 12f64.sqrt());
            let measured = entry.recording.position_um[axis].as_ref().unwrap();
            let simulated = predicted.position_um[axis].as_ref().unwrap();
            // Without a settling part the memory of the stack is unknown to everybody: a constant displacement at rest.
            let known = entry.recording.meta.settle_s > 0.0;
            let error = || {
                measured[from..]
                    .iter()
                    .zip(&simulated[from..])
                    .map(|(m, s)| 1.0e3 * f64::from(m - s))
            };
            let n = (measured.len() - from) as f64;
            let (rms_nm, mean_nm) = (rms(error()), error().sum::<f64>() / n);
            if !known {
                assert!(
                    entry.recording.drive_v.iter().flatten().all(|v| *v == 0.0),
                    "{}",
                    entry.file
                );
                continue;
            }
            // Four standard errors of a root mean square and of a mean over n samples.
            assert!(
                (rms_nm / noise_nm - 1.0).abs() < 4.0 / (2.0 * n).sqrt(),
                "{} axis {}: {rms_nm:.3} nm, noise {noise_nm:.3} nm",
                entry.file,
                axis + 1
            );
            assert!(mean_nm.abs() < 4.0 * noise_nm / n.sqrt(), "{}: {mean_nm:.3} nm", entry.file);
            energy += rms_nm * rms_nm * n;
            samples += n;
            let monitor = model.axes[axis].monitor.as_ref().unwrap();
            let noise_v = monitor.noise_rms_v.hypot(monitor.resolution_v / 12f64.sqrt());
            let measured = entry.recording.monitor_v[axis].as_ref().unwrap();
            let simulated = predicted.monitor_v[axis].as_ref().unwrap();
            let rms_v =
                rms(measured[from..].iter().zip(&simulated[from..]).map(|(m, s)| f64::from(m - s)));
            assert!(
                (rms_v / noise_v - 1.0).abs() < 4.0 / (2.0 * n).sqrt(),
                "{}: {rms_v} V",
                entry.file
            );
        }
    }
    println!("o1: {:.3} nm rms over {samples} samples", (energy / samples).sqrt());
}

/// Numbers followed by `nm` in a line.
fn nanometres(line: &str) -> Vec<f64> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let follows = words.windows(2).filter(|pair| pair[1].starts_with("nm"));
    follows.map(|pair| pair[0].parse().unwrap()).collect()
}

/// A measured micromanipulator: the slip elements leave a fraction of what a straight line does, on its last third.
#[test]
fn hysteresis_of_the_measured_micromanipulator() {
    let Some(session) = shared_data::find("data/real/micromanipulator") else { return };
    let Some(rig) = shared_data::find("rigs/micromanipulator.toml") else { return };
    let out = tempfile::tempdir().unwrap();
    let calibrated = out.path().join("c.toml");
    let said =
        flexstage(&["identify", "--rig", text(&rig), text(&session), "--out", text(&calibrated)]);
    let line = |start: &str| {
        said.lines()
            .find(|line| line.starts_with(start))
            .unwrap_or_else(|| panic!("{start} in {said}"))
    };
    let held = nanometres(line("last third"))[1];
    let linear = nanometres(line("the same third"))[0];
    println!("micromanipulator, last third: slip elements {held} nm, linear {linear} nm");
    // A linear model of a hysteretic stack errs by its loop, some 10 % of the stroke; published inverse models leave a fifth.
    assert!(held < 0.25 * linear, "{held} nm against {linear} nm");
    let AnyRig::Stage(rig) = AnyRig::load(&calibrated).unwrap() else { panic!("a stage expected") };
    assert!(!rig.axes[0].piezo.hysteresis.limit_v.is_empty());
}

/// A measured steering mirror: gains and cross terms below 200 Hz, where the relation is static.
#[test]
fn cross_terms_of_the_measured_mirror() {
    let Some(session) = shared_data::find("data/real/fsm") else { return };
    let Some(rig) = shared_data::find("rigs/fsm-independent.toml") else { return };
    let out = tempfile::tempdir().unwrap();
    let calibrated = out.path().join("c.toml");
    flexstage(&["identify", "--rig", text(&rig), text(&session), "--out", text(&calibrated)]);
    // What docs/real-data.md says: all nine gains within 4 % of those read off the recordings.
    if let Some(read_off) = shared_data::find("rigs/fsm.toml") {
        let (found, read_off) = (Rig::load(&calibrated).unwrap(), Rig::load(&read_off).unwrap());
        let (found, read_off) = (gains(&found), gains(&read_off));
        assert_eq!((found.len(), read_off.len()), (9, 9));
        let off = found.iter().zip(&read_off).map(|(f, r)| (f / r - 1.0).abs()).fold(0.0, f64::max);
        println!("fsm, nine gains: {:.1} % off at most", 100.0 * off);
        assert!(off < 0.04, "{found:?} {read_off:?}");
    }
    let (before, after) = (below_200_hz(&rig, &session), below_200_hz(&calibrated, &session));
    println!("fsm, 300 mV, below 200 Hz: {:.1} % -> {:.1} %", 100.0 * before, 100.0 * after);
    assert!((0.80..0.90).contains(&before), "{before}");
    // 86 % falls to 15 % by a static cross term on this data, as those who measured it report.
    assert!(after < 0.15, "{after}");
}

/// Static gains of every sensor (rows) to every drive.
fn gains(rig: &Rig) -> Vec<f64> {
    let map = rig.output_map.as_ref().unwrap();
    map.iter().flatten().copied().collect()
}

/// Relative error of the 300 mV recordings over the lines up to 200 Hz.
fn below_200_hz(rig: &Path, session: &Path) -> f64 {
    let out = tempfile::tempdir().unwrap();
    let (mut error, mut signal) = (0.0, 0.0);
    for entry in Session::read(session, None).unwrap().recordings {
        if !entry.file.contains("300mv") {
            continue;
        }
        let predicted = replayed(rig, &entry.path, &out.path().join("p.parquet"));
        let from = entry.recording.settle_rows();
        let rate = entry.recording.meta.sample_rate_hz;
        for axis in 0..3 {
            let measured = &entry.recording.position_um[axis].as_ref().unwrap()[from..];
            let simulated = &predicted.position_um[axis].as_ref().unwrap()[from..];
            let n = measured.len();
            for bin in 1..=(200.0 * n as f64 / rate) as usize {
                let line = |x: &dyn Fn(usize) -> f64| {
                    let step = TAU * bin as f64 / n as f64;
                    (0..n).fold((0.0, 0.0), |(re, im), i| {
                        let (sin, cos) = (step * i as f64).sin_cos();
                        (re + x(i) * cos, im + x(i) * sin)
                    })
                };
                let power = |(re, im): (f64, f64)| re * re + im * im;
                signal += power(line(&|i| f64::from(measured[i])));
                error += power(line(&|i| f64::from(measured[i]) - f64::from(simulated[i])));
            }
        }
    }
    assert!(signal > 0.0, "no 300 mV recording");
    (error / signal).sqrt()
}

/// The second paper's return, recorded by a simulator of other people: named, closed to the noise, dampers within 2 %.
#[test]
fn the_platform_has_a_second_mass() {
    let Some(session) = shared_data::find("data/platform") else { return };
    let Some(rig) = shared_data::find("rigs/belfiore-planar.toml") else { return };
    let out = tempfile::tempdir().unwrap();
    let answer = out.path().join("answer");
    let start = Instant::now();
    let said =
        flexstage(&["diagnose", "--rig", text(&rig), text(&session), "--out", text(&answer)]);
    let seconds = start.elapsed().as_secs_f64();
    assert!(said.contains("second-mass") && said.contains("viscoelasticity"), "{said}");
    let json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(answer.join("diagnosis.json")).unwrap())
            .unwrap();
    let gap = |key: &str| json["gap"][key].as_f64().unwrap();
    println!(
        "platform: one mass {:.0} nm, two {:.0} nm, noise {:.0} nm, {seconds:.1} s",
        gap("before_nm"),
        gap("after_nm"),
        gap("floor_nm")
    );
    assert!(gap("before_nm") > 3.0 * gap("after_nm") && gap("after_nm") < 1.05 * gap("floor_nm"));
    assert_eq!(json["verdict"], "explained");
    let AnyRig::Platform(found) = AnyRig::load(&answer.join("rig.toml")).unwrap() else {
        panic!("a platform expected")
    };
    // The recording was made with these.
    for (mass, damper) in found.masses.iter().zip([9_600.0, 1_440.0]) {
        assert!((mass.damping_n_s_per_m / damper - 1.0).abs() < 0.02, "{}", mass.damping_n_s_per_m);
    }
    let html = std::fs::read_to_string(answer.join("report.html")).unwrap();
    for word in ["<svg", "second-mass", "Where in time", "Mass of mass 1"] {
        assert!(html.contains(word), "{word}");
    }
    let recording: PathBuf = session.join("planar-1.43mm.parquet");
    let measured = Recording::read(&recording).unwrap();
    let predicted = replayed(&answer.join("rig.toml"), &recording, &out.path().join("p.parquet"));
    let (m, p) =
        (measured.position_um[0].as_ref().unwrap(), predicted.position_um[0].as_ref().unwrap());
    let left_nm = 1.0e3 * rms(m.iter().zip(p).map(|(m, p)| f64::from(m - p)));
    assert!(left_nm < 1.05 * gap("floor_nm"), "{left_nm}");
}
