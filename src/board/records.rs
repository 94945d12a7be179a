//! Records from the tick to the pump: a ring that is written in place.
//!
//! # Design
//! One producer (the tick), one consumer (the pump), which the tick can interrupt anywhere. The tick fills the slot at `head` and
//! publishes it by moving `head`; the pump reads the slot at `tail` and frees it by moving `tail`. One slot is always free, so the tick
//! always has a place to write to, and only finds out at the end whether it counts. A queue that takes its elements by
//! value (heapless) would have the tick build 76 bytes on its stack and copy them, a tenth of all it does.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering};

use crate::{AXES, Record};

/// Slots; the pump empties them every millisecond. A power of two, so that indices wrap by a mask.
pub const RECORDS: usize = 64;
const MASK: u32 = RECORDS as u32 - 1;

/// One tick, for the stream.
#[derive(Clone, Copy)]
pub struct Entry {
    /// What the controller decided.
    pub record: Record,
    /// Gauge codes.
    pub gauge: [u16; AXES],
    /// Core cycles from the interrupt's entry until here.
    pub cycles: u16,
}

struct Slots(UnsafeCell<[MaybeUninit<Entry>; RECORDS]>);
// SAFETY: the slot at `head` belongs to the producer, those from `tail` up to `head` to the consumer.
unsafe impl Sync for Slots {}

static SLOTS: Slots = Slots(UnsafeCell::new([const { MaybeUninit::uninit() }; RECORDS]));
/// Next slot to fill, below [`RECORDS`]. Written by the producer.
static HEAD: AtomicU32 = AtomicU32::new(0);
/// Oldest slot that is full, if it is not `HEAD`. Written by the consumer.
static TAIL: AtomicU32 = AtomicU32::new(0);

#[inline(always)]
fn slot(index: u32) -> *mut Entry {
    // SAFETY: the mask keeps the index within the array.
    unsafe { SLOTS.0.get().cast::<Entry>().add((index & MASK) as usize) }
}

/// The tick's end.
pub struct Producer(());

/// The pump's end.
pub struct Consumer(());

/// Both ends.
///
/// # Safety
/// Called once.
pub unsafe fn split() -> (Producer, Consumer) {
    (Producer(()), Consumer(()))
}

impl Producer {
    /// Where the next entry goes; any bits stand there.
    #[inline(always)]
    pub fn place(&mut self) -> *mut Entry {
        slot(HEAD.load(Ordering::Relaxed))
    }

    /// Publishes the entry in [`Producer::place`], all of which has been written. False: there is no room, and it is lost.
    #[inline(always)]
    pub fn publish(&mut self) -> bool {
        let next = (HEAD.load(Ordering::Relaxed) + 1) & MASK;
        if next == TAIL.load(Ordering::Relaxed) {
            return false;
        }
        HEAD.store(next, Ordering::Release);
        true
    }
}

impl Consumer {
    /// Entries that wait.
    pub fn len(&self) -> usize {
        let (head, tail) = (HEAD.load(Ordering::Acquire), TAIL.load(Ordering::Relaxed));
        (head.wrapping_sub(tail) & MASK) as usize
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The oldest entry.
    pub fn peek(&self) -> Option<&Entry> {
        // SAFETY: between `tail` and `head` all entries are written, and stay until `tail` moves, which takes `&mut self`.
        (!self.is_empty()).then(|| unsafe { &*slot(TAIL.load(Ordering::Relaxed)) })
    }

    /// Frees the oldest entry; whether there was one.
    pub fn drop_oldest(&mut self) -> bool {
        let is_one = !self.is_empty();
        if is_one {
            let next = (TAIL.load(Ordering::Relaxed) + 1) & MASK;
            TAIL.store(next, Ordering::Release);
        }
        is_one
    }
}
