//! `cargo xtask emulate`: boots the firmware against a rig and serves its USB endpoints.

use std::path::PathBuf;
use std::rc::Rc;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use clap::Parser;
use emulator::bench::Bench;
use emulator::cpu::Event;
use emulator::cpu::image::Image;
use emulator::faults::ScheduledFault;
use emulator::server::{IN, Request, Server};
use emulator::time::{MILLISECOND, Time, from_seconds, milliseconds, seconds};
use host_sim::{Options, Rig};

/// Runs the flashed firmware image against a simulated rig.
#[derive(Parser)]
#[command(name = "cargo xtask emulate")]
struct Cli {
    /// The firmware, as `cargo xtask firmware` built it.
    #[arg(long)]
    elf: PathBuf,
    /// The rig on the board: a TOML file or the name of a built-in one.
    #[arg(long, default_value = "handley")]
    rig: String,
    /// Stop after so many emulated seconds; without it, run until interrupted (with --listen) or for 1 s.
    #[arg(long)]
    seconds: Option<f64>,
    /// Serve the device's bulk endpoints here: HOST:PORT or unix:/PATH.
    #[arg(long)]
    listen: Option<String>,
    /// Emulated seconds in a second of wall clock, or "max". A client that does not keep up stalls the board's USB
    /// as a busy computer does; with "max" the board's time waits for it instead.
    #[arg(long, default_value = "1")]
    speed: String,
    /// Seed of the rig's noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Something that breaks: KIND:AXIS@FROM or KIND:AXIS@FROM-TO, times in emulated seconds, as gauge-open:2@20-25;
    /// gauge-open, gauge-short, gauge-stuck, gauge-noisy, pushed, amplifier-dead, amplifier-railed or monitor-off. May be
    /// given several times.
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<ScheduledFault>,
}

fn main() -> Result<()> {
    let mut cli = Cli::parse();
    let speed = match cli.speed.as_str() {
        "max" => None,
        s => match s.parse::<f64>() {
            Ok(v) if v > 0.0 => Some(v),
            _ => bail!("--speed {s}: expected a positive number or \"max\""),
        },
    };
    let rig = match Rig::named(&cli.rig) {
        Some(rig) => rig,
        None => Rig::load(cli.rig.as_ref())?,
    };
    let image = Rc::new(Image::load(&cli.elf)?);
    println!(
        "firmware {}: {:.1} KiB of flash; rig {}",
        cli.elf.display(),
        image.flash_bytes() as f64 / 1024.0,
        rig.name
    );
    let settings = host_sim::controller_settings(&rig);
    let mut bench =
        Bench::new(image, &rig, &settings, Options { seed: cli.seed, ..Options::default() })?;
    bench.machine.rtt.echo = true;
    let server = cli.listen.as_deref().map(Server::listen).transpose()?;
    let end = match (cli.seconds, &server) {
        (Some(s), _) => from_seconds(s),
        (None, Some(_)) => Time::MAX,
        (None, None) => from_seconds(1.0),
    };
    let started = Instant::now();
    match &server {
        Some(server) => {
            println!("serving the board's USB endpoints on {}", server.address);
            serve(&mut bench, server, end, speed, &mut cli.faults)?;
        }
        None => {
            while bench.now() < end {
                cli.faults.iter_mut().for_each(|fault| fault.follow(&bench));
                bench.run_for(MILLISECOND.min(end - bench.now()))?;
            }
        }
    }
    summary(&bench, started.elapsed());
    Ok(())
}

/// Runs until `end`, moving transfers between the device and the client.
fn serve(
    bench: &mut Bench,
    server: &Server,
    end: Time,
    speed: Option<f64>,
    faults: &mut [ScheduledFault],
) -> Result<()> {
    let started = Instant::now();
    bench.machine.soc_mut().stack.set_reading(false, 0);
    let mut connected = false;
    let mut greeted = false;
    let mut held: Option<Vec<u8>> = None;
    while bench.now() < end {
        while let Some(request) = server.request() {
            let now = bench.now();
            let stack = &mut bench.machine.soc_mut().stack;
            match request {
                Request::Connected => connected = true,
                Request::Out(bytes) => {
                    stack.send(bytes);
                }
                Request::Reset => {
                    stack.host.reset(now);
                    greeted = false;
                }
                Request::Closed => {
                    (connected, greeted, held) = (false, false, None);
                    stack.set_reading(false, now);
                }
            }
        }
        faults.iter_mut().for_each(|fault| fault.follow(bench));
        let event = bench.machine.run_for(MILLISECOND)?;
        let now = bench.now();
        if event != Event::Time {
            println!("{:11.3} ms {event:?}", milliseconds(now));
        }
        match event {
            Event::Bootloader => {
                server.detach("the board is in its DFU loader");
                return Ok(());
            }
            Event::Reset(_) if greeted => {
                server.detach("the board restarted");
                (connected, greeted) = (false, false);
            }
            _ => {}
        }
        let stack = &mut bench.machine.soc_mut().stack;
        if connected
            && !greeted
            && let Some(device) = stack.device().cloned()
        {
            server.hello(&device);
            greeted = true;
            stack.received.clear();
        }
        loop {
            let next = held.take().or_else(|| {
                bench.machine.soc_mut().stack.received.pop_front().map(|(_, bytes)| bytes)
            });
            let Some(bytes) = next else { break };
            if greeted && let Err(back) = server.send(IN, bytes, speed.is_none()) {
                held = Some(back);
                break;
            }
        }
        // A client whose queue is full gets no more tokens until it has read.
        let stack = &mut bench.machine.soc_mut().stack;
        stack.reading = greeted;
        stack.host.stall(held.is_some() || stack.received.len() > 4);
        if let Some(speed) = speed {
            let ahead = seconds(bench.now()) / speed - started.elapsed().as_secs_f64();
            if ahead > 0.0 {
                std::thread::sleep(Duration::from_secs_f64(ahead));
            }
        }
    }
    server.detach("the emulation ended");
    // The writing thread still has the farewell to send.
    std::thread::sleep(Duration::from_millis(50));
    Ok(())
}

fn summary(bench: &Bench, wall: Duration) {
    let m = &bench.machine;
    let soc = m.soc();
    for (at, line) in &soc.stack.log {
        println!("usb {:11.3} ms {line}", milliseconds(*at));
    }
    for problem in &soc.stack.partial_device().problems {
        println!("usb descriptor: {problem}");
    }
    for v in soc.violations.iter().chain(&soc.flash.violations) {
        println!("rule broken: {v}");
    }
    println!(
        "{:.3} s emulated in {:.2} s ({:.1} x real time), {} ticks, {} instructions, core at {:.0} MHz",
        seconds(bench.now()),
        wall.as_secs_f64(),
        seconds(bench.now()) / wall.as_secs_f64(),
        soc.triggers,
        soc.instructions,
        soc.core_hz() / 1e6,
    );
}
