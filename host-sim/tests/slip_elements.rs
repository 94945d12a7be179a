//! The quick forms of the slip elements against a slow one that looks at every element and halves its way to
//! the charge: any stack, any path, any memory.

use host_sim::stages::hysteresis::{Branch, Elements, SlipElements, WenLoop};
use proptest::prelude::*;

/// Every element looked at, and the charge found by halving: slow, and like none of them.
struct Plain {
    slopes: Vec<f64>,
    limits: Vec<f64>,
    volts: Vec<f64>,
    give: (f64, f64),
    charge_c: f64,
}

impl Plain {
    fn after(&self, drawn: f64, scale: f64) -> Vec<f64> {
        let elements = self.volts.iter().zip(&self.slopes).zip(&self.limits);
        elements
            .map(|((v, k), top)| {
                // Of dv = k dq (1 - share sgn(dq) v / top), with the mean of v before and after on the right, and less of a share on the way back.
                let back = if drawn * v < 0.0 { self.give.1 } else { 1.0 };
                let lost = 0.5 * self.give.0 * back * k * drawn.abs() / (top * scale);
                let free = (v + k * drawn - lost * v) / (1.0 + lost);
                free.clamp(-top * scale, top * scale)
            })
            .collect()
    }

    fn tick(&mut self, branch: &Branch) -> f64 {
        let error = |drawn: f64| {
            let charge = self.charge_c + drawn;
            (charge - branch.charge_at_zero_c) / branch.capacitance_f
                + self.after(drawn, branch.limit_scale).iter().sum::<f64>()
                    * (1.0 + branch.skew_per_c * charge)
                + branch.drag_v_per_c * drawn
                - branch.input_v
        };
        let (mut low, mut high) = (-1.0e-2, 1.0e-2);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if error(middle) > 0.0 { high = middle } else { low = middle }
        }
        self.volts = self.after(low, branch.limit_scale);
        self.charge_c += low;
        (self.charge_c - branch.charge_at_zero_c) / branch.capacitance_f
    }
}

/// Elements that do not give way before they slip.
const STIFF: (f64, f64) = (0.0, 1.0);

/// Elements of unlike slopes and slip charges, in no order, and a path of amplifier voltages.
fn stacks() -> impl Strategy<Value = (Vec<(f64, f64)>, Vec<f64>)> {
    let element = (1.0e3..1.0e5_f64, 1.0e-6..2.0e-4_f64);
    let path =
        proptest::collection::vec(prop_oneof![-10.0..150.0_f64, Just(40.0), 39.9..40.1_f64], 1..60);
    (proptest::collection::vec(element, 0..20), path)
}

fn branch(input_v: f64) -> Branch {
    Branch {
        charge_at_zero_c: 3.0e-6,
        capacitance_f: 2.0e-6,
        input_v,
        drag_v_per_c: 0.0,
        skew_per_c: 0.0,
        limit_scale: 1.0,
        sum_scale: 1.0,
    }
}

/// Go along a path with both and compare; a tick of the path is reached in `steps` equal steps.
fn compare(
    (parameters, path): (Vec<(f64, f64)>, Vec<f64>),
    scaled: bool,
    give: (f64, f64),
    start: impl Fn(f64, f64, usize) -> f64,
    each: impl Fn(usize, &mut Branch),
) -> Result<(), TestCaseError> {
    let (slopes, limits): (Vec<f64>, Vec<f64>) =
        parameters.iter().map(|(slope, slip)| (*slope, slope * slip)).unzip();
    let mut fast = Elements::new(&slopes, &limits, scaled, give, None);
    let volts: Vec<f64> = (0..slopes.len())
        .map(|i| start(slopes[i], limits[i], i).clamp(-limits[i], limits[i]))
        .collect();
    let mut slow = Plain { slopes, limits, volts, give, charge_c: 2.0e-6 };
    fast.set_voltages(start);
    fast.set_charge(slow.charge_c);
    let mut now = 0.0;
    let mut tick = 0;
    for target in path {
        let from: f64 = now;
        for step in 1..=5 {
            now = from + (target - from) * f64::from(step) / 5.0;
            let mut branch = branch(now);
            each(tick, &mut branch);
            tick += 1;
            // A neighbour's first guess must leave no trace.
            fast.solve(&Branch { input_v: now - 7.0, ..branch });
            let (found, wanted) = (fast.solve(&branch), slow.tick(&branch));
            fast.commit();
            prop_assert!((found - wanted).abs() < 1.0e-10, "{found} V, not {wanted} V");
            for (a, b) in fast.voltages().iter().zip(&slow.volts) {
                prop_assert!((a - b).abs() < 1.0e-9, "element at {a} V, not {b} V");
            }
            prop_assert!((fast.sum_v() - slow.volts.iter().sum::<f64>()).abs() < 1.0e-9);
        }
    }
    Ok(())
}

proptest! {
    #[test]
    fn the_ladder_finds_what_all_elements_give(stack in stacks(), swept in -3.0e-4..3.0e-4_f64, skew in -300.0..300.0_f64) {
        compare(stack.clone(), false, STIFF, |_, _, _| 0.0, |_, _| {})?;
        compare(stack.clone(), false, STIFF, |slope, _, _| slope * swept, |_, branch| branch.drag_v_per_c = 2.0e5)?;
        compare(stack, false, STIFF, |slope, _, _| slope * swept, |_, branch| branch.skew_per_c = skew)?;
    }

    #[test]
    fn zones_find_what_all_elements_give(
        stack in stacks(),
        shares in proptest::collection::vec(-1.0..1.0_f64, 20),
        scales in proptest::collection::vec(prop_oneof![Just(1.0), 0.9..1.1_f64, 0.2..2.0_f64], 300),
    ) {
        compare(stack.clone(), true, STIFF, |_, limit, i| limit * shares[i], |_, _| {})?;
        compare(stack.clone(), true, STIFF, |_, _, _| 0.0, |tick, branch| branch.limit_scale = 1.0 + 0.1 * (tick as f64 * 0.1).sin())?;
        compare(stack.clone(), true, STIFF, |_, limit, i| limit * shares[i], |tick, branch| branch.limit_scale = scales[tick])?;
        // A memory that no history leaves goes to the zones by itself.
        compare(stack, false, STIFF, |_, limit, i| limit * shares[i], |_, _| {})?;
    }
    #[test]
    fn yielding_elements_find_what_all_elements_give(
        stack in stacks(),
        share in prop_oneof![Just(1.0), 1.0e-6..1.0_f64],
        shares in proptest::collection::vec(-1.0..1.0_f64, 20),
        scales in proptest::collection::vec(prop_oneof![Just(1.0), 0.9..1.1_f64, 0.2..2.0_f64], 300),
        skew in -300.0..300.0_f64,
        recoil in prop_oneof![Just(0.0), Just(1.0), 0.0..1.0_f64],
    ) {
        let give = (share, recoil);
        compare(stack.clone(), false, give, |_, _, _| 0.0, |_, _| {})?;
        compare(stack.clone(), false, give, |_, limit, i| limit * shares[i], |_, branch| {
            branch.drag_v_per_c = 2.0e5;
            branch.skew_per_c = skew;
        })?;
        compare(stack, true, give, |_, limit, i| limit * shares[i], |tick, branch| branch.limit_scale = scales[tick])?;
    }
}

/// The loop beside the elements against its differential equation in a thousand steps a tick: `dz = dq (1 - b |z|^n)`.
#[test]
fn a_loop_of_bouc_and_wen_beside_the_elements_follows_its_equation() {
    for (exponent, recoil) in [(1.0, 1.0), (1.0, 0.0), (2.0, 0.4), (1.5, -0.3)] {
        let law = WenLoop { limit_v: 3.0, slip_c: 4.0e-5, exponent, recoil };
        let mut elements = Elements::new(&[2.0e4], &[1.0], false, STIFF, Some(law));
        let (mut held, mut z) = (0.0_f64, 0.0_f64);
        let mut worst = 0.0_f64;
        let mut least = f64::INFINITY;
        for tick in 0..20_000 {
            // Cycles that lie to one side, of two sizes.
            let phase = f64::from(tick) * std::f64::consts::TAU / 2000.0;
            let input = 40.0 * (1.0 - phase.cos()) + 8.0 * (7.0 * phase).sin();
            let before = elements.charge_c();
            elements.solve(&branch(input));
            elements.commit();
            let drawn = elements.charge_c() - before;
            held = (held + 2.0e4 * drawn).clamp(-1.0, 1.0);
            for _ in 0..1000 {
                let dz = drawn / 4.0e-5 / 1000.0;
                let bend = if dz * z < 0.0 { recoil } else { 1.0 };
                z += dz * (1.0 - bend * dz.signum() * z.signum() * z.abs().powf(exponent));
            }
            worst = worst.max((elements.sum_v() - (held + 3.0 * z)).abs());
            least = least.min(z);
        }
        println!(
            "n {exponent}, recoil {recoil}: off by {:.2} mV of 3 V at most, z from {least:.2}",
            worst * 1e3
        );
        assert!(worst < 3.0e-4, "{worst} V at n {exponent}, recoil {recoil}");
        assert!(least < -0.2, "it was never on its way back: {least}");
    }
}

/// Of exponent one it is a yielding element, which other tests know, but for the parts of a tick that it is drawn in.
#[test]
fn with_an_exponent_of_one_the_loop_is_an_element_that_yields() {
    let law = WenLoop { limit_v: 2.0, slip_c: 5.0e-5, exponent: 1.0, recoil: 0.3 };
    let mut beside = Elements::new(&[], &[], false, STIFF, Some(law));
    let mut element = Elements::new(&[4.0e4], &[2.0], false, (1.0, 0.3), None);
    let mut worst = 0.0_f64;
    for tick in 0..3000 {
        let input = branch(60.0 * (f64::from(tick) * 0.01).sin());
        let off = (beside.solve(&input) - element.solve(&input)).abs();
        worst = worst.max(off);
        beside.commit();
        element.commit();
    }
    println!("off by {:.2} uV of 2 V at most", worst * 1e6);
    assert!(worst < 3.0e-4, "{worst}");
}
