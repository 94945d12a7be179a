//! A board on a local socket: the firmware in `cargo xtask emulate --listen ADDR`, or any board that `flexstage serve` offers.

use std::io::{self, Read, Write};
use std::net::TcpStream;
#[cfg(unix)]
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use super::wire::{DETACHED, HELLO, IN, LONGEST, OUT};
use super::{ANOTHER_CLIENT, Transport, wire};
use crate::{Error, Result};

/// How long a server may take to say hello.
const HELLO_TIMEOUT: Duration = Duration::from_secs(5);

/// A byte stream with read timeouts.
trait Stream: Read + Write + Send {
    fn set_timeout(&self, timeout: Duration) -> io::Result<()>;
}

impl Stream for TcpStream {
    fn set_timeout(&self, timeout: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(timeout))
    }
}

#[cfg(unix)]
impl Stream for UnixStream {
    fn set_timeout(&self, timeout: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(timeout))
    }
}

/// Connection to an emulated board.
pub struct SocketTransport {
    address: String,
    /// What the server says it is.
    what: String,
    stream: Box<dyn Stream>,
    /// Bytes of messages that are not complete yet.
    pending: Vec<u8>,
}

impl SocketTransport {
    /// Connect to `host:port` or `unix:/path` and wait for the board to enumerate.
    pub fn connect(address: &str) -> Result<Self> {
        let failed = |error: io::Error| Error::Connect {
            address: address.to_owned(),
            reason: error.to_string(),
        };
        let stream: Box<dyn Stream> = match address.strip_prefix("unix:") {
            #[cfg(unix)]
            Some(path) => Box::new(UnixStream::connect(path).map_err(failed)?),
            #[cfg(not(unix))]
            Some(_) => return Err(failed(io::Error::other("unix sockets need a unix system"))),
            None => {
                let stream = TcpStream::connect(address).map_err(failed)?;
                stream.set_nodelay(true).map_err(failed)?;
                Box::new(stream)
            }
        };
        let mut transport = Self {
            address: address.to_owned(),
            what: "the board".to_owned(),
            stream,
            pending: Vec::new(),
        };
        let deadline = Instant::now() + HELLO_TIMEOUT;
        while Instant::now() < deadline {
            match transport.message(Duration::from_millis(100)) {
                Ok(Some((HELLO, body))) => {
                    transport.what = product(&body);
                    return Ok(transport);
                }
                Ok(Some((DETACHED, reason))) => {
                    return Err(transport.lost(String::from_utf8_lossy(&reason).into_owned()));
                }
                Ok(Some(_) | None) => {}
                // The emulator refuses a second client by closing its socket.
                Err(Error::Lost { board, .. }) => return Err(Error::Busy { board }),
                Err(error) => return Err(error),
            }
        }
        Err(Error::NotFlexstage {
            board: transport.name(),
            reason: format!("no hello within {} s", HELLO_TIMEOUT.as_secs()),
        })
    }

    fn lost(&self, reason: String) -> Error {
        if reason == ANOTHER_CLIENT {
            return Error::Busy { board: self.name() };
        }
        Error::Lost { board: self.name(), reason }
    }

    /// Next whole message, waiting at most `timeout` for more bytes.
    fn message(&mut self, timeout: Duration) -> Result<Option<(u8, Vec<u8>)>> {
        loop {
            if let Some((head, rest)) = self.pending.split_first_chunk::<5>() {
                let [l0, l1, l2, l3, kind] = *head;
                let length = u32::from_le_bytes([l0, l1, l2, l3]) as usize;
                if length > LONGEST {
                    return Err(Error::NotFlexstage {
                        board: self.name(),
                        reason: format!("a message of {length} bytes"),
                    });
                }
                if rest.len() >= length {
                    let body = rest[..length].to_vec();
                    self.pending.drain(..5 + length);
                    return Ok(Some((kind, body)));
                }
            }
            let mut buffer = [0; 16 * 1024];
            let wait = timeout.max(Duration::from_millis(1));
            self.stream.set_timeout(wait).map_err(|e| self.lost(e.to_string()))?;
            match self.stream.read(&mut buffer) {
                Ok(0) => return Err(self.lost("the other side closed the connection".into())),
                Ok(n) => self.pending.extend_from_slice(&buffer[..n]),
                Err(error) => match error.kind() {
                    io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => return Ok(None),
                    io::ErrorKind::Interrupted => {}
                    _ => return Err(self.lost(error.to_string())),
                },
            }
        }
    }
}

impl Transport for SocketTransport {
    fn name(&self) -> String {
        format!("{} at {}", self.what, self.address)
    }

    fn send(&mut self, bytes: &[u8]) -> Result<()> {
        wire::write(&mut self.stream, OUT, bytes).map_err(|e| self.lost(e.to_string()))
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Vec<u8>>> {
        match self.message(timeout)? {
            Some((IN, bytes)) => Ok(Some(bytes)),
            Some((HELLO, _)) => Err(self.lost("it restarted and enumerated again".into())),
            Some((DETACHED, reason)) => {
                Err(self.lost(String::from_utf8_lossy(&reason).into_owned()))
            }
            Some(_) | None => Ok(None),
        }
    }
}

/// The product string of a greeting.
fn product(hello: &[u8]) -> String {
    let hello: serde_json::Value = serde_json::from_slice(hello).unwrap_or_default();
    match (hello["speed"].as_str(), hello["product"].as_str()) {
        (Some("emulated"), _) => "the emulated board".to_owned(),
        (_, Some(product)) => product.to_owned(),
        _ => "the board".to_owned(),
    }
}
