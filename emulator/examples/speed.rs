//! How fast the emulation is: three axes move, every tick is streamed. `speed ELF [SECONDS]`.

use std::hash::{DefaultHasher, Hasher};
use std::rc::Rc;

use anyhow::{Context, Result, ensure};
use emulator::bench::Bench;
use emulator::cpu::image::Image;
use emulator::time::SECOND;
use flexstage::GeneratorSettings;
use flexstage::generator::Wave;
use flexstage::link::message::Command;
use flexstage::link::{Fields, Profile};
use host_sim::Rig;

/// Time that this thread has had a processor, so that a busy machine does not count as a slow emulator.
fn processor_s() -> Result<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    Ok(text.split_whitespace().next().context("schedstat")?.parse::<f64>()? * 1.0e-9)
}

fn main() -> Result<()> {
    let mut args = std::env::args().skip(1);
    let image = Rc::new(Image::load(args.next().context("which image?")?)?);
    let whole_seconds: u64 = args.next().map_or(Ok(10), |s| s.parse())?;
    let rig = Rig::named("handley").context("rig")?;
    let mut b = Bench::handley(image, 5)?;
    b.enumerate()?;
    b.command(&Command::SetSettings(host_sim::controller_settings(&rig)))?;
    b.arm()?;
    b.start(&[
        (0, GeneratorSettings::Sine(Wave::between(1.0, 9.0, 7.0))),
        (1, GeneratorSettings::Triangle(Wave::between(2.0, 8.0, 3.0))),
        (2, GeneratorSettings::Sine(Wave::between(0.5, 10.0, 31.0))),
    ])?;
    b.stream(Fields::RECORDING, Profile::Packed)?;
    b.link.clear();
    let (from, stops, instructions) =
        (processor_s()?, b.machine.stops, b.machine.soc().instructions);
    let accesses = b.machine.soc().accesses;
    for _ in 0..whole_seconds {
        b.run_for(SECOND)?;
    }
    let spent = processor_s()? - from;
    ensure!(b.link.tally.missing == 0 && b.link.tally.bad == 0, "{:?}", b.link.tally);
    let mut hash = DefaultHasher::new();
    let soc = b.machine.soc();
    hash.write(format!("{:?} {:?}", b.link.tally, soc.triggers).as_bytes());
    let per_tick = |n: u64| n as f64 / (whole_seconds as f64 * 10_000.0);
    println!(
        "{whole_seconds} s in {spent:.3} s of one core: {:.2} x real time; per tick {:.1} instructions, {:.2} accesses, {:.2} stops; {:016x}",
        whole_seconds as f64 / spent,
        per_tick(soc.instructions - instructions),
        per_tick(soc.accesses - accesses),
        per_tick(b.machine.stops - stops),
        hash.finish(),
    );
    Ok(())
}
