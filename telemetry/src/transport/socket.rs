//! The emulated board on a local socket: the unmodified firmware runs in `cargo xtask emulate --listen ADDR`.
//!
//! One message is `[u32 LE length][u8 kind][bytes]`; see the emulator's documentation. Kinds: server to client HELLO (who it is, after
//! accepting and after each enumeration), IN (one completed bulk IN transfer), DETACHED (reason); client to server OUT.

use std::io::{self, Read, Write};
use std::net::TcpStream;
#[cfg(unix)]
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use super::Transport;
use crate::{Error, Result};

const HELLO: u8 = 0x01;
const IN: u8 = 0x02;
const DETACHED: u8 = 0x03;
const OUT: u8 = 0x10;
/// Longest message that makes sense; anything else on the port is no emulated board.
const LONGEST: usize = 1 << 20;
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
        let mut transport = Self { address: address.to_owned(), stream, pending: Vec::new() };
        let deadline = Instant::now() + HELLO_TIMEOUT;
        while Instant::now() < deadline {
            match transport.message(Duration::from_millis(100))? {
                Some((HELLO, _)) => return Ok(transport),
                Some((DETACHED, reason)) => {
                    return Err(transport.lost(String::from_utf8_lossy(&reason).into_owned()));
                }
                Some(_) | None => {}
            }
        }
        Err(Error::NotFlexstage {
            board: transport.name(),
            reason: format!("no hello within {} s", HELLO_TIMEOUT.as_secs()),
        })
    }

    fn lost(&self, reason: String) -> Error {
        // The emulator serves one client at a time and says so.
        if reason.contains("another client") || reason.contains("busy") {
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
                Ok(0) => return Err(self.lost("the emulator closed the connection".into())),
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
        format!("the emulated board at {}", self.address)
    }

    fn send(&mut self, bytes: &[u8]) -> Result<()> {
        let mut message = Vec::with_capacity(5 + bytes.len());
        message.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
        message.push(OUT);
        message.extend_from_slice(bytes);
        self.stream.write_all(&message).map_err(|e| self.lost(e.to_string()))
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
