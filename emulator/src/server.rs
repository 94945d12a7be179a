//! Serves the device's bulk endpoints on a socket, so that `flexstage view | record | probe` talk to the emulated board
//! as they do to a real one.
//!
//! One message is `[u32 length, little-endian][u8 kind][bytes]`. To the client: 0x01 HELLO (JSON: vid, pid and the
//! strings; after connecting and after every enumeration), 0x02 IN (one finished bulk IN transfer, ended by a short
//! packet or 4096 bytes), 0x03 DETACHED (why; the connection closes). From the client: 0x10 OUT (one bulk OUT transfer,
//! split into packets of 64, with a zero-length packet when it is a multiple of 64), 0x11 RESET (bus reset). There is
//! one client at a time; a second one is refused by closing its socket. IN tokens are sent only while a client is
//! there, as a host sends none to a device that no program has open.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::os::unix::net::UnixListener;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};

use anyhow::{Context, Result};

use crate::usb_host::Device;

/// To the client: who the device is.
pub const HELLO: u8 = 0x01;
/// To the client: a bulk IN transfer.
pub const IN: u8 = 0x02;
/// To the client: the device is gone.
pub const DETACHED: u8 = 0x03;
/// From the client: a bulk OUT transfer.
pub const OUT: u8 = 0x10;
/// From the client: reset the bus.
pub const RESET: u8 = 0x11;

/// Longest message a client may send.
const LONGEST: usize = 1 << 20;
/// Transfers kept for a client that does not read: about 0.1 s at full rate.
const DEPTH: usize = 16;

trait Conn: Read + Write + Send {
    fn twin(&self) -> std::io::Result<Box<dyn Conn>>;
    fn shut(&self);
}

impl Conn for std::net::TcpStream {
    fn twin(&self) -> std::io::Result<Box<dyn Conn>> {
        Ok(Box::new(self.try_clone()?))
    }
    fn shut(&self) {
        // Already closed is as good.
        let _ = self.shutdown(std::net::Shutdown::Both);
    }
}

impl Conn for std::os::unix::net::UnixStream {
    fn twin(&self) -> std::io::Result<Box<dyn Conn>> {
        Ok(Box::new(self.try_clone()?))
    }
    fn shut(&self) {
        let _ = self.shutdown(std::net::Shutdown::Both);
    }
}

/// What a client asks for.
#[derive(Debug, PartialEq, Eq)]
pub enum Request {
    /// A client is there.
    Connected,
    /// A bulk OUT transfer.
    Out(Vec<u8>),
    /// A bus reset.
    Reset,
    /// The client went away.
    Closed,
}

struct Client {
    to: SyncSender<(u8, Vec<u8>)>,
}

/// The listening socket and its client.
pub struct Server {
    requests: Receiver<Request>,
    client: Arc<Mutex<Option<Client>>>,
    /// Address that clients connect to.
    pub address: String,
    unix_path: Option<std::path::PathBuf>,
}

impl Server {
    /// Listens on `host:port` or `unix:/path`.
    pub fn listen(address: &str) -> Result<Server> {
        let (sender, requests) = sync_channel(64);
        let client = Arc::new(Mutex::new(None));
        let busy = Arc::new(AtomicBool::new(false));
        let shared = client.clone();
        let hint = || format!("--listen {address}: expected HOST:PORT that is free, or unix:/PATH");
        let mut unix_path = None;
        let address = if let Some(path) = address.strip_prefix("unix:") {
            // A socket file left behind by a run that was killed is in the way.
            if std::os::unix::net::UnixStream::connect(path).is_err() {
                let _ = std::fs::remove_file(path);
            }
            let listener = UnixListener::bind(path).with_context(hint)?;
            unix_path = Some(path.into());
            std::thread::spawn(move || {
                for stream in listener.incoming().flatten() {
                    accept(Box::new(stream), &sender, &shared, &busy);
                }
            });
            address.to_owned()
        } else {
            let listener = TcpListener::bind(address).with_context(hint)?;
            let bound = listener.local_addr().with_context(hint)?.to_string();
            std::thread::spawn(move || {
                for stream in listener.incoming().flatten() {
                    // Latency matters more than packets on loopback.
                    let _ = stream.set_nodelay(true);
                    accept(Box::new(stream), &sender, &shared, &busy);
                }
            });
            bound
        };
        Ok(Server { requests, client, address, unix_path })
    }

    /// What the client wants next.
    pub fn request(&self) -> Option<Request> {
        self.requests.try_recv().ok()
    }

    /// Sends a message. `wait` blocks until there is room; else a full queue gives the message back.
    pub fn send(&self, kind: u8, bytes: Vec<u8>, wait: bool) -> std::result::Result<(), Vec<u8>> {
        let to = match &*self.lock() {
            Some(client) => client.to.clone(),
            None => return Ok(()),
        };
        if wait {
            // A client that closed takes nothing any more; its `Closed` request follows.
            let _ = to.send((kind, bytes));
            return Ok(());
        }
        match to.try_send((kind, bytes)) {
            Err(TrySendError::Full((_, bytes))) => Err(bytes),
            Ok(()) | Err(TrySendError::Disconnected(_)) => Ok(()),
        }
    }

    /// Tells the client who it talks to.
    pub fn hello(&self, device: &Device) {
        let [manufacturer, product, serial] = &device.strings;
        let text = serde_json::json!({
            "vid": device.vid, "pid": device.pid,
            "manufacturer": manufacturer, "product": product, "serial": serial, "speed": "emulated",
        });
        let _ = self.send(HELLO, text.to_string().into_bytes(), true);
    }

    /// Says goodbye and closes the connection.
    pub fn detach(&self, why: &str) {
        let _ = self.send(DETACHED, why.as_bytes().to_vec(), true);
        // Dropping the sender ends the writing thread, which closes the socket.
        *self.lock() = None;
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<Client>> {
        self.client.lock().unwrap_or_else(|e| e.into_inner())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(path) = &self.unix_path {
            let _ = std::fs::remove_file(path);
        }
    }
}

fn accept(
    mut conn: Box<dyn Conn>,
    requests: &SyncSender<Request>,
    client: &Arc<Mutex<Option<Client>>>,
    busy: &Arc<AtomicBool>,
) {
    if busy.swap(true, Ordering::SeqCst) {
        conn.shut();
        return;
    }
    let Ok(mut writer) = conn.twin() else {
        busy.store(false, Ordering::SeqCst);
        return;
    };
    let (to, from) = sync_channel::<(u8, Vec<u8>)>(DEPTH);
    *client.lock().unwrap_or_else(|e| e.into_inner()) = Some(Client { to });
    std::thread::spawn(move || {
        for (kind, bytes) in from {
            let mut message = (bytes.len() as u32).to_le_bytes().to_vec();
            message.push(kind);
            message.extend(bytes);
            if writer.write_all(&message).is_err() {
                break;
            }
        }
        writer.shut();
    });
    let (requests, client, busy) = (requests.clone(), client.clone(), busy.clone());
    std::thread::spawn(move || {
        let mut go_on = requests.send(Request::Connected).is_ok();
        while go_on {
            let request = match read_message(&mut *conn) {
                Some((OUT, bytes)) => Request::Out(bytes),
                Some((RESET, _)) => Request::Reset,
                // Anything else is not a client of this protocol.
                Some(_) | None => break,
            };
            go_on = requests.send(request).is_ok();
        }
        conn.shut();
        *client.lock().unwrap_or_else(|e| e.into_inner()) = None;
        let _ = requests.send(Request::Closed);
        busy.store(false, Ordering::SeqCst);
    });
}

fn read_message(conn: &mut dyn Conn) -> Option<(u8, Vec<u8>)> {
    let mut head = [0; 5];
    conn.read_exact(&mut head).ok()?;
    let length = u32::from_le_bytes([head[0], head[1], head[2], head[3]]) as usize;
    if length > LONGEST {
        return None;
    }
    let mut bytes = vec![0; length];
    conn.read_exact(&mut bytes).ok()?;
    Some((head[4], bytes))
}
