//! Host memory that the emulated core reads and writes directly: flash bank 1, SRAM, CCM, USB packet memory.
//!
//! A block is shared between unicorn (through `mem_map_ptr`) and us. One block may be mapped at several addresses,
//! as the chip does with CCM SRAM (0x1000_0000 and 0x2001_8000) and with flash at 0 (RM0440 2.4, 2.6).

use std::alloc::{Layout, alloc_zeroed, dealloc};
use std::cell::Cell;
use std::rc::Rc;

const PAGE: usize = 4096;

struct Block {
    cells: *mut u8,
    len: usize,
}

impl Drop for Block {
    fn drop(&mut self) {
        // SAFETY: allocated in `Memory::new` with this very layout and freed once, by the last owner.
        unsafe { dealloc(self.cells, Layout::from_size_align_unchecked(self.len, PAGE)) }
    }
}

/// A page-aligned block, cheap to clone: clones share the bytes.
#[derive(Clone)]
pub struct Memory {
    block: Rc<Block>,
}

impl Memory {
    /// `len` zero bytes; `len` is a multiple of 4096, as unicorn asks.
    pub fn new(len: usize) -> Memory {
        assert!(len > 0 && len.is_multiple_of(PAGE), "memory length {len} is not whole pages");
        let layout = Layout::from_size_align(len, PAGE).expect("page layout");
        // SAFETY: the layout has a non-zero size.
        let cells = unsafe { alloc_zeroed(layout) };
        assert!(!cells.is_null(), "out of memory");
        Memory { block: Rc::new(Block { cells, len }) }
    }

    /// Length in bytes.
    pub fn len(&self) -> usize {
        self.block.len
    }

    /// Never empty.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The address unicorn maps.
    pub fn pointer(&self) -> *mut core::ffi::c_void {
        self.block.cells.cast()
    }

    fn cells(&self) -> &[Cell<u8>] {
        // SAFETY: the block lives as long as `self`; `Cell<u8>` has the layout of `u8` and allows the writes that
        // translated code makes between our calls. Everything runs on one thread (`Rc` is not `Send`).
        unsafe { std::slice::from_raw_parts(self.block.cells.cast(), self.block.len) }
    }

    /// Copies `out.len()` bytes from `at`.
    pub fn read(&self, at: usize, out: &mut [u8]) {
        let from = &self.cells()[at..at + out.len()];
        for (o, c) in out.iter_mut().zip(from) {
            *o = c.get();
        }
    }

    /// Copies `bytes` to `at`.
    pub fn write(&self, at: usize, bytes: &[u8]) {
        for (b, c) in bytes.iter().zip(&self.cells()[at..at + bytes.len()]) {
            c.set(*b);
        }
    }

    /// Sets every byte.
    pub fn fill(&self, value: u8) {
        self.cells().iter().for_each(|c| c.set(value));
    }

    /// Little-endian half-word at `at`.
    pub fn u16(&self, at: usize) -> u16 {
        let c = self.cells();
        u16::from_le_bytes([c[at].get(), c[at + 1].get()])
    }

    /// Little-endian word at `at`.
    pub fn u32(&self, at: usize) -> u32 {
        let mut b = [0; 4];
        self.read(at, &mut b);
        u32::from_le_bytes(b)
    }

    /// Stores a little-endian half-word.
    pub fn set_u16(&self, at: usize, value: u16) {
        self.write(at, &value.to_le_bytes());
    }

    /// How many bytes from `from` on still have `value`: the untouched part of a painted stack.
    pub fn run_of(&self, value: u8, from: usize) -> usize {
        self.cells()[from..].iter().take_while(|c| c.get() == value).count()
    }
}
