//! The emulator as the program that `cargo xtask emulate --listen` starts: a client on its socket gets the board.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command as Program, Stdio};
use std::time::{Duration, Instant};

use emulator::link::Link;
use emulator::server::{DETACHED, HELLO, IN, OUT};
use flexstage::link::message::{Command, Reply};
use flexstage::link::{Fields, Profile};
use host_sim::effects::Place;

use crate::common::image;

/// Ends the emulator whatever becomes of the test.
pub struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // Already gone is as good.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The emulator with these options beside, and the address that it serves.
pub fn start(arguments: &[&str]) -> (Running, String) {
    let mut child = Program::new(env!("CARGO_BIN_EXE_emulator"))
        .arg("--elf")
        .arg(std::env::var_os("FLEXSTAGE_FIRMWARE_ELF").unwrap())
        .args(["--listen", "127.0.0.1:0", "--speed", "max"])
        .args(arguments)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let running = Running(child);
    let address = lines.by_ref().find_map(|line| {
        line.unwrap().strip_prefix("serving the board's USB endpoints on ").map(str::to_owned)
    });
    // The pipe has to be emptied, or the emulator would wait for it.
    std::thread::spawn(move || lines.for_each(drop));
    (running, address.expect("the emulator says where it listens"))
}

struct Client {
    socket: TcpStream,
    link: Link,
}

impl Client {
    fn connect(address: &str) -> Client {
        let socket = TcpStream::connect(address).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        Client { socket, link: Link::default() }
    }

    fn message(&mut self) -> std::io::Result<(u8, Vec<u8>)> {
        let mut head = [0; 5];
        self.socket.read_exact(&mut head)?;
        let length = u32::from_le_bytes([head[0], head[1], head[2], head[3]]) as usize;
        let mut bytes = vec![0; length];
        self.socket.read_exact(&mut bytes)?;
        Ok((head[4], bytes))
    }

    /// Reads until `done`.
    fn until(&mut self, what: &str, mut done: impl FnMut(&mut Link) -> bool) {
        let start = Instant::now();
        while !done(&mut self.link) {
            assert!(start.elapsed() < Duration::from_secs(120), "no {what}");
            match self.message().unwrap_or_else(|e| panic!("no {what}: {e}")) {
                (IN, bytes) => self.link.transfer(&bytes),
                (kind, bytes) => panic!("kind {kind}: {}", String::from_utf8_lossy(&bytes)),
            }
        }
    }

    fn ask(&mut self, command: &Command) -> Reply {
        let (sequence, bytes) = self.link.command(command);
        let mut message = (bytes.len() as u32).to_le_bytes().to_vec();
        message.push(OUT);
        message.extend(bytes);
        self.socket.write_all(&message).unwrap();
        let mut reply = None;
        self.until(&format!("reply to {command:?}"), |link| {
            reply = link.reply(sequence);
            reply.is_some()
        });
        reply.unwrap()
    }
}

#[test]
fn a_client_on_the_socket_gets_every_sample() {
    if image().is_none() {
        return;
    }
    let (_emulator, address) = start(&["--seconds", "60"]);
    let mut client = Client::connect(&address);
    let (kind, hello) = client.message().unwrap();
    assert_eq!(kind, HELLO);
    let hello = String::from_utf8(hello).unwrap();
    assert!(hello.contains("\"product\":\"flexstage controller\""), "{hello}");
    let on = Command::StreamOn { fields: Fields::RECORDING, profile: Profile::Packed };
    assert!(matches!(client.ask(&on), Reply::Streaming { .. }));
    client.link.clear();
    client.until("20 000 samples", |link| link.tally.samples >= 20_000);
    let tally = client.link.tally.clone();
    println!("{hello}\n{tally:?}");
    assert_eq!((tally.missing, tally.dropped, tally.bad), (0, 0, 0), "{tally:?}");

    // Somebody else is turned away while this client is there, and served once it has gone.
    let mut second = Client::connect(&address);
    assert!(second.message().is_err(), "a second client must be refused");
    drop(client);
    let start = Instant::now();
    let served = loop {
        let mut third = Client::connect(&address);
        if let Ok((HELLO, _)) = third.message() {
            break third;
        }
        assert!(start.elapsed() < Duration::from_secs(20), "nobody is served any more");
        std::thread::sleep(Duration::from_millis(50));
    };
    let mut third = served;
    assert!(matches!(third.ask(&Command::Status), Reply::Status(_)));
}

#[test]
fn the_end_of_the_emulation_is_announced() {
    if image().is_none() {
        return;
    }
    let (_emulator, address) = start(&["--seconds", "2"]);
    let mut client = Client::connect(&address);
    let why = loop {
        match client.message().expect("a farewell before the socket closes") {
            (DETACHED, why) => break String::from_utf8(why).unwrap(),
            _ => continue,
        }
    };
    assert!(why.contains("ended"), "{why}");
}

#[test]
fn a_planted_effect_is_in_the_rig() {
    if image().is_none() {
        return;
    }
    // A gauge whose bridge is out of balance: what a parked board reads there is off by as much.
    let mut rig = crate::common::rig();
    rig.set("sensor-offset", Place::Axis(1), "offset_m", 0.5e-6).unwrap();
    let path = std::env::temp_dir().join(format!("flexstage-rig-{}.toml", std::process::id()));
    std::fs::write(&path, rig.to_toml()).unwrap();
    let (_emulator, address) = start(&["--seconds", "60", "--rig", path.to_str().unwrap()]);
    let mut client = Client::connect(&address);
    assert_eq!(client.message().unwrap().0, HELLO);
    let _ = std::fs::remove_file(&path);
    client.ask(&Command::StreamOn { fields: Fields::RECORDING, profile: Profile::Exact });
    client.link.samples = Some(Vec::new());
    client.until("samples", |link| link.samples.as_ref().is_some_and(|s| s.len() > 2_000));
    let samples = client.link.samples.take().unwrap();
    let mean = |k: usize| {
        samples.iter().map(|s| f64::from(s.position[k]) / f64::from(1 << 24)).sum::<f64>()
            / samples.len() as f64
    };
    let found = [mean(0), mean(1), mean(2)];
    println!("positions at rest, um: {found:.4?}");
    assert!((found[1] - found[0] - 0.5).abs() < 0.01, "{found:?}");
}
