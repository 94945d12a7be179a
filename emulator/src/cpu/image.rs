//! The firmware as `cargo` linked it: what to load where, its symbols, its instruction lengths.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use object::{Endianness, read::elf::ProgramHeader};
use object::{Object, ObjectSegment, ObjectSymbol, elf::FileHeader32, read::elf::ElfFile};

/// Flash starts here.
pub const FLASH: u32 = 0x0800_0000;

/// A firmware ELF, read once and shared by every machine that boots it.
pub struct Image {
    /// Where it came from, for messages.
    pub path: PathBuf,
    /// The file's bytes: the defmt decoder reads its table from them.
    pub elf: Vec<u8>,
    /// `(load address, bytes)` of every loadable segment in flash.
    pub segments: Vec<(u32, Vec<u8>)>,
    /// `(run address, bytes)` of segments that start-up code copies to RAM: code in CCM is looked for here.
    pub ram_segments: Vec<(u32, Vec<u8>)>,
    code: Vec<(u32, u32)>,
    symbols: BTreeMap<String, (u32, u32)>,
    functions: Vec<(u32, u32, String)>,
}

impl Image {
    /// Reads and checks an ELF: 32-bit Arm, a vector table at the start of flash.
    pub fn load(path: impl AsRef<Path>) -> Result<Image> {
        let path = path.as_ref().to_path_buf();
        let name = path.display();
        let elf = std::fs::read(&path).with_context(|| {
            format!("{name}: cannot read the firmware; build it with `cargo xtask firmware`")
        })?;
        let file: ElfFile<'_, FileHeader32<Endianness>> = ElfFile::parse(&*elf)
            .with_context(|| format!("{name}: not a 32-bit ELF file; expected the firmware that `cargo xtask firmware` built"))?;
        ensure!(
            file.architecture() == object::Architecture::Arm,
            "{name}: built for {:?}, expected Arm",
            file.architecture()
        );
        let endian = file.endian();
        let (mut segments, mut ram_segments, mut code) = (Vec::new(), Vec::new(), Vec::new());
        for segment in file.segments() {
            let header = segment.elf_program_header();
            let (load, run) = (header.p_paddr(endian), header.p_vaddr(endian));
            let data = segment
                .data()
                .with_context(|| format!("{name}: truncated segment at {load:#010x}"))?;
            if data.is_empty() {
                continue;
            }
            ensure!(
                load >= FLASH && load as usize + data.len() <= FLASH as usize + 256 * 1024,
                "{name}: a segment loads at {load:#010x}..{:#010x}, expected flash bank 1 (0x08000000..0x08040000)",
                load as usize + data.len()
            );
            segments.push((load, data.to_vec()));
            if run != load {
                if header.p_flags(endian) & object::elf::PF_X != 0 {
                    code.push((run, run + data.len() as u32));
                }
                ram_segments.push((run, data.to_vec()));
            }
        }
        if !segments.iter().any(|(at, data)| *at == FLASH && data.len() >= 8) {
            bail!("{name}: nothing loads at 0x08000000, expected the vector table there");
        }
        let mut symbols = BTreeMap::new();
        let mut functions = Vec::new();
        for symbol in file.symbols() {
            let Ok(text) = symbol.name() else { continue };
            symbols.insert(text.to_owned(), (symbol.address() as u32, symbol.size() as u32));
            if symbol.kind() == object::SymbolKind::Text && symbol.size() > 0 {
                functions.push((
                    symbol.address() as u32 & !1,
                    symbol.size() as u32,
                    text.to_owned(),
                ));
            }
        }
        functions.sort();
        drop(file);
        Ok(Image { path, elf, segments, ram_segments, code, symbols, functions })
    }

    /// Address of a symbol.
    pub fn symbol(&self, name: &str) -> Option<u32> {
        self.symbols.get(name).map(|s| s.0)
    }

    /// The address of the first symbol, by name, that has this in its name.
    pub fn symbol_with(&self, part: &str) -> Option<u32> {
        self.symbols.iter().find(|(name, _)| name.contains(part)).map(|(_, s)| s.0)
    }

    /// The function an address lies in, as linked (mangled), with its offset.
    pub fn function_at(&self, address: u32) -> Option<(&str, u32)> {
        let address = address & !1;
        let i = self.functions.partition_point(|f| f.0 <= address).checked_sub(1)?;
        let (start, size, name) = &self.functions[i];
        (address < start + size).then_some((name.as_str(), address - start))
    }

    /// Whether the image puts code into `len` bytes of RAM at `start`.
    pub fn runs_code(&self, start: u32, len: u32) -> bool {
        self.code.iter().any(|(a, b)| *a < start + len && start < *b)
    }

    /// Bytes of flash used.
    pub fn flash_bytes(&self) -> usize {
        self.segments.iter().map(|s| s.1.len()).sum()
    }

    /// Run addresses of every half-word that could be the hint instruction `op` (WFE 0xbf20, WFI 0xbf30, SEV
    /// 0xbf40). Data may be among them: a hook there never fires.
    pub fn hints(&self, op: u16) -> Vec<u32> {
        let runs = self.segments.iter().chain(&self.ram_segments);
        let mut out: Vec<u32> = runs
            .flat_map(|(base, data)| {
                data.chunks_exact(2)
                    .enumerate()
                    .filter(move |(_, h)| u16::from_le_bytes([h[0], h[1]]) == op)
                    .map(move |(i, _)| base + 2 * i as u32)
            })
            .collect();
        out.sort_unstable();
        out.dedup();
        out
    }
}

/// Whether a Thumb half-word begins a 32-bit instruction (ARM DDI 0403 A5.1).
pub fn is_wide(halfword: u16) -> bool {
    halfword >> 11 >= 0b11101
}

#[cfg(test)]
mod tests {
    use super::is_wide;

    #[test]
    fn instruction_lengths() {
        for (h, wide) in [
            (0xbf00, false),
            (0xe7fe, false),
            (0xf000, true),
            (0xe92d, true),
            (0xeeb0, true),
            (0x4770, false),
        ] {
            assert_eq!(is_wide(h), wide, "{h:04x}");
        }
    }
}
