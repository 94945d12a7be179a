//! Time for a simulated tick of one axis with each effect of the catalogue at its typical size:
//! `cargo run --release -p host-sim --example effect_speed [RIG.toml]`, on the paper's rig where none is given.
//!
//! What a diagnosis costs is nearly all simulation, and it simulates every effect.

use std::time::Instant;

use host_sim::effects::{Role, Scope, catalogue, strangers};
use host_sim::{Axes, Input, Place, Rig, simulate};

const RATE_HZ: f64 = 10_000.0;
const SAMPLES: usize = 40_000;
const TURNS: usize = 7;

/// Slow triangles, a few fast sines, and edges.
fn drive_v() -> Vec<f64> {
    let at = |n: usize| {
        let t = n as f64 / RATE_HZ;
        let triangle = 60.0 * (2.0 * (t - t.floor()) - 1.0).abs();
        let tones =
            [13.0, 71.0, 190.0, 420.0].map(|hz: f64| (std::f64::consts::TAU * hz * t).sin());
        let edges = if t > 3.0 && ((t * 20.0) as usize).is_multiple_of(2) { 10.0 } else { 0.0 };
        15.0 + triangle + 2.0 * tones.iter().sum::<f64>() + edges
    };
    (0..SAMPLES).map(at).collect()
}

fn main() {
    let nominal = match std::env::args_os().nth(1) {
        Some(path) => Rig::load(path.as_ref()).unwrap_or_else(|error| panic!("{error}")),
        None => Rig::named("handley").expect("an embedded rig"),
    };
    let drive = drive_v();
    let drives = vec![drive.as_slice(); nominal.axes.len()];
    let mut rigs = vec![("nothing".to_owned(), nominal.clone())];
    for effect in catalogue().iter().chain(strangers()) {
        let info = effect.info();
        let place = match info.scope {
            Scope::Axis => Place::Axis(0),
            _ => Place::Pair { on: 0, from: 1 },
        };
        let mut whole = nominal.clone();
        for p in info.parameters {
            whole.set(info.name, place, p.name, p.typical).expect("a typical value");
        }
        rigs.push((info.name.to_owned(), whole));
        // Each size by itself: most rigs have one of them.
        let sizes: Vec<_> = info.parameters.iter().filter(|p| p.role == Role::Size).collect();
        for size in sizes.iter().filter(|_| sizes.len() > 1) {
            let mut rig = nominal.clone();
            for p in info.parameters {
                let is_on = p.role == Role::Shape || p.name == size.name;
                let value = if is_on { p.typical } else { p.zero };
                rig.set(info.name, place, p.name, value).expect("a typical value");
            }
            rigs.push((format!("{} {}", info.name, size.name), rig));
        }
    }
    // Relaxation times that spread: what a diagnosis tries.
    let mut spread = nominal.clone();
    for (parameter, value) in [("branch_n_per_m", 5.0e5), ("spread_decades", 0.5)] {
        spread.set("viscoelasticity", Place::Axis(0), parameter, value).expect("in its bounds");
    }
    rigs.push(("viscoelasticity spread_decades".to_owned(), spread));
    // Elements that give way, a continuum of them: what loops come to in a diagnosis, and on a mechanism that swings.
    let loops = [("yield", 0.3), ("spread", 0.5)];
    let mut soft = nominal.clone();
    for (parameter, value) in loops {
        soft.set("hysteresis-shape", Place::Axis(0), parameter, value).expect("in its bounds");
    }
    rigs.push(("hysteresis-shape yield and spread".to_owned(), soft.clone()));
    soft.set("inertia", Place::Axis(0), "added_kg", 0.1).expect("in its bounds");
    rigs.push(("hysteresis-shape yield and spread, inertia".to_owned(), soft));
    // A mass on one of two axes that a spring ties together: both go in the parts of a tick that it asks for.
    let mut tied = nominal.clone();
    let pair = Place::Pair { on: 0, from: 1 };
    tied.set("stiffness-coupling", pair, "stiffness_n_per_m", 2.0e5).expect("in its bounds");
    tied.set("inertia", Place::Axis(0), "added_kg", 0.1).expect("in its bounds");
    rigs.push(("stiffness-coupling, inertia".to_owned(), tied));
    // Contacts that slip one after the other.
    let mut slips = nominal.clone();
    for (parameter, value) in [("coulomb_n", 5.0), ("corner", 0.9), ("spread_decades", 1.5)] {
        slips.set("friction", Place::Axis(0), parameter, value).expect("in its bounds");
    }
    rigs.push(("friction spread_decades".to_owned(), slips));
    // A series loss whose voltage goes with a power of the current.
    let mut power = nominal.clone();
    for (parameter, value) in [("resistance_ohm", 50.0), ("loss_exponent", 0.5)] {
        power.set("hysteresis-rate", Place::Axis(0), parameter, value).expect("in its bounds");
    }
    rigs.push(("hysteresis-rate resistance_ohm of a power".to_owned(), power));
    let mut ns = vec![f64::INFINITY; rigs.len()];
    for _ in 0..TURNS {
        for ((name, rig), best) in rigs.iter().zip(&mut ns) {
            let input = Input {
                sample_rate_hz: RATE_HZ,
                start_s: 0.0,
                ticks: None,
                drive_v: &drives,
                monitor_v: None,
                initial: &[],
            };
            let start = Instant::now();
            let output = simulate(rig, &input, Axes::Only(1)).expect(name);
            assert_eq!(output.position_m[0].len(), SAMPLES);
            *best = best.min(start.elapsed().as_nanos() as f64 / SAMPLES as f64);
        }
    }
    println!("quickest of {TURNS}, ns a tick of one axis (two where axes are coupled)");
    for ((name, _), ns) in rigs.iter().zip(&ns) {
        println!("{ns:>8.0} {name}");
    }
}
