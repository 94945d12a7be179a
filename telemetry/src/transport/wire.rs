//! Messages of the socket: `[u32 length, little-endian][u8 kind][bytes]`.

use std::io::{self, Read, Write};

/// To the client: who the board is, after connecting and after each enumeration.
pub const HELLO: u8 = 0x01;
/// To the client: one finished bulk IN transfer.
pub const IN: u8 = 0x02;
/// To the client: the board is gone, and why; the connection closes.
pub const DETACHED: u8 = 0x03;
/// From the client: one bulk OUT transfer.
pub const OUT: u8 = 0x10;
/// Longest message that makes sense; anything else on the port is no board.
pub const LONGEST: usize = 1 << 20;

/// Write one message.
pub fn write(stream: &mut dyn Write, kind: u8, bytes: &[u8]) -> io::Result<()> {
    let mut message = Vec::with_capacity(5 + bytes.len());
    message.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
    message.push(kind);
    message.extend_from_slice(bytes);
    stream.write_all(&message)
}

/// Read one message, waiting for it.
pub fn read(stream: &mut dyn Read) -> io::Result<(u8, Vec<u8>)> {
    let mut head = [0; 5];
    stream.read_exact(&mut head)?;
    let [l0, l1, l2, l3, kind] = head;
    let length = u32::from_le_bytes([l0, l1, l2, l3]) as usize;
    if length > LONGEST {
        return Err(io::Error::other(format!("a message of {length} bytes")));
    }
    let mut bytes = vec![0; length];
    stream.read_exact(&mut bytes)?;
    Ok((kind, bytes))
}
