//! What the tick costs: instructions in all and by stage, the stack, and an upper bound in cycles.

use std::collections::BTreeMap;

use emulator::bench::Bench;
use emulator::cpu::image::is_wide;
use emulator::periph::nvic::exception::irq;
use emulator::time::{CYCLE, SECOND, TICK};
use flexstage::GeneratorSettings;
use flexstage::generator::Wave;
use flexstage::link::{Fields, Profile};
use flexstage::settings::NotchSettings;

use crate::common::{armed, image};

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

fn profile(b: &mut Bench, what: &str) -> u64 {
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
    cost.max
}

#[test]
fn the_tick_fits_its_budget() {
    let Some(image) = image() else { return };
    // Eight Maxwell elements, PD and a notch on each of three axes, every sample streamed.
    let mut b = armed(&image, 1, |s| {
        for axis in &mut s.axes {
            assert_eq!(axis.stack.hysteresis.len(), 8);
            axis.feedback.proportional_v_per_um = 1.0;
            axis.feedback.integral_v_per_um_s = 0.0;
            axis.feedback.derivative_v_ms_per_um = 0.3;
            axis.feedback.notches.clear();
            axis.feedback.notches.push(NotchSettings::default()).unwrap();
        }
    });
    b.stream(Fields::RECORDING, Profile::Packed).unwrap();
    let hold = profile(&mut b, "holding");
    let wave = |hz| GeneratorSettings::Sine(Wave::between(1.0, 9.0, hz));
    b.start(&[(0, wave(3.0)), (1, wave(7.0)), (2, wave(31.0))]).unwrap();
    let moving = profile(&mut b, "three sines");
    let worst = hold.max(moving);
    // An upper bound in cycles at 170 MHz. Assumed: code and data in CCM, no wait states (RM0440 2.2.4); at most 2 cycles for
    // an instruction on average (loads, multiplies with 64-bit results and taken branches cost 1 to 3 on a Cortex-M4, the
    // rest 1: Cortex-M4 TRM 3.3.1), 8 for each access to a peripheral (AHB2 through the bus matrix, contended by nobody but
    // the core), 12 + 17 for entry with floating-point stacking, 10 + 17 for return, twice that for a nested entry.
    let bound = 2 * worst + 40 * 8 + 2 * (29 + 27);
    println!(
        "upper bound: {bound} of {} cycles a period: {:.1} % busy",
        TICK / CYCLE,
        100.0 * bound as f64 / (TICK / CYCLE) as f64
    );
    assert!(bound < TICK / CYCLE / 2, "less than half of the period, whatever happens");
    let met = |n: u64, bar: u64| if n <= bar { "met" } else { "NOT met" };
    println!(
        "bar of 1000 instructions holding: {} ({hold}); of 2000 at worst: {} ({worst})",
        met(hold, 1_000),
        met(worst, 2_000)
    );
}

#[test]
fn the_stack_has_room() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 1, |_| {});
    b.stream(Fields::ALL, Profile::Exact).unwrap();
    b.start(&[(0, crate::common::hold(5.0))]).unwrap();
    b.run_for(SECOND / 2).unwrap();
    b.act(&flexstage::link::message::Command::Disarm).unwrap();
    b.run_for(SECOND).unwrap();
    for gain in [0.1, 0.2, 0.3, 0.4] {
        let mut s = crate::common::settings();
        s.axes[0].feedback.proportional_v_per_um = gain;
        b.command(&flexstage::link::message::Command::SetSettings(s)).unwrap();
        b.command(&flexstage::link::message::Command::Save).unwrap();
        b.command(&flexstage::link::message::Command::ReadSettings).unwrap();
    }
    let (used, room) = b.machine.stack_use().expect("stack symbols");
    let deepest = b.machine.profile().deepest;
    println!("stack: {used} of {room} bytes used; handlers nest {deepest} deep");
    assert!(room - used >= 1_024, "{} bytes free", room - used);
    let own = b.counters().unwrap().stack_free as usize;
    println!("the firmware's own count: {own} bytes free");
}
