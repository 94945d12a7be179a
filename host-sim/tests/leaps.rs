//! Whole recordings, which take calm ticks at once, against the same plant a tick at a time.

mod common;

use common::{rms, run_from, triangle, worst};
use host_sim::effects::{Effect, Parameter, Role, Scope, catalogue, strangers};
use host_sim::rig::Rig;
use host_sim::{Initial, Options, Place, Plant};

/// Slow triangles with a small one on top, an edge, a hold with creep in it, and a fast end.
fn slow(axis: usize, t: f64) -> f64 {
    let large = triangle(80.0 + 5.0 * axis as f64, 1.0)(t);
    let nested = triangle(7.0, 3.0)(t);
    match t {
        _ if t < 2.0 => large + nested,
        _ if t < 4.0 => 40.0,
        _ => 40.0 + 20.0 * (t * 700.0).sin(),
    }
}

const RATE_HZ: f64 = 1.0e4;
const SECONDS: f64 = 4.2;

/// Axes that are lively in turn: one swings while the other holds, then the other way round, and at last all are slow.
fn in_turn(axis: usize, t: f64) -> f64 {
    let swings = if t < 1.5 { axis == 1 } else { t < 3.0 && axis != 1 };
    let slowly = triangle(30.0, 0.5)(t);
    if swings { slowly + 10.0 * (t * 900.0).sin() } else { slowly }
}

/// Command of an axis at a time, V.
type Drive = fn(usize, f64) -> f64;

/// Readings of every axis, a tick at a time, m.
fn tick_by_tick(rig: &Rig, drive_v: Drive) -> Vec<Vec<f64>> {
    let options = Options { sample_rate_hz: Some(RATE_HZ), noise: false, ..Options::default() };
    let mut plant = Plant::new(rig, options).unwrap();
    // At rest at the first command, as a recording begins.
    (0..rig.axes.len()).for_each(|axis| plant.set_initial(axis, Initial::default()));
    let samples = (SECONDS * RATE_HZ).round() as usize;
    let mut readings = vec![Vec::with_capacity(samples); rig.axes.len()];
    for sample in 0..samples {
        let drive: Vec<f64> =
            (0..rig.axes.len()).map(|axis| drive_v(axis, sample as f64 / RATE_HZ)).collect();
        for (axis, reading) in plant.sample().iter().zip(&mut readings) {
            reading.push(axis.sensed_m);
        }
        plant.advance(&drive);
    }
    readings
}

/// Rms and largest difference of an axis, nm.
fn off_nm(rig: &Rig, axis: usize, drive_v: Drive) -> (f64, f64) {
    let whole = run_from(rig, RATE_HZ, 0.0, SECONDS, drive_v);
    let ticks = &tick_by_tick(rig, drive_v)[axis];
    let found = &whole.position_m[axis];
    (1.0e9 * rms(found, ticks), 1.0e9 * worst(found, ticks))
}

/// The nominal rig with those sizes of an effect that are on, as large as is typical.
fn with(nominal: &Rig, effect: &'static dyn Effect, is_on: impl Fn(&Parameter) -> bool) -> Rig {
    let info = effect.info();
    let place = match info.scope {
        Scope::Axis => Place::Axis(1),
        _ => Place::Pair { on: 1, from: 2 },
    };
    let mut rig = nominal.clone();
    for p in info.parameters.iter().filter(|p| p.role == Role::Size && is_on(p)) {
        rig.set(info.name, place, p.name, p.typical).unwrap();
    }
    rig
}

#[test]
fn calm_ticks_taken_at_once_come_to_where_single_ones_do() {
    let nominal = Rig::named("handley").unwrap();
    let mut rigs = vec![("nothing".to_owned(), nominal.clone())];
    for &effect in catalogue().iter().chain(strangers()) {
        let info = effect.info();
        rigs.push((info.name.to_owned(), with(&nominal, effect, |_| true)));
        // One of the sizes may keep an axis from leaping: each by itself as well.
        for p in info.parameters.iter().filter(|p| p.role == Role::Size) {
            let rig = with(&nominal, effect, |other| other.name == p.name);
            rigs.push((format!("{} {}", info.name, p.name), rig));
        }
    }
    // What swings slowly goes tick by tick, or between the ticks of a leap it would be lost.
    let mut heavy = nominal.clone();
    heavy.set("inertia", Place::Axis(1), "added_kg", 30.0).unwrap();
    rigs.push(("a heavy inertia".to_owned(), heavy));
    // So does what rubs less the slower it goes.
    let mut creeping = nominal.clone();
    creeping.set("friction", Place::Axis(1), "coulomb_n", 5.0).unwrap();
    creeping.set("friction", Place::Axis(1), "creeping_m_per_s", 5.0e-6).unwrap();
    rigs.push(("friction that falls".to_owned(), creeping));
    // Friction sets a mass swinging that takes whole ticks.
    for (coulomb_n, presliding_m) in [(15.0, 5.5e-8), (0.7, 1.0e-7), (0.25, 1.0e-7)] {
        let mut rubs = nominal.clone();
        rubs.set("inertia", Place::Axis(1), "added_kg", 0.12).unwrap();
        rubs.set("friction", Place::Axis(1), "coulomb_n", coulomb_n).unwrap();
        rubs.set("friction", Place::Axis(1), "presliding_m", presliding_m).unwrap();
        rigs.push((format!("a mass that rubs with {coulomb_n} N"), rubs));
    }
    let mut leaping = 0;
    for (name, rig) in &rigs {
        let (rms_nm, worst_nm) = off_nm(rig, 1, slow);
        eprintln!("{name}: {rms_nm:.4} nm rms, {worst_nm:.3} nm at worst");
        // A two-hundredth of the gauges' 4 nm; on edges integrators differ by twenty times as much.
        assert!(rms_nm < 0.02 && worst_nm < 0.2, "{name}: {rms_nm} nm rms, {worst_nm} nm at worst");
        leaping += usize::from(rms_nm > 0.0);
    }
    // Leaps are seen by what they differ by: axes tied by springs alone, what goes with the current, time or speed, and slow swings take none.
    assert!(2 * leaping > rigs.len(), "{leaping} of {} differ at all", rigs.len());
}

#[test]
fn axes_that_are_tied_take_whole_ticks_where_all_are_calm() {
    let tied = |mass_on: usize, others: &[(&str, usize, &str, f64)]| {
        let mut rig = Rig::named("handley").unwrap();
        let pair = Place::Pair { on: 1, from: 2 };
        rig.set("stiffness-coupling", pair, "stiffness_n_per_m", 2.0e6).unwrap();
        rig.set("inertia", Place::Axis(mass_on), "added_kg", 0.2).unwrap();
        for &(effect, axis, parameter, value) in others {
            rig.set(effect, Place::Axis(axis), parameter, value).unwrap();
        }
        rig
    };
    let opens = [("preload-loss", 1, "lost_share", 0.5)];
    let mut three = tied(1, &[]);
    // A second spring, which pulls the other way.
    let further = Place::Pair { on: 0, from: 1 };
    three.set("stiffness-coupling", further, "stiffness_n_per_m", -2.0e6).unwrap();
    let rigs = [
        ("the mass on one", tied(1, &[])),
        ("the mass on the other", tied(2, &[])),
        ("beside a contact that opens", tied(2, &opens)),
        ("beside friction", tied(1, &[("friction", 2, "coulomb_n", 5.0)])),
        ("beside a late drive", tied(1, &[("drive-delay", 2, "delay_s", 7.3e-4)])),
        ("three of them", three),
    ];
    for (name, rig) in &rigs {
        for (axis, drive_v) in [(1, slow as Drive), (2, slow), (1, in_turn), (2, in_turn)] {
            let (rms_nm, worst_nm) = off_nm(rig, axis, drive_v);
            eprintln!("{name}, axis {}: {rms_nm:.4} nm rms, {worst_nm:.3} nm at worst", axis + 1);
            // As above; and by what they differ it is seen that they take any.
            assert!(rms_nm > 0.0 && rms_nm < 0.02, "{name}: {rms_nm} nm rms");
            assert!(worst_nm < 0.2, "{name}: {worst_nm} nm at worst");
        }
    }
    // What goes with the current of one keeps all of them to single ticks.
    let lossy = tied(1, &[("hysteresis-rate", 2, "resistance_ohm", 50.0)]);
    for axis in 1..3 {
        assert_eq!(off_nm(&lossy, axis, slow), (0.0, 0.0), "axis {}", axis + 1);
    }
}
