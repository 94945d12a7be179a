//! USB full-speed device with its packet memory (RM0440 45).
//!
//! EPnR with its toggle and write-zero-to-clear bits, BTABLE in packet memory, ISTR, CNTR, DADDR, BCDR, suspend and
//! reset. The bus side answers tokens as the serial interface engine does: ACK, NAK, STALL or silence, data toggles
//! included. Left out: isochronous and double-buffered endpoints, remote wake-up, LPM, battery charging detection,
//! SOF interrupts, electrical errors, 16-bit-only access to packet memory.

use crate::cpu::memory::Memory;

const CTR_RX: u32 = 1 << 15;
const DTOG_RX: u32 = 1 << 14;
const STAT_RX: u32 = 3 << 12;
const SETUP: u32 = 1 << 11;
const CTR_TX: u32 = 1 << 7;
const DTOG_TX: u32 = 1 << 6;
const STAT_TX: u32 = 3 << 4;
const DISABLED: u32 = 0;
const STALL: u32 = 1;
const NAK: u32 = 2;
const VALID: u32 = 3;

/// What the device answers on the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Handshake<T> {
    /// Taken, or given.
    Ack(T),
    /// Not now.
    Nak,
    /// Never, until cleared.
    Stall,
    /// Nothing: not addressed, endpoint disabled, unplugged.
    Silent,
}

impl<T> Handshake<T> {
    /// What comes of that which was taken or given; any other answer stays.
    pub fn map<U>(self, act: impl FnOnce(T) -> U) -> Handshake<U> {
        match self {
            Handshake::Ack(content) => Handshake::Ack(act(content)),
            Handshake::Nak => Handshake::Nak,
            Handshake::Stall => Handshake::Stall,
            Handshake::Silent => Handshake::Silent,
        }
    }
}

/// The peripheral.
pub struct Usb {
    ep: [u32; 8],
    cntr: u32,
    istr: u32,
    daddr: u32,
    btable: u32,
    bcdr: u32,
    /// Packet memory, one page of which the first 1 KiB is real.
    pub memory: Memory,
}

impl Usb {
    /// Out of reset, in power-down.
    pub fn new(memory: Memory) -> Usb {
        Usb { ep: [0; 8], cntr: 3, istr: 0, daddr: 0, btable: 0, bcdr: 0, memory }
    }

    /// Whether the device pulls D+ up: it is there.
    pub fn attached(&self) -> bool {
        self.bcdr & 1 << 15 != 0 && self.cntr & 3 == 0
    }

    fn istr(&self) -> u32 {
        let flags = self.istr & 0x7f00;
        match self.ep.iter().position(|e| e & (CTR_RX | CTR_TX) != 0) {
            Some(i) => flags | 1 << 15 | i as u32 | if self.ep[i] & CTR_RX != 0 { 0x10 } else { 0 },
            None => flags,
        }
    }

    /// Interrupt line.
    #[inline]
    pub fn line(&self) -> bool {
        self.istr() & self.cntr & 0xff00 != 0
    }

    /// Register read.
    pub fn read(&self, offset: u32, frame: u32) -> u32 {
        match offset {
            0x00..=0x1c => self.ep[offset as usize / 4],
            0x40 => self.cntr,
            0x44 => self.istr(),
            0x48 => frame & 0x7ff,
            0x4c => self.daddr,
            0x50 => self.btable,
            0x58 => self.bcdr,
            _ => 0,
        }
    }

    /// Register write.
    pub fn write(&mut self, offset: u32, value: u32) {
        match offset {
            0x00..=0x1c => {
                let e = &mut self.ep[offset as usize / 4];
                let toggles = DTOG_RX | STAT_RX | DTOG_TX | STAT_TX;
                *e = *e & SETUP
                    | value & 0x070f
                    | *e & value & (CTR_RX | CTR_TX)
                    | (*e ^ value) & toggles;
            }
            0x40 => {
                self.cntr = value;
                if value & 1 != 0 {
                    // FRES holds the endpoint registers in reset.
                    self.ep = [0; 8];
                    self.daddr = 0;
                    self.istr = 0;
                }
            }
            0x44 => self.istr &= value,
            0x4c => self.daddr = value & 0xff,
            0x50 => self.btable = value & 0xfff8,
            0x58 => self.bcdr = value,
            _ => {}
        }
    }

    /// The host drives a bus reset (SE0 for 10 ms): endpoints and address are cleared.
    pub fn bus_reset(&mut self) {
        self.ep = [0; 8];
        self.daddr = 0;
        self.istr |= 1 << 10;
    }

    /// Three milliseconds without a frame.
    pub fn bus_suspend(&mut self) {
        self.istr |= 1 << 11;
    }

    /// Activity after suspend.
    pub fn bus_resume(&mut self) {
        self.istr |= 1 << 12;
    }

    fn answers(&self, address: u8) -> bool {
        self.attached() && self.daddr & 0x80 != 0 && (self.daddr & 0x7f) as u8 == address
    }

    fn row(&self, endpoint: usize) -> usize {
        self.btable as usize + endpoint * 8
    }

    fn receive(&mut self, endpoint: usize, data: &[u8]) {
        let row = self.row(endpoint);
        let at = self.memory.u16(row + 4) as usize & 0x3ff;
        let count = self.memory.u16(row + 6);
        let room = ((count >> 10 & 31) as usize + (count >> 15) as usize)
            * if count >> 15 != 0 { 32 } else { 2 };
        let kept = &data[..data.len().min(room).min(1024 - at)];
        self.memory.write(at, kept);
        self.memory.set_u16(row + 6, count & 0xfc00 | kept.len() as u16);
    }

    /// Whether an OUT (or SETUP, `endpoint` 0) token would be answered other than by NAK.
    pub fn out_ready(&self, endpoint: usize) -> bool {
        matches!((self.ep[endpoint] & STAT_RX) >> 12, VALID | STALL)
    }

    /// Whether an IN token would be answered other than by NAK.
    pub fn in_ready(&self, endpoint: usize) -> bool {
        matches!((self.ep[endpoint] & STAT_TX) >> 4, VALID | STALL)
    }

    /// SETUP token and its eight bytes.
    pub fn setup(&mut self, address: u8, data: &[u8; 8]) -> Handshake<()> {
        if !self.answers(address) || self.ep[0] & STAT_RX == DISABLED {
            return Handshake::Silent;
        }
        if self.ep[0] & CTR_RX != 0 {
            return Handshake::Nak;
        }
        self.receive(0, data);
        self.ep[0] =
            self.ep[0] & 0x070f | CTR_RX | SETUP | DTOG_RX | NAK << 12 | DTOG_TX | NAK << 4;
        Handshake::Ack(())
    }

    /// OUT token and a packet DATA0 (`toggle` false) or DATA1.
    pub fn out(
        &mut self,
        address: u8,
        endpoint: usize,
        toggle: bool,
        data: &[u8],
    ) -> Handshake<()> {
        if !self.answers(address) {
            return Handshake::Silent;
        }
        let e = self.ep[endpoint];
        match (e & STAT_RX) >> 12 {
            DISABLED => Handshake::Silent,
            STALL => Handshake::Stall,
            NAK => Handshake::Nak,
            // A repeated toggle is a packet whose ACK was lost: acknowledged and dropped.
            _ if (e & DTOG_RX != 0) != toggle => Handshake::Ack(()),
            _ => {
                self.receive(endpoint, data);
                self.ep[endpoint] = (e & !(STAT_RX | SETUP) | NAK << 12 | CTR_RX) ^ DTOG_RX;
                Handshake::Ack(())
            }
        }
    }

    /// IN token: the toggle and the bytes of the packet, which the host acknowledges.
    pub fn token_in(&mut self, address: u8, endpoint: usize) -> Handshake<(bool, Vec<u8>)> {
        if !self.answers(address) {
            return Handshake::Silent;
        }
        let e = self.ep[endpoint];
        match (e & STAT_TX) >> 4 {
            DISABLED => Handshake::Silent,
            STALL => Handshake::Stall,
            NAK => Handshake::Nak,
            _ => {
                let row = self.row(endpoint);
                let at = self.memory.u16(row) as usize & 0x3ff;
                let count = (self.memory.u16(row + 2) as usize & 0x3ff).min(1024 - at);
                let mut data = vec![0; count];
                self.memory.read(at, &mut data);
                self.ep[endpoint] = (e & !STAT_TX | NAK << 4 | CTR_TX) ^ DTOG_TX;
                Handshake::Ack((e & DTOG_TX != 0, data))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoint_register_bits_toggle_clear_and_hold() {
        let mut u = Usb::new(Memory::new(4096));
        u.write(0x40, 0);
        u.write(0x04, 0x3000 | 1); // STAT_RX 0 -> VALID
        assert_eq!(u.read(0x04, 0), 0x3001);
        u.write(0x04, 0x1000 | 1); // toggles the low bit: NAK
        assert_eq!(u.read(0x04, 0), 0x2001);
        u.ep[1] |= CTR_RX | CTR_TX;
        u.write(0x04, CTR_TX | 1);
        assert_eq!(u.read(0x04, 0), 0x2001 | CTR_TX, "CTR_RX cleared by 0, CTR_TX kept by 1");
    }

    #[test]
    fn packets_go_through_packet_memory() {
        let mut u = Usb::new(Memory::new(4096));
        u.write(0x40, 0);
        u.write(0x58, 1 << 15);
        u.write(0x4c, 0x80);
        u.memory.set_u16(8 + 4, 0x100);
        u.memory.set_u16(8 + 6, 0x8400);
        u.write(0x04, 0x3000 | 1);
        assert_eq!(u.out(0, 1, false, &[1, 2, 3]), Handshake::Ack(()));
        assert_eq!(u.memory.u16(8 + 6), 0x8403);
        assert_eq!(u.memory.u32(0x100) & 0xff_ffff, 0x03_0201);
        assert_eq!(u.out(0, 1, true, &[9]), Handshake::Nak);
        u.memory.set_u16(8, 0x140);
        u.memory.set_u16(8 + 2, 2);
        u.memory.write(0x140, &[7, 8]);
        u.write(0x04, 0x30 | CTR_RX | 1);
        assert_eq!(u.token_in(5, 1), Handshake::Silent, "not its address");
        assert_eq!(u.token_in(0, 1), Handshake::Ack((false, vec![7, 8])));
        assert_eq!(u.token_in(0, 1), Handshake::Nak);
    }
}
