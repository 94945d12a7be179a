//! What the tick costs: instructions in all and by stage, the stack, and an upper bound in cycles.

use std::collections::BTreeMap;
use std::rc::Rc;

use emulator::bench::Bench;
use emulator::cpu::image::{Image, is_wide};
use emulator::periph::nvic::exception::irq;
use emulator::time::{CYCLE, MILLISECOND, SECOND, TICK};
use flexstage::generator::{Multisine, Wave};
use flexstage::link::message::Command;
use flexstage::link::{Fields, Profile};
use flexstage::settings::{AxisSettings, CreepSettings, NotchSettings};
use flexstage::{GeneratorSettings, MAX_CREEP, Settings};

use crate::common::{armed, bench, image, settings};

const ADC3: u32 = 47;

/// Where an instruction comes from: the outermost file below the tick that is a stage of the control core.
fn stage(files: &[String]) -> String {
    const STAGES: [&str; 10] = [
        "generator",
        "trajectory",
        "feedforward",
        "hysteresis",
        "creep",
        "feedback",
        "filter",
        "guard",
        "record",
        "controller",
    ];
    // Frames come innermost first: the innermost stage that is not the controller itself names the work.
    let name = |f: &String| f.rsplit('/').next().unwrap_or("").trim_end_matches(".rs").to_owned();
    let names: Vec<String> = files.iter().map(name).collect();
    let found = names.iter().find(|n| STAGES[..9].contains(&n.as_str()));
    found
        .or_else(|| names.iter().rev().find(|n| *n == "controller"))
        .or(names.last())
        .cloned()
        .unwrap_or_else(|| "?".into())
}

/// Instructions of the dearest tick of a second, and on average.
fn profile(b: &mut Bench, what: &str) -> (u64, f64) {
    b.machine.profile().clear();
    b.machine.profile().watched = Some(irq(ADC3));
    b.run_for(SECOND).unwrap();
    b.machine.profile().watched = None;
    let cost = b.machine.profile().costs[&irq(ADC3)];
    println!(
        "{what}: {} to {} instructions a tick, mean {:.1}; {:.2} us at most at one cycle each",
        cost.min,
        cost.max,
        cost.mean(),
        cost.longest as f64 / CYCLE as f64 / 170.0
    );
    let loader = addr2line::Loader::new(&b.machine.image().path).expect("debug information");
    let blocks = b.machine.profile().blocks.clone();
    if let Some(path) = std::env::var_os("FLEXSTAGE_BLOCKS") {
        // Start, bytes and executions of every block, for a look at the disassembly beside it.
        let mut rows: Vec<_> = blocks.iter().collect();
        rows.sort();
        let text: String =
            rows.iter().map(|((at, size), n)| format!("{at:08x} {size} {n}\n")).collect();
        std::fs::write(path, text).unwrap();
    }
    let mut by_stage: BTreeMap<String, f64> = BTreeMap::new();
    let mut by_function: BTreeMap<String, f64> = BTreeMap::new();
    for ((address, size), times) in blocks {
        let mut code = vec![0; size as usize];
        b.machine.read_memory(address, &mut code).unwrap();
        let mut at = 0;
        while at < size as usize {
            let wide = is_wide(u16::from_le_bytes([code[at], code[at + 1]]));
            let (mut files, mut function) = (Vec::new(), String::new());
            let mut frames = loader.find_frames((address as usize + at) as u64).expect("frames");
            while let Ok(Some(frame)) = frames.next() {
                if let Some(location) = frame.location {
                    let file = location.file.unwrap_or("?").to_owned();
                    if function.is_empty()
                        && !file.contains("/rustc/")
                        && !file.contains("registry")
                    {
                        function = format!(
                            "{}:{}",
                            file.rsplit('/').next().unwrap_or(""),
                            location.line.unwrap_or(0)
                        );
                    }
                    files.push(file);
                }
            }
            *by_stage.entry(stage(&files)).or_default() += times as f64;
            *by_function.entry(function).or_default() += times as f64;
            at += if wide { 4 } else { 2 };
        }
    }
    let ticks = cost.count as f64;
    let mut rows: Vec<_> = by_stage.into_iter().map(|(s, n)| (n / ticks, s)).collect();
    rows.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (n, stage) in &rows {
        println!("  {n:8.1}  {stage}");
    }
    let mut lines: Vec<_> = by_function.into_iter().map(|(s, n)| (n / ticks, s)).collect();
    lines.sort_by(|a, b| b.0.total_cmp(&a.0));
    let top: Vec<String> = lines.iter().take(24).map(|(n, f)| format!("{f} {n:.0}")).collect();
    println!("  dearest lines: {}", top.join(", "));
    (cost.max, cost.mean())
}

/// Eight Maxwell elements, PD and a notch on each axis.
fn full(settings: &mut Settings) {
    for axis in &mut settings.axes {
        assert_eq!(axis.stack.hysteresis.len(), 8);
        axis.feedback.proportional_v_per_um = 1.0;
        axis.feedback.integral_v_per_um_s = 0.0;
        axis.feedback.derivative_v_ms_per_um = 0.3;
        axis.feedback.notches.clear();
        axis.feedback.notches.push(NotchSettings::default()).unwrap();
    }
}

/// The dearest tick while `act` goes on.
fn dearest(b: &mut Bench, what: &str, act: impl FnOnce(&mut Bench)) -> u64 {
    b.machine.profile().clear();
    b.machine.profile().traced = Some(irq(ADC3));
    act(b);
    b.machine.profile().traced = None;
    let most = b.machine.profile().costs[&irq(ADC3)].max;
    println!("{what}: {most} instructions in the dearest tick");
    print_around(&b.machine.profile().runs);
    most
}

/// The dearest run and what came before and after it.
fn print_around(runs: &[u64]) {
    if let Some((n, _)) = runs.iter().enumerate().max_by_key(|(_, cost)| **cost) {
        println!("  around it: {:?}", &runs[n.saturating_sub(8)..runs.len().min(n + 9)]);
    }
}

/// So many sets of settings, one after the other.
fn exchange(b: &mut Bench, settings: &mut Settings, change: impl Fn(&mut AxisSettings, u32)) {
    for k in 1..=20 {
        settings.axes.iter_mut().for_each(|axis| change(axis, k));
        b.command(&Command::SetSettings(settings.clone())).unwrap();
    }
}

/// Other gains.
fn gains(axis: &mut AxisSettings, k: u32) {
    axis.feedback.proportional_v_per_um = 1.0 - 0.01 * k as f32;
}

/// Another model of the stack: every slip element is another one.
fn model(axis: &mut AxisSettings, k: u32) {
    for element in &mut axis.stack.hysteresis {
        element.limit_v *= if k.is_multiple_of(2) { 1.01 } else { 0.99 };
    }
}

/// Sixteen tones between the same positions as the sines; all axes alike, so that they turn in the same ticks.
fn multisine() -> GeneratorSettings {
    GeneratorSettings::Multisine(Multisine {
        center_um: 5.0,
        peak_um: 4.0,
        base_hz: 1.0,
        first: 3,
        stride: 7,
        tones: 16,
        seed: 7,
        blend_s: 0.01,
        duration_s: 0.0,
    })
}

#[test]
fn the_tick_fits_its_budget() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 1);
    let mut settings = settings();
    full(&mut settings);
    b.command(&Command::SetSettings(settings.clone())).unwrap();
    // Every sample is streamed throughout.
    b.stream(Fields::RECORDING, Profile::Packed).unwrap();
    let closing = dearest(&mut b, "the loop closes", |b| {
        b.arm().unwrap();
    });
    let (hold, _) = profile(&mut b, "holding");
    let wave = |hz| GeneratorSettings::Sine(Wave::between(1.0, 9.0, hz));
    let starting = dearest(&mut b, "three sines begin", |b| {
        b.start(&[(0, wave(3.0)), (1, wave(7.0)), (2, wave(31.0))]).unwrap();
        b.run_for(50 * MILLISECOND).unwrap();
    });
    let (moving, mean_sines) = profile(&mut b, "three sines");
    let other_gains = dearest(&mut b, "other gains while they run", |b| {
        exchange(b, &mut settings, gains);
    });
    let other_model = dearest(&mut b, "another model of all stacks while they run", |b| {
        exchange(b, &mut settings, model);
    });
    let starting_tones = dearest(&mut b, "three multisines begin", |b| {
        b.start(&[(0, multisine()), (1, multisine()), (2, multisine())]).unwrap();
        b.run_for(50 * MILLISECOND).unwrap();
    });
    let (tones, mean_tones) = profile(&mut b, "three multisines of 16 tones");
    let tones_staging = dearest(&mut b, "staging three more while they run", |b| {
        for axis in [0, 1, 2] {
            b.command(&Command::Stage { axis, generator: multisine() }).unwrap();
        }
    });
    let tones_model = dearest(&mut b, "another model of all stacks while they run", |b| {
        exchange(b, &mut settings, model);
    });
    let disarming = dearest(&mut b, "the loop opens", |b| {
        b.act(&Command::Disarm).unwrap();
        b.run_for(50 * MILLISECOND).unwrap();
    });
    let sines = [hold, closing, starting, moving, other_gains, other_model];
    let worst = sines.into_iter().max().unwrap();
    let tones_worst = [starting_tones, tones, tones_staging, tones_model, disarming];
    let worst_tones = tones_worst.into_iter().max().unwrap();
    let (squares, squares_of_sixteen) = squares(&image);
    let everything = everything(&image);
    // An upper bound in cycles at 170 MHz. Assumed: code and data in CCM, no wait states (RM0440 2.2.4); at most 2 cycles for
    // an instruction on average (loads, multiplies with 64-bit results and taken branches cost 1 to 3 on a Cortex-M4, the
    // rest 1: Cortex-M4 TRM 3.3.1), 8 for each access to a peripheral (AHB2 through the bus matrix, contended by nobody but
    // the core), 12 + 17 for entry with floating-point stacking, 10 + 17 for return, twice that for a nested entry.
    let dearest = [worst, worst_tones, squares, squares_of_sixteen, everything];
    let bound = 2 * dearest.into_iter().max().unwrap() + 40 * 8 + 2 * (29 + 27);
    println!(
        "upper bound: {bound} of {} cycles a period: {:.1} % busy",
        TICK / CYCLE,
        100.0 * bound as f64 / (TICK / CYCLE) as f64
    );
    assert!(bound < TICK / CYCLE / 2, "less than half of the period, whatever happens");
    assert!(hold <= 1_000, "{hold} instructions holding");
    assert!(mean_sines <= 1_456.0, "{mean_sines} instructions with three sines");
    assert!(worst <= 2_000, "{worst} instructions at worst");
    assert!(mean_tones <= 1_700.0, "{mean_tones} instructions with multisines");
    assert!(worst_tones <= 2_000, "{worst_tones} instructions at worst with multisines");
    assert!(squares <= 2_000, "{squares} instructions when all slips at once");
    // More than the budget is for.
    assert!(squares_of_sixteen <= 2_300, "{squares_of_sixteen} instructions with 16 elements");
    assert!(everything <= 2_400, "{everything} instructions with everything there is");
}

/// All that the settings allow at once, which is more than the budget is for: multisines on all axes, a gauge map, coupled axes, creep,
/// integral action, two notches, a sensor's delay; other models in motion.
fn everything(image: &Rc<Image>) -> u64 {
    let mut b = bench(image, 1);
    let mut settings = settings();
    full(&mut settings);
    settings.gauge_map[0][1] = 0.01;
    settings.cross_stiffness_n_per_m[0][1] = 1.0e3;
    for axis in &mut settings.axes {
        axis.feedback.integral_v_per_um_s = 20.0;
        axis.feedback.sensor_delay_s = 1.0e-5;
        axis.feedback.notches.push(NotchSettings::default()).unwrap();
        for _ in 0..MAX_CREEP {
            let creep = CreepSettings { gain: 0.01, time_constant_s: 10.0 };
            axis.feedforward.creep.push(creep).unwrap();
        }
    }
    b.command(&Command::SetSettings(settings.clone())).unwrap();
    b.stream(Fields::RECORDING, Profile::Packed).unwrap();
    b.arm().unwrap();
    let all = [(0, multisine()), (1, multisine()), (2, multisine())];
    let moving = dearest(&mut b, "three multisines, and everything there is", |b| {
        b.start(&all).unwrap();
        b.run_for(SECOND).unwrap();
    });
    let model = dearest(&mut b, "another model of all stacks while they run", |b| {
        exchange(b, &mut settings, model);
    });
    moving.max(model)
}

/// Elements that slip and turn in one tick, on all axes: squares whose edges pass all of them within a tick or two, of equal and of unequal
/// phases, with 8 and with 16 elements; of each the dearest.
fn squares(image: &Rc<Image>) -> (u64, u64) {
    let mut most = (0, 0);
    for (elements, slope_um_per_ms) in
        [(8, 10.0), (8, 30.0), (8, 100.0), (16, 10.0), (16, 30.0), (16, 100.0)]
    {
        let mut b = bench(image, 1);
        let mut settings = settings();
        full(&mut settings);
        for axis in &mut settings.axes {
            axis.limits.following_error_um = 0.0;
            while axis.stack.hysteresis.len() < elements {
                let element = axis.stack.hysteresis[axis.stack.hysteresis.len() - 8].clone();
                axis.stack.hysteresis.push(element).unwrap();
            }
            for (n, element) in axis.stack.hysteresis.iter_mut().enumerate() {
                element.limit_v *= 8.0 / elements as f32 * (1.0 + 0.01 * n as f32);
            }
        }
        b.command(&Command::SetSettings(settings.clone())).unwrap();
        b.stream(Fields::RECORDING, Profile::Packed).unwrap();
        b.arm().unwrap();
        let square =
            |hz| GeneratorSettings::Square { wave: Wave::between(1.0, 9.0, hz), slope_um_per_ms };
        let what = format!("three squares of {slope_um_per_ms} um/ms, {elements} elements");
        let moving = dearest(&mut b, &what, |b| {
            b.start(&[(0, square(47.0)), (1, square(47.0)), (2, square(47.0))]).unwrap();
            b.run_for(SECOND / 2).unwrap();
        });
        let model = dearest(&mut b, "another model of all stacks while they run", |b| {
            exchange(b, &mut settings, model);
        });
        let most = if elements == 8 { &mut most.0 } else { &mut most.1 };
        *most = (*most).max(moving).max(model);
    }
    most
}

#[test]
fn the_stack_has_room() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 1, |_| {});
    b.stream(Fields::ALL, Profile::Exact).unwrap();
    b.start(&[(0, crate::common::hold(5.0))]).unwrap();
    b.run_for(SECOND / 2).unwrap();
    b.act(&Command::Disarm).unwrap();
    b.run_for(SECOND).unwrap();
    for gain in [0.1, 0.2, 0.3, 0.4] {
        let mut s = crate::common::settings();
        s.axes[0].feedback.proportional_v_per_um = gain;
        b.command(&Command::SetSettings(s)).unwrap();
        b.command(&Command::Save).unwrap();
        b.command(&Command::ReadSettings).unwrap();
    }
    let (used, room) = b.machine.stack_use().expect("stack symbols");
    let deepest = b.machine.profile().deepest;
    println!("stack: {used} of {room} bytes used; handlers nest {deepest} deep");
    assert!(room - used >= 1_024, "{} bytes free", room - used);
    let own = b.counters().unwrap().stack_free as usize;
    println!("the firmware's own count: {own} bytes free");
}
