//! What the core's tests share: a gauge that answers the drive, and random but valid settings.
#![allow(dead_code, reason = "each test file uses its part")]

use flexstage::generator::Wave;
use flexstage::settings::{AxisSettings, MaxwellSettings, NotchSettings};
use flexstage::{
    AXES, Command, Config, Controller, Generator, Record, Sample, Settings, State, Table,
};
use proptest::prelude::*;

/// A stage that is nothing but a gain: position = drive / `volts_per_um`, one tick late.
pub struct Bench {
    pub controller: Controller,
    pub config: Config,
    pub volts_per_um: f64,
    pub drive_v: [f64; AXES],
    pub disturbance_um: f64,
    pub table: Table,
}

impl Bench {
    pub fn new(settings: &Settings, volts_per_um: f64) -> Self {
        let config = Config::build(settings).expect("valid settings");
        Self {
            controller: Controller::new(),
            config,
            volts_per_um,
            drive_v: [0.0; AXES],
            disturbance_um: 0.0,
            table: Table::EMPTY,
        }
    }
    pub fn tick(&mut self) -> Record {
        let gauge = self.codes();
        self.tick_reading(gauge)
    }
    /// What the gauges read; never at their ends.
    pub fn codes(&self) -> [i32; AXES] {
        let at = |axis: usize| self.drive_v[axis] / self.volts_per_um + self.disturbance_um;
        std::array::from_fn(|axis| self.config.gauge_code(axis, at(axis)).clamp(1_100, 64_400))
    }
    /// A tick in which the gauges read something else.
    pub fn tick_reading(&mut self, gauge: [i32; AXES]) -> Record {
        let monitor =
            std::array::from_fn(|axis| self.config.monitor_code(axis, self.drive_v[axis]));
        let sample = Sample { gauge, monitor, overrun: false };
        let record = self.controller.tick(&self.config, &self.table, &sample);
        self.drive_v = record.axes.map(|axis| axis.drive.to_f64());
        record
    }
    pub fn arm(&mut self) {
        while !self.tick().flags.is_parked() {}
        self.controller.command(&self.config, Command::Arm).expect("parked");
        while self.tick().flags.state() == State::Arming {}
        assert_eq!(self.controller.state(), State::Hold);
    }
    /// Everything that a waveform needs before its start.
    pub fn stage(&mut self, axis: u8, generator: Generator) {
        for command in generator.staging(axis) {
            self.controller.command(&self.config, command).expect("staging");
        }
    }
}

/// The same cases on every machine, and no file of past failures.
pub fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        rng_seed: prop::test_runner::RngSeed::Fixed(2026),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

/// What periodic waveforms share, anywhere in its ranges that a stage could have.
pub fn wave() -> impl Strategy<Value = Wave> {
    let times = (0.0f32..0.1, prop_oneof![Just(0.0f32), 0.01f32..0.3]);
    (-20.0f32..20.0, 0.0f32..20.0, 0.0f32..2_500.0, -1.0f32..1.0, times).prop_map(
        |(center_um, amplitude_um, frequency_hz, phase_turns, (blend_s, duration_s))| Wave {
            center_um,
            amplitude_um,
            frequency_hz,
            phase_turns,
            blend_s,
            duration_s,
        },
    )
}

/// Settings of one axis, anywhere in their ranges that a stage could have.
pub fn axis_settings() -> impl Strategy<Value = AxisSettings> {
    let stack = (1.0f32..50.0, 1.0e-7f32..5.0e-6, 1.0e6f32..1.0e8, 0.0f32..2.0, 0.0f32..500.0);
    let elements = prop::collection::vec((5.0e-6f32..1.0e-4, 0.01f32..3.0), 0..=16);
    let feedback = (0.0f32..20.0, 0.0f32..2.0e4, 0.0f32..5.0, 10.0f32..5_000.0, 0.0f32..1.0);
    let notches = prop::collection::vec((5.0f32..4_800.0, 0.01f32..2.0, 0.0f32..1.0), 0..=2);
    let rest = (0.0f32..3.0e-3, -1.0e-4f32..1.0e-4, 0.0f32..1.0e-3, any::<bool>(), 1.0f32..5_000.0);
    (stack, elements, feedback, notches, rest).prop_map(
        |(
            (t, c, k, m, b),
            elements,
            (p, i, d, corner, weight),
            notches,
            (tau, advance, delay, shape, slew),
        )| {
            let mut axis = AxisSettings::default();
            axis.stack.transformer_n_per_v = t;
            axis.stack.capacitance_f = c;
            // Stiffness over transformer ratio is a gain in V/um, below the format's 128.
            axis.stack.stiffness_n_per_m = k.min(100.0e6 * t);
            axis.mechanism.stiffness_n_per_m = 0.0;
            axis.mechanism.mass_kg = m;
            axis.mechanism.damping_n_s_per_m = b;
            axis.stack.hysteresis = elements
                .into_iter()
                .map(|(capacitance_f, limit_v)| MaxwellSettings { capacitance_f, limit_v })
                .collect();
            axis.feedback.proportional_v_per_um = p;
            axis.feedback.integral_v_per_um_s = i;
            axis.feedback.derivative_v_ms_per_um = d;
            axis.feedback.derivative_filter_hz = corner;
            axis.feedback.setpoint_weight = weight;
            axis.feedback.sensor_delay_s = delay;
            axis.feedback.notches = notches
                .into_iter()
                .map(|(frequency_hz, damping_ratio, depth)| NotchSettings {
                    frequency_hz,
                    damping_ratio,
                    depth,
                })
                .collect();
            axis.amplifier_time_constant_s = tau;
            axis.feedforward.advance_s = advance;
            axis.dac.noise_shaping = shape;
            axis.limits.slew_v_per_ms = slew;
            axis
        },
    )
}

/// Settings of all axes.
pub fn settings() -> impl Strategy<Value = Settings> {
    (axis_settings(), axis_settings(), axis_settings(), -5.0e6f32..5.0e6, any::<bool>()).prop_map(
        |(a, b, c, cross, mapped)| {
            let mut settings = Settings { axes: [a, b, c], ..Settings::default() };
            settings.cross_stiffness_n_per_m[0][1] = cross;
            settings.cross_stiffness_n_per_m[2][0] = -cross;
            if mapped {
                settings.gauge_map[0][1] = 0.25;
            }
            settings
        },
    )
}
