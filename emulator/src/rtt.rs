//! Log messages: the SEGGER RTT ring in the firmware's RAM, decoded with the defmt table of its ELF.

use anyhow::{Result, anyhow};
use defmt_decoder::{DecodeError, Table};

use crate::cpu::image::Image;
use crate::cpu::memory::Memory;
use crate::time::Time;

/// One log message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// When it was fetched: up to 10 ms after it was written.
    pub at: Time,
    /// "error", "warn", "info", "debug", "trace" or "print".
    pub level: String,
    /// The text.
    pub text: String,
}

/// Fetches and decodes.
pub struct Rtt {
    control: Option<u32>,
    table: Option<Table>,
    partial: Vec<u8>,
    /// Everything logged so far.
    pub lines: Vec<Line>,
    /// Print lines to standard error as they come.
    pub echo: bool,
}

impl Rtt {
    /// Finds the control block and the defmt table; an image without them has no log.
    pub fn new(image: &Image) -> Result<Rtt> {
        let table = Table::parse(&image.elf)
            .map_err(|e| anyhow!("{}: defmt table: {e}", image.path.display()))?;
        let control = image.symbol("_SEGGER_RTT");
        Ok(Rtt { control, table, partial: Vec::new(), lines: Vec::new(), echo: false })
    }

    /// Takes what the firmware wrote since the last time.
    pub fn drain(&mut self, _image: &Image, ram: &Memory, base: u32, now: Time) {
        let (Some(control), Some(table)) = (self.control, &self.table) else { return };
        let at = (control - base) as usize;
        // Up channel 0: name, buffer, size, write offset, read offset, flags.
        let [buffer, size, write, read] = [28, 32, 36, 40].map(|o| ram.u32(at + o));
        let inside = buffer >= base && (buffer - base + size) as usize <= ram.len();
        if size == 0 || write == read || write >= size || read >= size || !inside {
            return;
        }
        let mut k = read;
        while k != write {
            let mut byte = [0];
            ram.read((buffer - base + k) as usize, &mut byte);
            self.partial.push(byte[0]);
            k = (k + 1) % size;
        }
        ram.write(at + 40, &write.to_le_bytes());
        // Frames end with a zero byte; what follows the last one waits for the rest.
        let Some(end) = self.partial.iter().rposition(|b| *b == 0) else { return };
        let whole: Vec<u8> = self.partial.drain(..=end).collect();
        let mut decoder = table.new_stream_decoder();
        decoder.received(&whole);
        loop {
            let line = match decoder.decode() {
                Ok(frame) => Line {
                    at: now,
                    level: frame.level().map_or("print", |l| l.as_str()).to_owned(),
                    text: frame.display_message().to_string(),
                },
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) => {
                    Line { at: now, level: "error".into(), text: "malformed defmt frame".into() }
                }
            };
            if self.echo {
                eprintln!(
                    "{:11.3} ms {:5} {}",
                    crate::time::milliseconds(now),
                    line.level,
                    line.text
                );
            }
            self.lines.push(line);
        }
    }
}
