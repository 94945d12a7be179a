//! The walk from the tick's vector through everything that it can call.
//!
//! The vector table says where the handlers are; from there every instruction of every function is looked at, and every call and
//! every jump out of a function is followed. What is reached must lie in CCM RAM and must not be, by its name, a panic, a memory
//! routine or a division; an indirect call cannot be followed and is therefore an error. Linker thunks are seen through.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, Result};

use super::image::{CCM, Function, Image, is_in};
use super::thumb::{self, Flow};

/// Handlers that run at P0: name, position in the vector table (RM0440 table 97, 16 exceptions before).
const ROOTS: [(&str, u64); 2] = [("ADC3", 16 + 47), ("TIM7_DAC", 16 + 55)];

/// Parts of names that must not be reachable, and why.
const FORBIDDEN: [(&str, &str); 12] = [
    ("panic", "can panic"),
    ("unwrap_failed", "can panic"),
    ("expect_failed", "can panic"),
    ("_fail", "can panic"),
    ("memcpy", "copies by a call"),
    ("memmove", "copies by a call"),
    ("memset", "fills by a call"),
    ("memclr", "fills by a call"),
    ("ldivmod", "divides 64 bits"),
    ("div", "divides by a call"),
    ("critical_section", "masks interrupts"),
    ("defmt", "logs"),
];

/// What a function does.
#[derive(Default)]
struct Content {
    instructions: u64,
    targets: BTreeSet<u64>,
    /// Addresses of calls that cannot be followed.
    indirect: Vec<u64>,
}

/// Walks, prints what was reached, and returns what is wrong.
pub fn walk(image: &Image<'_>) -> Result<Vec<String>> {
    let mut problems = Vec::new();
    println!("\ncall graph of the tick, from the vector table:");
    let mut total = (0, 0, 0);
    let mut seen = BTreeMap::new();
    for (name, index) in ROOTS {
        let vector = image.vector(index)?;
        println!("vector {index} ({name}) -> {vector:#010x}");
        if vector & 1 == 0 {
            problems.push(format!("the vector of {name} is no Thumb address"));
        }
        visit(image, vector & !1, 1, &mut seen, &mut problems)?;
    }
    for (size, instructions) in seen.values() {
        total = (total.0 + 1, total.1 + size, total.2 + instructions);
    }
    println!("{} functions, {} bytes, {} instructions", total.0, total.1, total.2);
    let out = seen.keys().filter(|address| !is_in(CCM, **address)).count();
    println!("outside CCM RAM: {out}; not allowed: {}", problems.len());
    Ok(problems)
}

fn visit(
    image: &Image<'_>,
    address: u64,
    depth: usize,
    seen: &mut BTreeMap<u64, (u64, u64)>,
    problems: &mut Vec<String>,
) -> Result<()> {
    let indent = "  ".repeat(depth);
    let Some(function) = image.function_at(address) else {
        println!("{indent}{address:#010x} ?");
        problems.push(format!("{address:#010x} is called but no function"));
        return Ok(());
    };
    let memory = if is_in(CCM, function.address) { "CCM" } else { "flash" };
    if seen.contains_key(&function.address) {
        println!("{indent}{:#010x} {} (see above)", function.address, function.name);
        return Ok(());
    }
    let content = scan(image, function)?;
    seen.insert(function.address, (function.size, content.instructions));
    println!(
        "{indent}{:#010x} {} ({memory}, {} bytes, {} instructions, {} calls)",
        function.address,
        function.name,
        function.size,
        content.instructions,
        content.targets.len() + content.indirect.len()
    );
    if memory != "CCM" {
        problems.push(format!("{} lies in {memory} at {:#010x}", function.name, function.address));
    }
    let name = function.name.to_lowercase();
    if let Some((_, why)) = FORBIDDEN.iter().find(|(part, _)| name.contains(part)) {
        problems.push(format!("{} {why}", function.name));
    }
    for at in &content.indirect {
        problems.push(format!("{} calls through a pointer at {at:#010x}", function.name));
    }
    for target in content.targets {
        visit(image, target, depth + 1, seen, problems)?;
    }
    Ok(())
}

/// Looks at every instruction of a function.
fn scan(image: &Image<'_>, function: &Function) -> Result<Content> {
    let mut content = Content::default();
    let end = function.address + function.size;
    let mut address = function.address;
    // What MOVW and MOVT put into a register last: a thunk jumps there.
    let mut immediate: Option<u32> = None;
    while address < end {
        if !image.is_code(address) {
            address += 2;
            continue;
        }
        let first = image.halfword(address).with_context(|| function.name.clone())?;
        let length = thumb::length(first);
        let flow = if length == 4 {
            let second = image.halfword(address + 2)?;
            immediate = match thumb::move_immediate(first, second) {
                Some((false, low)) => Some(low),
                Some((true, high)) => immediate.map(|low| low & 0xffff | high << 16),
                None => immediate,
            };
            thumb::decode_32(address, first, second)
        } else {
            thumb::decode_16(address, first)
        };
        content.instructions += 1;
        match flow {
            Flow::Call(target) => {
                content.targets.insert(target);
            }
            Flow::Jump(target) if !(function.address..end).contains(&target) => {
                content.targets.insert(target);
            }
            Flow::Indirect if function.name.contains("Thunk") => {
                let target = immediate.context("a thunk without an address")?;
                content.targets.insert(u64::from(target & !1));
            }
            Flow::Indirect => content.indirect.push(address),
            Flow::Jump(_) | Flow::Next | Flow::Return | Flow::Table => {}
        }
        address += length;
    }
    Ok(content)
}
