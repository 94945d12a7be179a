//! Puts a board on a local socket, so that programs elsewhere talk to it as to their own.
//!
//! The same messages as the emulator's server (see [`crate::transport`]), over any transport: a virtual board that stays while
//! commands come and go, or a board on the USB of another computer. One client at a time, as on USB; a second one is
//! told so and sent away. A client that does not read makes the board drop samples and count them, as on USB.

use std::io::{self, Write};
use std::net::{TcpListener, TcpStream};
#[cfg(unix)]
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::Duration;

use crate::transport::wire::{self, DETACHED, HELLO, IN, OUT};
use crate::transport::{ANOTHER_CLIENT, Transport};
use crate::{Error, Result};

/// Wait for the board's data: bounds the latency of commands and of new clients.
const POLL: Duration = Duration::from_millis(2);
/// A client that takes nothing for so long is gone.
const STUCK: Duration = Duration::from_secs(10);

/// What happened, for a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// Ready; the address that clients connect to (the port that the system chose for port 0).
    Listening(String),
    /// A client came.
    Connected,
    /// A client was sent away because there is one already.
    Refused,
    /// The client went.
    Left,
}

enum Listener {
    Tcp(TcpListener),
    #[cfg(unix)]
    Unix(UnixListener, std::path::PathBuf),
}

trait Connection: io::Read + Write + Send {
    fn twin(&self) -> io::Result<Box<dyn Connection>>;
}

impl Connection for TcpStream {
    fn twin(&self) -> io::Result<Box<dyn Connection>> {
        Ok(Box::new(self.try_clone()?))
    }
}

#[cfg(unix)]
impl Connection for UnixStream {
    fn twin(&self) -> io::Result<Box<dyn Connection>> {
        Ok(Box::new(self.try_clone()?))
    }
}

impl Listener {
    fn bind(address: &str) -> Result<Self> {
        let failed = |error: io::Error| {
            Error::Invalid(format!(
                "--listen {address}: expected HOST:PORT that is free, or unix:/PATH ({error})"
            ))
        };
        match address.strip_prefix("unix:") {
            #[cfg(unix)]
            Some(path) => {
                // A socket file that a killed run left behind is in the way.
                if UnixStream::connect(path).is_err() && is_socket(path) {
                    let _ = std::fs::remove_file(path);
                }
                let listener = UnixListener::bind(path).map_err(failed)?;
                listener.set_nonblocking(true).map_err(failed)?;
                Ok(Self::Unix(listener, path.into()))
            }
            #[cfg(not(unix))]
            Some(_) => Err(failed(io::Error::other("unix sockets need a unix system"))),
            None => {
                let listener = TcpListener::bind(address).map_err(failed)?;
                listener.set_nonblocking(true).map_err(failed)?;
                Ok(Self::Tcp(listener))
            }
        }
    }

    fn address(&self) -> String {
        match self {
            Self::Tcp(listener) => listener.local_addr().map_or("?".into(), |a| a.to_string()),
            #[cfg(unix)]
            Self::Unix(_, path) => format!("unix:{}", path.display()),
        }
    }

    /// The next client that waits, if any.
    fn accept(&self) -> Option<Box<dyn Connection>> {
        match self {
            Self::Tcp(listener) => {
                let (stream, _) = listener.accept().ok()?;
                stream.set_nonblocking(false).ok()?;
                stream.set_write_timeout(Some(STUCK)).ok()?;
                stream.set_nodelay(true).ok()?;
                Some(Box::new(stream))
            }
            #[cfg(unix)]
            Self::Unix(listener, _) => {
                let (stream, _) = listener.accept().ok()?;
                stream.set_nonblocking(false).ok()?;
                stream.set_write_timeout(Some(STUCK)).ok()?;
                Some(Box::new(stream))
            }
        }
    }
}

#[cfg(unix)]
fn is_socket(path: &str) -> bool {
    use std::os::unix::fs::FileTypeExt;
    std::fs::metadata(path).is_ok_and(|m| m.file_type().is_socket())
}

impl Drop for Listener {
    fn drop(&mut self) {
        #[cfg(unix)]
        if let Self::Unix(_, path) = self {
            // Gone already is as good.
            let _ = std::fs::remove_file(path);
        }
    }
}

struct Client {
    writer: Box<dyn Connection>,
    out: Receiver<Vec<u8>>,
}

impl Client {
    /// Greets it and starts a thread that reads what it sends.
    fn new(stream: Box<dyn Connection>, board: &str) -> io::Result<Self> {
        let mut reader = stream.twin()?;
        let mut writer = stream;
        let hello = serde_json::json!({"product": board, "speed": "served"}).to_string();
        wire::write(&mut writer, HELLO, hello.as_bytes())?;
        let (to, out) = mpsc::channel();
        std::thread::Builder::new().name("client".into()).spawn(move || {
            // Anything but an OUT transfer is no client of this protocol.
            while let Ok((OUT, bytes)) = wire::read(&mut reader) {
                if to.send(bytes).is_err() {
                    break;
                }
            }
        })?;
        Ok(Self { writer, out })
    }
}

/// Serve a board until `stop`. Returns an error when the board goes away.
pub fn serve(
    mut board: Box<dyn Transport>,
    address: &str,
    stop: &AtomicBool,
    event: &mut dyn FnMut(Event),
) -> Result<()> {
    let listener = Listener::bind(address)?;
    event(Event::Listening(listener.address()));
    let mut client: Option<Client> = None;
    let why = loop {
        if stop.load(Ordering::Acquire) {
            break Ok(());
        }
        if let Some(mut stream) = listener.accept() {
            if client.is_some() {
                let _ = wire::write(&mut stream, DETACHED, ANOTHER_CLIENT.as_bytes());
                event(Event::Refused);
            } else if let Ok(new) = Client::new(stream, &board.name()) {
                client = Some(new);
                event(Event::Connected);
            }
        }
        // With nobody there what arrives is thrown away, so that the next client finds fresh samples.
        match board.receive(POLL) {
            Ok(Some(bytes)) => {
                let is_gone = client
                    .as_mut()
                    .is_some_and(|c| wire::write(&mut c.writer, IN, &bytes).is_err());
                if is_gone {
                    client = None;
                    event(Event::Left);
                }
            }
            Ok(None) => {}
            Err(error) => break Err(error),
        }
        let Some(current) = &client else { continue };
        loop {
            match current.out.try_recv() {
                Ok(bytes) => {
                    if let Err(error) = board.send(&bytes) {
                        return goodbye(client, Err(error));
                    }
                }
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    client = None;
                    event(Event::Left);
                    break;
                }
            }
        }
    };
    goodbye(client, why)
}

fn goodbye(client: Option<Client>, why: Result<()>) -> Result<()> {
    if let Some(mut client) = client {
        let reason = match &why {
            Ok(()) => "the server ended".to_owned(),
            Err(error) => error.to_string(),
        };
        let _ = wire::write(&mut client.writer, DETACHED, reason.as_bytes());
    }
    why
}
