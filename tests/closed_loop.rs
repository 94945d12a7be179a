//! The core around the plant of `host-sim`: what a person would see on the rig.

use flexstage::generator::{GeneratorSettings, Wave};
use flexstage::{Command, Settings, State};
use host_sim::closed_loop::ClosedLoop;
use host_sim::{Options, Rig, controller_settings};

/// Root mean square error of the true position of axis 1 over a second, nm.
fn track(rig: &Rig, settings: &Settings, wave: GeneratorSettings) -> f64 {
    let mut stage =
        ClosedLoop::new(rig, settings, Options { seed: 4, ..Options::default() }).unwrap();
    stage.arm().unwrap();
    stage.start(&[(0, wave), (1, wave), (2, wave)]).unwrap();
    stage.run(10_000, |_| {});
    let mut sum = 0.0;
    stage.run(10_000, |step| {
        sum += (step.record.axes[0].reference.to_f64() - step.true_um[0]).powi(2);
        assert!(step.record.flags.faults().is_empty(), "{:?}", step.record.flags.faults());
    });
    (sum / 10_000.0).sqrt() * 1.0e3
}

#[test]
fn feedforward_with_the_right_model_needs_no_feedback() {
    let rig = Rig::named("handley").unwrap();
    let mut settings = controller_settings(&rig);
    for axis in &mut settings.axes {
        axis.feedback = flexstage::settings::FeedbackSettings::default();
    }
    for wave in [
        GeneratorSettings::Triangle(Wave::between(2.0, 12.0, 1.0)),
        GeneratorSettings::Sine(Wave::between(2.0, 12.0, 100.0)),
    ] {
        let rms_nm = track(&rig, &settings, wave);
        assert!(rms_nm < 2.0, "{wave:?}: {rms_nm:.2} nm");
    }
}

#[test]
fn noise_does_not_pass_the_loop() {
    let rig = Rig::named("handley").unwrap();
    let rms_nm = track(&rig, &controller_settings(&rig), GeneratorSettings::Stop);
    assert!(rms_nm < 4.0, "at rest the stage moves by {rms_nm:.2} nm, more than its gauge's noise");
}

#[test]
fn the_loop_is_stable_with_the_resonance_off_by_a_tenth() {
    let mut rig = Rig::named("handley").unwrap();
    for axis in &mut rig.axes {
        axis.mechanism.mass_kg = 0.53;
        axis.mechanism.damping_n_s_per_m = 100.0;
    }
    let settings = controller_settings(&rig);
    for factor in [0.81, 1.0, 1.21] {
        let mut other = rig.clone();
        for axis in &mut other.axes {
            axis.mechanism.mass_kg *= factor;
        }
        let rms_nm = track(&other, &settings, GeneratorSettings::Stop);
        assert!(rms_nm < 5.0, "mass times {factor}: {rms_nm:.1} nm at rest");
    }
}

#[test]
fn disarming_at_full_stroke_returns_softly() {
    let rig = Rig::named("handley").unwrap();
    let mut stage = ClosedLoop::new(&rig, &controller_settings(&rig), Options::default()).unwrap();
    stage.arm().unwrap();
    stage.start(&[(0, GeneratorSettings::Hold { position_um: 10.0, blend_s: 0.05 })]).unwrap();
    stage.run(5_000, |_| {});
    assert_eq!(stage.controller().state(), State::Hold);
    stage.command(Command::Disarm).unwrap();
    let mut before = stage.step().true_um[0];
    let mut parked = false;
    stage.run(10_000, |step| {
        assert!((step.true_um[0] - before).abs() < 0.05, "{before} -> {}", step.true_um[0]);
        before = step.true_um[0];
        parked = step.record.flags.is_parked();
    });
    assert!(parked && before < 3.0, "{before} um");
}

#[test]
fn two_runs_are_the_same_to_the_bit() {
    let rig = Rig::named("handley").unwrap();
    let run = || {
        let mut stage =
            ClosedLoop::new(&rig, &controller_settings(&rig), Options::default()).unwrap();
        stage.arm().unwrap();
        stage.start(&[(2, GeneratorSettings::Triangle(Wave::between(1.0, 9.0, 20.0)))]).unwrap();
        let mut hash = 0u64;
        stage.run(3_000, |step| {
            for axis in step.record.axes {
                let bits =
                    (axis.drive.to_bits() as u64) << 32 | axis.position.to_bits() as u32 as u64;
                hash = (hash ^ bits).wrapping_mul(0x0100_0000_01b3);
            }
        });
        hash
    };
    assert_eq!(run(), run());
}

/// The option `dac.noise_shaping` is on because it measures better: the same rig, the same noise, 12-bit codes of 39 mV.
#[test]
fn noise_shaping_makes_the_output_finer() {
    let rig = Rig::named("handley").unwrap();
    let rest_nm = |shaping: bool| {
        let mut settings = controller_settings(&rig);
        for axis in &mut settings.axes {
            axis.dac.noise_shaping = shaping;
            // Feedback would answer the gauge's noise, which hides what the output converter does.
            axis.feedback = flexstage::settings::FeedbackSettings::default();
        }
        let mut stage = ClosedLoop::new(&rig, &settings, Options::default()).unwrap();
        stage.arm().unwrap();
        // Slow enough to pass many codes' worth of rounding: 1 um in 10 s is 7.5 V, 190 codes.
        let ramp = GeneratorSettings::Ramp { target_um: 6.0, duration_s: 10.0 };
        stage.start(&[(0, GeneratorSettings::Hold { position_um: 5.0, blend_s: 0.2 })]).unwrap();
        stage.run(5_000, |_| {});
        stage.start(&[(0, ramp)]).unwrap();
        stage.run(5_000, |_| {});
        let (mut sum, mut sum_squared, n) = (0.0, 0.0, 80_000);
        stage.run(n, |step| {
            let error_nm = (step.record.axes[0].reference.to_f64() - step.true_um[0]) * 1.0e3;
            sum += error_nm;
            sum_squared += error_nm * error_nm;
        });
        let mean = sum / n as f64;
        (sum_squared / n as f64 - mean * mean).sqrt()
    };
    let (plain, shaped) = (rest_nm(false), rest_nm(true));
    println!(
        "open loop, slow ramp: {plain:.2} nm rms with plain rounding, {shaped:.2} nm with noise shaping"
    );
    assert!(shaped < 0.5 * plain, "{plain:.2} nm plain, {shaped:.2} nm shaped");
}
