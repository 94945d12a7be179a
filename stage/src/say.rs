//! What commands print. `println!` panics where standard output is full, and for `print!` a reader that left is enough: here both are
//! results.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write, stdout};

use anyhow::Context;

/// A line on standard output.
macro_rules! say {
    ($($text:tt)*) => { $crate::say::text(format_args!("{}\n", format_args!($($text)*))) };
}
pub(crate) use say;

/// Text on standard output as it is. A reader that left (`flexstage ... | head -1`) has all that it wanted: no error.
pub fn text(text: Arguments) -> anyhow::Result<()> {
    let mut out = stdout().lock();
    match out.write_fmt(text).and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("standard output: cannot write"),
    }
}
