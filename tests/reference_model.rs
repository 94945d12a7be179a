//! The fixed-point core against the same control law in double precision, written from the equations.

mod common;

use common::{Bench, axis_settings, cases};
use flexstage::generator::{GeneratorSettings, Wave};
use flexstage::settings::{AxisSettings, CreepSettings};
use flexstage::{Command, Generator, Settings};
use proptest::prelude::*;

const T: f64 = 1.0e-4;

/// Second-order notch in double precision: poles and zeros by the bilinear transform, direct form I.
struct Notch {
    b: [f64; 3],
    a: [f64; 2],
    x: [f64; 2],
    y: [f64; 2],
}

impl Notch {
    fn new(hz: f64, damping: f64, depth: f64) -> Self {
        let w = std::f64::consts::TAU * hz * T;
        let alpha = damping * w.sin();
        let n = 1.0 + alpha;
        Self {
            b: [(1.0 + depth * alpha) / n, -2.0 * w.cos() / n, (1.0 - depth * alpha) / n],
            a: [-2.0 * w.cos() / n, (1.0 - alpha) / n],
            x: [0.0; 2],
            y: [0.0; 2],
        }
    }
    fn step(&mut self, x: f64) -> f64 {
        let y = self.b[0] * x + self.b[1] * self.x[0] + self.b[2] * self.x[1]
            - self.a[0] * self.y[0]
            - self.a[1] * self.y[1];
        self.x = [x, self.x[0]];
        self.y = [y, self.y[0]];
        y
    }
}

/// One axis of the control law.
struct Model {
    s: AxisSettings,
    /// From the other two axes, N/m.
    cross_n_per_m: [f64; 2],
    crept_um: Vec<f64>,
    elastic_uc: Vec<f64>,
    charge_uc: f64,
    stack_v: f64,
    integral_v: f64,
    derivative_v: f64,
    weighted_um: f64,
    notches: Vec<Notch>,
    bump_v: f64,
    bump_ticks: f64,
    n: f64,
    first: bool,
}

impl Model {
    fn new(s: &AxisSettings, cross_n_per_m: [f64; 2], arming_s: f64) -> Self {
        Self {
            s: s.clone(),
            cross_n_per_m,
            crept_um: vec![0.0; s.feedforward.creep.len()],
            elastic_uc: vec![0.0; s.stack.hysteresis.len()],
            charge_uc: 0.0,
            stack_v: 0.0,
            integral_v: 0.0,
            derivative_v: 0.0,
            weighted_um: 0.0,
            notches: s
                .feedback
                .notches
                .iter()
                .map(|n| Notch::new(n.frequency_hz.into(), n.damping_ratio.into(), n.depth.into()))
                .collect(),
            bump_v: 0.0,
            bump_ticks: arming_s / T,
            n: 0.0,
            first: true,
        }
    }

    /// Drive without limits. `reference`: x(n-1) to x(n+3), um. `others_um`: where the other axes will be at n+2.
    fn step(
        &mut self,
        reference: [f64; 5],
        others_um: [f64; 2],
        position_um: f64,
        drive_before_v: f64,
    ) -> f64 {
        let s = &self.s;
        let [before, now, x1, x2, x3] = reference;
        let (t, ff, fb) = (f64::from(s.stack.transformer_n_per_v), &s.feedforward, &s.feedback);
        // um, s: velocity in um/s, acceleration in um/s^2; 1e-6 turns um into m.
        let (v, a) = ((x3 - x1) / 2.0 / T, (x3 - 2.0 * x2 + x1) / T / T);
        let lead = f64::from(ff.advance_s);
        let (k, b, m) = (
            f64::from(s.stack.stiffness_n_per_m) + f64::from(s.mechanism.stiffness_n_per_m),
            f64::from(s.stack.damping_n_s_per_m) + f64::from(s.mechanism.damping_n_s_per_m),
            f64::from(s.stack.mass_kg) + f64::from(s.mechanism.mass_kg),
        );
        let wanted = x2 - f64::from(s.origin_um);
        // What creeps does so by itself. In a hundred ticks of the first axis the elements have the first ones, one each.
        let x2 = wanted - self.crept_um.iter().sum::<f64>();
        let turn = (self.n as usize + 1) % 100;
        if let (Some(crept), Some(element)) = (self.crept_um.get_mut(turn), ff.creep.get(turn)) {
            let share = 1.0 - (-100.0 * T / f64::from(element.time_constant_s)).exp();
            *crept += share * (f64::from(element.gain) * x2 - *crept);
        }
        let stiffness = k * (x2 + lead * v + 0.5 * lead * lead * a);
        let [next, after_next] = self.cross_n_per_m;
        let cross = next * others_um[0] + after_next * others_um[1];
        let force = stiffness + b * (v + lead * a) + m * a + cross;
        let transducer = force * 1.0e-6 / t;
        let charge = t * x2 + f64::from(s.stack.capacitance_f) * 1.0e6 * transducer;
        if self.first {
            self.charge_uc = charge;
        }
        let mut stack = transducer;
        for (e, element) in self.elastic_uc.iter_mut().zip(&s.stack.hysteresis) {
            let (c, limit) = (f64::from(element.capacitance_f) * 1.0e6, f64::from(element.limit_v));
            *e = (*e + charge - self.charge_uc).clamp(-c * limit, c * limit);
            stack += *e / c;
        }
        self.charge_uc = charge;
        if self.first {
            self.stack_v = stack;
        }
        let tau = f64::from(s.amplifier_time_constant_s);
        let p = if tau > 0.0 { (-T / tau).exp() } else { 0.0 };
        let forward = stack + p / (1.0 - p) * (stack - self.stack_v);
        self.stack_v = stack;

        let delayed = now - f64::from(fb.sensor_delay_s) / T * (now - before);
        let error = delayed - position_um;
        let limit = f64::from(fb.integral_limit_v);
        self.integral_v =
            (self.integral_v + f64::from(fb.integral_v_per_um_s) * T * error).clamp(-limit, limit);
        let weighted = f64::from(fb.setpoint_weight) * delayed - position_um;
        if self.first {
            self.weighted_um = weighted;
        }
        let pole = (-std::f64::consts::TAU * f64::from(fb.derivative_filter_hz) * T).exp();
        let rate = (weighted - self.weighted_um) / (T * 1.0e3);
        self.weighted_um = weighted;
        self.derivative_v =
            pole * self.derivative_v + (1.0 - pole) * f64::from(fb.derivative_v_ms_per_um) * rate;
        let mut back =
            f64::from(fb.proportional_v_per_um) * error + self.integral_v + self.derivative_v;
        for notch in &mut self.notches {
            back = notch.step(back);
        }

        let wanted = forward + back;
        if self.first {
            self.bump_v = drive_before_v - wanted;
        }
        self.first = false;
        self.n += 1.0;
        wanted + self.bump_v * (1.0 - self.n / self.bump_ticks).max(0.0)
    }
}

/// Largest difference of the drives over 0.4 s of a sine, as long as no limit acts.
fn difference(axis: &AxisSettings, cross_n_per_m: [f32; 2], sine: Wave, wobble_um: f64) -> f64 {
    let mut axis = axis.clone();
    // Limits have their own tests.
    axis.limits.min_v = -200.0;
    axis.limits.max_v = 400.0;
    axis.limits.slew_v_per_ms = 5_000.0;
    axis.limits.following_error_um = 0.0;
    axis.limits.travel_margin_um = 0.0;
    let mut settings = Settings::uniform(axis.clone());
    settings.cross_stiffness_n_per_m[0][1..].copy_from_slice(&cross_n_per_m);
    settings.guard.stuck_drive_v = 0.0;
    settings.guard.max_step_um = 0.0;
    settings.guard.return_v_per_ms = 1.0;
    settings.guard.arming_s = 0.02;
    let mut bench = Bench::new(&settings, 8.0);
    for _ in 0..10 {
        bench.tick();
    }
    bench.controller.command(&bench.config, Command::Arm).unwrap();
    let mut drives = vec![bench.drive_v[0]];
    let mut records = Vec::new();
    for n in 0..4_000 {
        if n == 300 {
            // Each axis at its own speed.
            for (axis, ratio) in [(0, 1.0), (1, 0.7), (2, 0.4)] {
                let wave = Wave { frequency_hz: ratio * sine.frequency_hz, ..sine };
                let generator = Generator::build(&GeneratorSettings::Sine(wave)).unwrap();
                bench.stage(axis, generator);
            }
            bench.controller.command(&bench.config, Command::Start { axes: 7 }).unwrap();
        }
        // What is measured has nothing to do with the drive: the law is compared, not a loop.
        bench.drive_v[0] = 8.0 * (2.0 + wobble_um * (n as f64 * 0.01).sin());
        records.push(bench.tick());
        drives.push(bench.drive_v[0]);
    }
    let x = |n: usize| records[n].axes[0].reference.to_f64();
    let origin = f64::from(axis.origin_um);
    let other = |n: usize, axis: usize| records[n].axes[axis].reference.to_f64() - origin;
    let mut model = Model::new(&axis, cross_n_per_m.map(f64::from), 0.02);
    let mut worst = 0.0f64;
    for n in 0..records.len() - 3 {
        let before = if n == 0 { x(0) } else { x(n - 1) };
        let position = records[n].axes[0].position.to_f64();
        let reference = [before, x(n), x(n + 1), x(n + 2), x(n + 3)];
        let others = [other(n + 2, 1), other(n + 2, 2)];
        let exact = model.step(reference, others, position, drives[0]);
        if !(-199.0..399.0).contains(&exact) || !records[n].flags.state().is_active() {
            break;
        }
        worst = worst.max((drives[n + 1] - exact).abs());
    }
    worst
}

proptest! {
    #![proptest_config(cases(64))]

    #[test]
    fn fixed_point_follows_double_precision(
        mut axis in axis_settings(),
        hz in 0.5f32..200.0,
        high_um in 3.0f32..12.0,
        wobble_um in 0.0f64..0.5,
        creep in prop::collection::vec((0.0f32..0.05, 0.05f32..2_000.0), 0..=5),
        cross in prop_oneof![Just([0.0f32; 2]), [-5.0e6f32..5.0e6, -5.0e6f32..5.0e6]],
        origin_um in -5.0f32..5.0,
    ) {
        axis.origin_um = origin_um;
        axis.feedforward.creep = creep
            .into_iter()
            .map(|(gain, time_constant_s)| CreepSettings { gain, time_constant_s })
            .collect();
        // High gains at the edge of a format's resolution are not what precision means here.
        axis.feedback.integral_v_per_um_s = axis.feedback.integral_v_per_um_s.min(5_000.0);
        axis.feedback.derivative_v_ms_per_um = axis.feedback.derivative_v_ms_per_um.min(1.0);
        for notch in &mut axis.feedback.notches {
            notch.frequency_hz = notch.frequency_hz.max(50.0);
        }
        // Voltages and charges beyond 512 V and 512 uC saturate, as they should; the law is compared below that.
        let stack = &mut axis.stack;
        stack.transformer_n_per_v = stack.transformer_n_per_v.min(15.0);
        stack.capacitance_f = stack.capacitance_f.min(1.0e-6);
        stack.stiffness_n_per_m = stack.stiffness_n_per_m.min(20.0e6 * stack.transformer_n_per_v);
        let worst = difference(&axis, cross, Wave::between(2.0, high_um, hz), wobble_um);
        prop_assert!(worst < 5.0e-3, "{:.3} mV", worst * 1.0e3);
    }
}

#[test]
fn the_first_papers_rig_is_followed_to_tens_of_microvolts() {
    let mut axis = AxisSettings::default();
    axis.feedback.proportional_v_per_um = 2.0;
    axis.feedback.integral_v_per_um_s = 4_000.0;
    axis.feedback.derivative_v_ms_per_um = 0.2;
    let _ = axis.feedback.notches.push(flexstage::settings::NotchSettings::default());
    let worst = difference(&axis, [0.0; 2], Wave::between(2.0, 12.0, 10.0), 0.002);
    assert!(worst < 1.0e-4, "{:.3} mV", worst * 1.0e3);
}
