//! Copies of two bytes without the ado of long ones.
//!
//! # Design
//! The USB driver moves packets into packet memory two bytes at a time, and because the last piece may be one byte, each is a call to
//! `__aeabi_memcpy` (Run-time ABI for the Arm architecture, 5.3.4). The compiler's own takes a dozen branches before it looks at
//! such a copy, which made them half of the time of the USB task. Its symbol is weak for this purpose: this one takes
//! its place. Lengths other than two go to the compiler's `memcpy`.
//!
//! In assembly, because a compiler may turn any loop or pair of byte copies into a call of the function that it is in.
//!
//! # Limits
//! Half-words may be misaligned here, which the core allows in RAM and flash, the only memory that is copied with this.

core::arch::global_asm!(
    ".pushsection .text.__aeabi_memcpy, \"ax\", %progbits",
    ".global __aeabi_memcpy",
    ".type __aeabi_memcpy, %function",
    ".thumb_func",
    "__aeabi_memcpy:",
    "    cmp r2, #2",
    // Three conditional instructions rather than a branch around them.
    "    ittt eq",
    "    ldrheq r3, [r1]",
    "    strheq r3, [r0]",
    "    bxeq lr",
    "    b.w memcpy",
    ".size __aeabi_memcpy, . - __aeabi_memcpy",
    ".popsection",
);
