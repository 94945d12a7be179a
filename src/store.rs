//! Settings in permanent memory: two slots, of which one is always whole.
//!
//! A save erases the slot that does not hold the settings in use, programs the payload into it, and the header last. The header's
//! magic number is the very last double word: a slot without it does not exist. Whatever moment the power is cut, the
//! other slot is untouched, and the new one is either whole or nothing.
//!
//! | offset | bytes | field |
//! | --- | --- | --- |
//! | 0 | 4 | magic |
//! | 4 | 2 | [`FORMAT`] of the payload |
//! | 6 | 2 | payload length |
//! | 8 | 4 | number of the save |
//! | 12 | 4 | CRC-32 of format, length, number and payload |
//! | 16 | n | payload: the settings, postcard-encoded |
//!
//! This file knows no hardware: the board gives it a [`Memory`], the tests one that fails at every possible moment.

use crate::Settings;
use crate::link::frame::Checksum;

/// Version of the payload. A change of [`Settings`] that old payloads do not survive gets a new number, and `migrate` the way there.
pub const FORMAT: u16 = 1;

/// Bytes of a slot.
pub const SLOT_BYTES: usize = 4_096;
/// Bytes of the header.
const HEADER: usize = 16;
/// Longest payload: the same settings travel in one frame.
pub const MAX_PAYLOAD: usize = crate::link::frame::MAX_PAYLOAD;
const MAGIC: u32 = 0x4753_4c46;

/// The memory did not do what it should.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryError;

/// Two slots of permanent memory that is erased to ones as a whole and programmed once in double words.
#[expect(async_fn_in_trait, reason = "used on one executor only; the futures need not be Send")]
pub trait Memory {
    /// Content of a slot (0 or 1); an error if any of it is damaged.
    fn read(&self, slot: u8) -> Result<&[u8], MemoryError>;
    /// Erases a slot.
    async fn erase(&mut self, slot: u8) -> Result<(), MemoryError>;
    /// Programs 8 bytes at an offset (a multiple of 8) of an erased slot.
    async fn program(&mut self, slot: u8, offset: usize, bytes: [u8; 8])
    -> Result<(), MemoryError>;
}

/// What a slot holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot<'a> {
    /// Nothing was ever saved, or a save did not finish.
    Empty,
    /// Something that is no settings, or settings that lost bits.
    Damaged,
    /// Settings.
    Whole {
        /// Number of the save.
        number: u32,
        /// Version of the payload.
        format: u16,
        /// The payload.
        payload: &'a [u8],
    },
}

/// Settings and where they are.
#[derive(Clone, Debug, PartialEq)]
pub struct Stored {
    /// The settings.
    pub settings: Settings,
    /// Number of the save.
    pub number: u32,
    /// Slot.
    pub slot: u8,
}

fn checksum(format: u16, number: u32, payload: &[u8]) -> u32 {
    let mut sum = Checksum::new();
    sum.update(&format.to_le_bytes());
    sum.update(&(payload.len() as u16).to_le_bytes());
    sum.update(&number.to_le_bytes());
    sum.update(payload);
    sum.finish()
}

fn inspect<M: Memory>(memory: &M, slot: u8) -> Slot<'_> {
    let Ok(bytes) = memory.read(slot) else { return Slot::Damaged };
    let Some((header, rest)) = bytes.split_first_chunk::<HEADER>() else { return Slot::Damaged };
    let [m0, m1, m2, m3, f0, f1, l0, l1, n0, n1, n2, n3, c0, c1, c2, c3] = *header;
    if [m0, m1, m2, m3] == [0xff; 4] {
        return Slot::Empty;
    }
    let format = u16::from_le_bytes([f0, f1]);
    let length = usize::from(u16::from_le_bytes([l0, l1]));
    let number = u32::from_le_bytes([n0, n1, n2, n3]);
    let expected = u32::from_le_bytes([c0, c1, c2, c3]);
    match rest.get(..length) {
        Some(payload)
            if u32::from_le_bytes([m0, m1, m2, m3]) == MAGIC
                && checksum(format, number, payload) == expected =>
        {
            Slot::Whole { number, format, payload }
        }
        _ => Slot::Damaged,
    }
}

/// Settings from a payload of any format that ever was.
fn migrate(format: u16, payload: &[u8]) -> Option<Settings> {
    match format {
        FORMAT => match postcard::take_from_bytes(payload) {
            Ok((settings, [])) => Some(settings),
            Ok(_) | Err(_) => None,
        },
        _ => None,
    }
}

/// Settings that the board can run on.
#[inline(never)]
fn usable(format: u16, payload: &[u8]) -> Option<Settings> {
    migrate(format, payload).filter(|settings| crate::Config::build(settings).is_ok())
}

/// Which of two save numbers is the newer one, across the wrap.
fn is_newer(a: u32, b: u32) -> bool {
    (a.wrapping_sub(b) as i32) > 0
}

/// The newest settings that are whole and build; `Err` if there are none though a slot is not empty.
///
/// # Errors
/// A slot holds something, but no slot settings that can be used.
pub fn load<M: Memory>(memory: &M) -> Result<Option<Stored>, MemoryError> {
    let mut best: Option<Stored> = None;
    let mut is_damaged = false;
    for slot in [0, 1] {
        match inspect(memory, slot) {
            Slot::Empty => {}
            Slot::Damaged => is_damaged = true,
            Slot::Whole { number, format, payload } => match usable(format, payload) {
                Some(_) if best.as_ref().is_some_and(|b| !is_newer(number, b.number)) => {}
                Some(settings) => best = Some(Stored { settings, number, slot }),
                None => is_damaged = true,
            },
        }
    }
    if best.is_none() && is_damaged { Err(MemoryError) } else { Ok(best) }
}

/// Writes settings into the slot that does not hold the newest; number and slot of the copy. `scratch` holds the payload.
///
/// # Errors
/// The memory failed, or does not read back; the settings saved before are untouched.
pub async fn save<M: Memory>(
    memory: &mut M,
    settings: &Settings,
    scratch: &mut [u8],
) -> Result<(u32, u8), MemoryError> {
    let payload: &[u8] = postcard::to_slice(settings, scratch).map_err(|_| MemoryError)?;
    if payload.len() > MAX_PAYLOAD {
        return Err(MemoryError);
    }
    let (number, slot) = next(memory);
    memory.erase(slot).await?;
    let mut offset = HEADER;
    for chunk in payload.chunks(8) {
        let mut bytes = [0xff; 8];
        for (to, from) in bytes.iter_mut().zip(chunk) {
            *to = *from;
        }
        memory.program(slot, offset, bytes).await?;
        offset += 8;
    }
    let [n0, n1, n2, n3] = number.to_le_bytes();
    let [c0, c1, c2, c3] = checksum(FORMAT, number, payload).to_le_bytes();
    memory.program(slot, 8, [n0, n1, n2, n3, c0, c1, c2, c3]).await?;
    let [m0, m1, m2, m3] = MAGIC.to_le_bytes();
    let [f0, f1] = FORMAT.to_le_bytes();
    let [l0, l1] = (payload.len() as u16).to_le_bytes();
    memory.program(slot, 0, [m0, m1, m2, m3, f0, f1, l0, l1]).await?;
    match inspect(memory, slot) {
        Slot::Whole { number: n, payload: p, .. } if n == number && p == payload => {
            Ok((number, slot))
        }
        _ => Err(MemoryError),
    }
}

/// Number and slot of the next save: never the slot that [`load`] would take.
fn next<M: Memory>(memory: &M) -> (u32, u8) {
    let usable = |slot| match inspect(memory, slot) {
        Slot::Whole { number, format, payload } => usable(format, payload).map(|_| number),
        Slot::Empty | Slot::Damaged => None,
    };
    match (usable(0), usable(1)) {
        (None, None) => (1, 0),
        (Some(a), None) => (a.wrapping_add(1), 1),
        (None, Some(b)) => (b.wrapping_add(1), 0),
        (Some(a), Some(b)) if is_newer(b, a) => (b.wrapping_add(1), 0),
        (Some(a), Some(_)) => (a.wrapping_add(1), 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::session::ready;
    use std::vec::Vec;

    /// Flash whose supply fails at the `fuse`-th operation, which is left half done: what was being written is then garbage.
    #[derive(Clone)]
    struct Flash {
        slots: [Vec<u8>; 2],
        damaged: [bool; 2],
        fuse: Option<usize>,
        operations: usize,
        is_dead: bool,
    }

    impl Flash {
        fn blank() -> Self {
            Self {
                slots: [vec![0xff; SLOT_BYTES], vec![0xff; SLOT_BYTES]],
                damaged: [false; 2],
                fuse: None,
                operations: 0,
                is_dead: false,
            }
        }

        /// Counts an operation; whether this is the one that is cut.
        fn step(&mut self) -> bool {
            self.operations += 1;
            self.is_dead |= self.fuse.is_some_and(|fuse| self.operations > fuse);
            self.fuse.is_some_and(|fuse| self.operations == fuse + 1)
        }

        fn power_on_again(&mut self) {
            (self.fuse, self.is_dead) = (None, false);
        }
    }

    /// How a cut operation leaves its cells: untouched, half written, or done.
    #[derive(Clone, Copy, Debug)]
    enum Cut {
        Before,
        Half,
        After,
    }

    struct Cutting(Flash, Cut);

    impl Memory for Cutting {
        fn read(&self, slot: u8) -> Result<&[u8], MemoryError> {
            let slot = usize::from(slot);
            if self.0.damaged[slot] { Err(MemoryError) } else { Ok(&self.0.slots[slot]) }
        }
        async fn erase(&mut self, slot: u8) -> Result<(), MemoryError> {
            let slot = usize::from(slot);
            let is_cut = self.0.step();
            if !self.0.is_dead || (is_cut && matches!(self.1, Cut::After)) {
                self.0.slots[slot].fill(0xff);
                self.0.damaged[slot] = false;
            } else if is_cut && matches!(self.1, Cut::Half) {
                self.0.slots[slot][..1_000].fill(0xff);
                self.0.damaged[slot] = true;
            }
            if self.0.is_dead { Err(MemoryError) } else { Ok(()) }
        }
        async fn program(
            &mut self,
            slot: u8,
            offset: usize,
            bytes: [u8; 8],
        ) -> Result<(), MemoryError> {
            let slot = usize::from(slot);
            let is_cut = self.0.step();
            let place = &mut self.0.slots[slot][offset..offset + 8];
            assert!(self.0.is_dead || place == [0xff; 8], "programmed twice");
            if !self.0.is_dead || (is_cut && matches!(self.1, Cut::After)) {
                place.copy_from_slice(&bytes);
            } else if is_cut && matches!(self.1, Cut::Half) {
                place[..4].copy_from_slice(&bytes[..4]);
                self.0.damaged[slot] = true;
            }
            if self.0.is_dead { Err(MemoryError) } else { Ok(()) }
        }
    }

    fn settings(proportional: f32) -> Settings {
        let mut settings = Settings::default();
        settings.axes[0].feedback.proportional_v_per_um = proportional;
        settings
    }

    fn save_now(flash: &mut Flash, proportional: f32, cut: Cut) -> Result<(u32, u8), MemoryError> {
        let mut memory = Cutting(flash.clone(), cut);
        let mut scratch = [0; MAX_PAYLOAD];
        let result = ready(save(&mut memory, &settings(proportional), &mut scratch)).unwrap();
        *flash = memory.0;
        result
    }

    fn gain(flash: &Flash) -> Option<f32> {
        let stored = load(&Cutting(flash.clone(), Cut::Before)).unwrap();
        stored.map(|stored| stored.settings.axes[0].feedback.proportional_v_per_um)
    }

    #[test]
    fn saves_alternate_and_the_newest_is_loaded() {
        let mut flash = Flash::blank();
        assert_eq!(gain(&flash), None);
        for i in 1..=5u8 {
            let (number, slot) = save_now(&mut flash, f32::from(i), Cut::Before).unwrap();
            assert_eq!((number, slot), (u32::from(i), (i + 1) % 2));
            assert_eq!(gain(&flash), Some(f32::from(i)));
        }
    }

    #[test]
    fn a_power_cut_at_any_moment_leaves_the_old_or_the_new_settings() {
        for saves_before in [1, 2, 3u8] {
            let mut flash = Flash::blank();
            for i in 1..=saves_before {
                save_now(&mut flash, f32::from(i), Cut::Before).unwrap();
            }
            let before = flash.operations;
            let mut whole = flash.clone();
            save_now(&mut whole, 50.0, Cut::Before).unwrap();
            let operations = whole.operations - before;
            assert!(operations > 50);
            for cut in [Cut::Before, Cut::Half, Cut::After] {
                for fuse in 0..operations {
                    let mut flash = flash.clone();
                    flash.fuse = Some(before + fuse);
                    assert!(save_now(&mut flash, 50.0, cut).is_err());
                    flash.power_on_again();
                    let found = gain(&flash);
                    let is_last = fuse + 1 == operations && matches!(cut, Cut::After);
                    let expected = if is_last { 50.0 } else { f32::from(saves_before) };
                    assert_eq!(found, Some(expected), "cut {cut:?} at operation {fuse}");
                    save_now(&mut flash, 60.0, cut).unwrap();
                    assert_eq!(gain(&flash), Some(60.0), "saving again after {cut:?} at {fuse}");
                }
            }
        }
    }

    #[test]
    fn damage_is_told_from_emptiness() {
        let mut flash = Flash::blank();
        save_now(&mut flash, 1.0, Cut::Before).unwrap();
        save_now(&mut flash, 2.0, Cut::Before).unwrap();
        flash.slots[1][40] ^= 1;
        assert_eq!(gain(&flash), Some(1.0));
        flash.slots[0][40] ^= 1;
        assert_eq!(load(&Cutting(flash.clone(), Cut::Before)), Err(MemoryError));
        save_now(&mut flash, 3.0, Cut::Before).unwrap();
        assert_eq!(gain(&flash), Some(3.0));
    }

    #[test]
    fn settings_of_an_unknown_format_are_left_alone() {
        let mut flash = Flash::blank();
        save_now(&mut flash, 1.0, Cut::Before).unwrap();
        let number = 1u32;
        let length = usize::from(u16::from_le_bytes([flash.slots[0][6], flash.slots[0][7]]));
        let payload = flash.slots[0][HEADER..HEADER + length].to_vec();
        flash.slots[0][4..6].copy_from_slice(&99u16.to_le_bytes());
        let sum = checksum(99, number, &payload);
        flash.slots[0][12..16].copy_from_slice(&sum.to_le_bytes());
        assert_eq!(load(&Cutting(flash, Cut::Before)), Err(MemoryError));
    }

    #[test]
    fn a_save_leaves_the_only_slot_alone_that_can_be_used() {
        let mut flash = Flash::blank();
        save_now(&mut flash, 1.0, Cut::Before).unwrap();
        // The newest is whole and of this format, but no board can run on it: of a firmware that allowed more, say.
        save_now(&mut flash, -1.0, Cut::Before).unwrap();
        assert_eq!(gain(&flash), Some(1.0));
        flash.fuse = Some(flash.operations + 1);
        assert!(save_now(&mut flash, 2.0, Cut::Half).is_err());
        flash.power_on_again();
        assert_eq!(gain(&flash), Some(1.0));
    }

    #[test]
    fn numbers_wrap() {
        assert!(is_newer(0, u32::MAX));
        assert!(!is_newer(u32::MAX, 0));
    }
}
