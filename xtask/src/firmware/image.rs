//! The linked image: which memory it takes, which function lies where.

use anyhow::{Context, Result, bail};
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use object::{Endianness, Object, ObjectSection, ObjectSymbol, SectionFlags, SymbolKind};

const KIB: u64 = 1024;
/// Flash bank 1: start, length.
pub const FLASH: (u64, u64) = (0x0800_0000, 256 * KIB);
/// SRAM1 and SRAM2.
pub const RAM: (u64, u64) = (0x2000_0000, 96 * KIB);
/// CCM SRAM.
pub const CCM: (u64, u64) = (0x1000_0000, 32 * KIB);
/// The most that the image may take of flash, RAM and CCM RAM.
const BUDGET: [u64; 3] = [128 * KIB, 64 * KIB, 32 * KIB];

/// Whether an address lies in a memory.
pub fn is_in(memory: (u64, u64), address: u64) -> bool {
    (memory.0..memory.0 + memory.1).contains(&address)
}

/// A function of the image.
#[derive(Clone, Debug)]
pub struct Function {
    /// Demangled name.
    pub name: String,
    /// First instruction.
    pub address: u64,
    /// Bytes.
    pub size: u64,
}

/// An image and its functions, in order of their addresses.
pub struct Image<'a> {
    file: ElfFile32<'a, Endianness>,
    functions: Vec<Function>,
    /// Mapping symbols: addresses where code starts or ends (Arm ELF, section 4.5.5).
    code_marks: Vec<(u64, bool)>,
}

impl<'a> Image<'a> {
    /// Reads an ELF file.
    pub fn parse(bytes: &'a [u8]) -> Result<Self> {
        let file = ElfFile32::<Endianness>::parse(bytes).context("not a 32-bit ELF file")?;
        let mut functions = Vec::new();
        let mut code_marks = Vec::new();
        for symbol in file.symbols() {
            let name = symbol.name().unwrap_or_default();
            if symbol.kind() == SymbolKind::Text && symbol.size() > 0 {
                functions.push(Function {
                    name: format!("{:#}", rustc_demangle::demangle(name)),
                    address: symbol.address() & !1,
                    size: symbol.size(),
                });
            } else if name.starts_with("$t") || name.starts_with("$d") {
                code_marks.push((symbol.address(), name.starts_with("$t")));
            }
        }
        functions.sort_by_key(|function| function.address);
        code_marks.sort_unstable();
        if functions.is_empty() {
            bail!("the image has no symbols: build it without `strip`");
        }
        Ok(Self { file, functions, code_marks })
    }

    /// The function that an address lies in.
    pub fn function_at(&self, address: u64) -> Option<&Function> {
        let after = self.functions.partition_point(|function| function.address <= address);
        let function = self.functions.get(after.checked_sub(1)?)?;
        (address < function.address + function.size).then_some(function)
    }

    /// Whether an address holds code, not a table.
    pub fn is_code(&self, address: u64) -> bool {
        let after = self.code_marks.partition_point(|mark| mark.0 <= address);
        after.checked_sub(1).and_then(|i| self.code_marks.get(i)).is_none_or(|mark| mark.1)
    }

    /// Little-endian halfword at an address.
    pub fn halfword(&self, address: u64) -> Result<u16> {
        let section = self
            .file
            .sections()
            .find(|s| (s.address()..s.address() + s.size()).contains(&address))
            .with_context(|| format!("no section holds {address:#010x}"))?;
        let bytes = section.data_range(address, 2)?.context("no content there")?;
        match bytes {
            [a, b] => Ok(u16::from_le_bytes([*a, *b])),
            _ => bail!("no content at {address:#010x}"),
        }
    }

    /// Entry `index` of the vector table.
    pub fn vector(&self, index: u64) -> Result<u64> {
        let address = FLASH.0 + 4 * index;
        let (low, high) = (self.halfword(address)?, self.halfword(address + 2)?);
        Ok(u64::from(low) | u64::from(high) << 16)
    }

    /// What goes into flash: first address and bytes, gaps filled with ones.
    pub fn flash_content(&self) -> Result<(u64, Vec<u8>)> {
        let endian = self.file.endian();
        let data = self.file.data();
        let mut content: Vec<u8> = Vec::new();
        let header: &FileHeader32<Endianness> = self.file.elf_header();
        for segment in header.program_headers(endian, data)? {
            let bytes = segment.data(endian, data).map_err(|()| anyhow::anyhow!("cut short"))?;
            let address = u64::from(segment.p_paddr(endian));
            if segment.p_type(endian) != PT_LOAD || bytes.is_empty() {
                continue;
            }
            if !is_in(FLASH, address) {
                bail!("a segment is loaded to {address:#010x}, outside flash bank 1");
            }
            let end = (address - FLASH.0) as usize + bytes.len();
            if content.len() < end {
                content.resize(end, 0xff);
            }
            content[end - bytes.len()..end].copy_from_slice(bytes);
        }
        Ok((FLASH.0, content))
    }

    /// Bytes taken in a memory by sections at run time.
    fn at_run_time(&self, memory: (u64, u64)) -> u64 {
        self.file
            .sections()
            .filter(|section| {
                let SectionFlags::Elf { sh_flags } = section.flags() else { return false };
                sh_flags & u64::from(object::elf::SHF_ALLOC) != 0
                    && is_in(memory, section.address())
            })
            .map(|section| section.size())
            .sum()
    }

    fn symbol(&self, name: &str) -> Option<u64> {
        self.file.symbols().find(|s| s.name() == Ok(name)).map(|s| s.address())
    }

    /// Prints what the image takes; what is over budget.
    pub fn print_memory(&self) -> Vec<String> {
        let flash = self.flash_content().map_or(0, |(_, content)| content.len() as u64);
        let ram = self.at_run_time(RAM);
        let stack = match (self.symbol("_stack_end"), self.symbol("_stack_start")) {
            (Some(end), Some(start)) if is_in(CCM, end) => start - end,
            _ => 0,
        };
        let in_ccm = self.at_run_time(CCM);
        println!("\n{:<8} {:>9} {:>9} {:>9}", "memory", "bytes", "budget", "exists");
        let rows =
            [("flash", flash, FLASH.1), ("RAM", ram, RAM.1), ("CCM RAM", in_ccm + stack, CCM.1)];
        let mut over = Vec::new();
        for ((name, bytes, exists), budget) in rows.into_iter().zip(BUDGET) {
            println!("{name:<8} {bytes:>9} {budget:>9} {exists:>9}");
            if bytes > budget {
                over.push(format!("{name}: {bytes} bytes are {} over budget", bytes - budget));
            }
        }
        println!("CCM RAM: {stack} bytes of stack, {in_ccm} of code and tables");
        over
    }
}
