//! Every effect: at zero it is not there, it grows from there without a jump, no value inside its bounds breaks the
//! simulation. That each shows the signature that its description claims is tested in `signatures_*.rs`.

mod common;

use std::f64::consts::TAU;

use common::{rms, run_from, triangle, worst};
use host_sim::effects::{self, Effect, Role, Scope};
use host_sim::rig::{Rig, Setting};
use host_sim::{Axes, Input, Output, Place, simulate};

/// Fast and slow, large and small, all axes differently.
fn probe(axis: usize, t: f64) -> f64 {
    let k = axis as f64;
    let slow = triangle(50.0 + 10.0 * k, 4.0 + k)(t);
    let step = if (0.15..0.3).contains(&t) { 60.0 } else { 0.0 };
    slow + step + 3.0 * (TAU * (90.0 + 20.0 * k) * t).sin()
}

fn probed(rig: &Rig) -> Output {
    run_from(rig, 1e4, 3.0, 0.5, probe)
}

fn place_of(effect: &dyn Effect) -> Place {
    match effect.info().scope {
        Scope::Axis => Place::Axis(1),
        Scope::Pair | Scope::ReciprocalPair => Place::Pair { on: 1, from: 2 },
    }
}

/// The nominal rig with an effect at `share` of its typical sizes.
fn with(effect: &'static dyn Effect, share: f64) -> Rig {
    let mut rig = Rig::named("handley").unwrap();
    let setting = rig.setting_mut(effect, place_of(effect));
    for (value, parameter) in setting.values.iter_mut().zip(effect.info().parameters) {
        if parameter.role == Role::Size {
            *value = if parameter.log && parameter.zero != 0.0 {
                parameter.zero * (parameter.typical / parameter.zero).powf(share)
            } else {
                parameter.zero + share * (parameter.typical - parameter.zero)
            };
        }
    }
    rig
}

#[test]
fn the_catalogue_is_that_of_the_contract() {
    let Some(path) = shared_data::find("contract.md") else { return };
    let text = std::fs::read_to_string(path).unwrap();
    let start = text.find("Effects (stage):").unwrap();
    let listed = &text[start..start + text[start..].find("The project may").unwrap()];
    // `name` `name` (stage) · ...
    let mut count = 0;
    for group in listed.split('·') {
        let stage = group[group.rfind('(').unwrap() + 1..].split(')').next().unwrap();
        for name in group.split('`').skip(1).step_by(2) {
            let effect = effects::find(name).unwrap_or_else(|| panic!("{name} is missing"));
            assert_eq!(effect.info().stage.name(), stage, "{name}");
            count += 1;
        }
    }
    assert_eq!(count, 27);
    assert_eq!(effects::catalogue().len(), 27);
}

/// The catalogue and what is outside of it.
fn all() -> impl Iterator<Item = &'static &'static dyn effects::Effect> {
    effects::catalogue().iter().chain(effects::strangers())
}

#[test]
fn descriptions_are_complete() {
    for effect in all() {
        let info = effect.info();
        let name = info.name;
        for text in [info.physics, info.source, info.revealed_by] {
            assert!(text.len() > 10, "{name}");
        }
        for other in info.confused_with {
            assert!(effects::find(other).is_some(), "{name} is confused with unknown {other}");
        }
        assert!(info.parameters.iter().any(|p| p.role == Role::Size), "{name}");
        for p in info.parameters {
            assert!(p.min < p.max && (p.min..=p.max).contains(&p.zero), "{name}.{}", p.name);
            assert!((p.min..=p.max).contains(&p.typical), "{name}.{}", p.name);
            assert!(p.role == Role::Shape || p.typical != p.zero, "{name}.{}", p.name);
            assert!(!p.log || p.min > 0.0, "{name}.{}", p.name);
        }
    }
}

#[test]
fn at_zero_the_nominal_rig_is_left_bit_identical() {
    let nominal = probed(&Rig::named("handley").unwrap());
    for effect in all() {
        let mut rig = Rig::named("handley").unwrap();
        for place in Place::all(effect.info().scope, 3) {
            let mut setting = Setting::at_zero(*effect, place);
            for (value, parameter) in setting.values.iter_mut().zip(effect.info().parameters) {
                if parameter.role == Role::Shape {
                    *value = 0.5 * (parameter.min + parameter.max);
                }
            }
            *rig.setting_mut(*effect, place) = setting;
        }
        let output = probed(&rig);
        assert_eq!(output.position_m, nominal.position_m, "{}", effect.info().name);
        assert_eq!(output.monitor_v, nominal.monitor_v, "{}", effect.info().name);
    }
}

#[test]
fn effects_grow_from_zero_without_a_jump() {
    let nominal = probed(&Rig::named("handley").unwrap());
    for effect in all() {
        let name = effect.info().name;
        let change = |share: f64| {
            let output = probed(&with(*effect, share));
            rms(&output.position_m[1], &nominal.position_m[1])
        };
        let (full, half, tiny) = (change(1.0), change(0.5), change(1.0e-6));
        assert!(full > 0.2e-9, "{name} at its typical size does {:.3} nm", full * 1e9);
        // A swinging mass switches sub-steps on: that is the only jump, of the size of the integration error.
        let jump = if name == "second-mass" { 2.0e-11 } else { 1.0e-13 };
        assert!(tiny < 1.0e-4 * full + jump, "{name} jumps by {:.6} nm", tiny * 1e9);
        if !effect.info().threshold {
            assert!((0.1..0.9).contains(&(half / full)), "{name}: half gives {:.3}", half / full);
        }
    }
}

#[test]
fn only_the_axes_it_acts_on_move() {
    let nominal = probed(&Rig::named("handley").unwrap());
    for effect in effects::catalogue() {
        let output = probed(&with(*effect, 1.0));
        let name = effect.info().name;
        assert_eq!(output.position_m[0], nominal.position_m[0], "{name}");
        let other = output.position_m[2] != nominal.position_m[2];
        assert_eq!(other, effect.info().scope == Scope::ReciprocalPair, "{name}");
        // Only what happens in front of the monitor shows in it.
        let electrical = matches!(effect.info().stage.name(), "drive" | "amplifier");
        let shows = worst(&output.monitor_v[1], &nominal.monitor_v[1]) > 1e-9;
        assert_eq!(shows, electrical, "{name}");
    }
}

#[test]
fn no_value_inside_the_bounds_breaks_the_simulation() {
    for effect in effects::catalogue() {
        let info = effect.info();
        for index in 0..info.parameters.len() {
            for extreme in [info.parameters[index].min, info.parameters[index].max] {
                let mut rig = with(*effect, 1.0);
                rig.setting_mut(*effect, place_of(*effect)).values[index] = extreme;
                rig.validate().unwrap();
                let output = run_from(&rig, 1e4, 3.0, 0.05, probe);
                let finite = output.position_m.iter().flatten().all(|x| x.is_finite());
                assert!(finite, "{}.{} = {extreme}", info.name, info.parameters[index].name);
            }
        }
    }
}

#[test]
fn axes_wanted_alone_read_the_same() {
    for effect in effects::catalogue() {
        let rig = with(*effect, 1.0);
        let channels: Vec<Vec<f64>> = (0..3)
            .map(|axis| (0..2000).map(|i| probe(axis, f64::from(i) * 1e-4)).collect())
            .collect();
        let channels: Vec<&[f64]> = channels.iter().map(Vec::as_slice).collect();
        let input = Input {
            sample_rate_hz: 1e4,
            start_s: 3.0,
            ticks: None,
            drive_v: &channels,
            monitor_v: None,
            initial: &[],
        };
        let all = simulate(&rig, &input, Axes::All).unwrap();
        let one = simulate(&rig, &input, Axes::Only(0b010)).unwrap();
        assert_eq!(one.position_m[1], all.position_m[1], "{}", effect.info().name);
        assert!(one.position_m[0].is_empty() && one.position_m[2].is_empty());
    }
}
