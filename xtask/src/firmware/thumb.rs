//! Where Thumb-2 code goes: just enough decoding to follow calls.
//!
//! Instruction lengths and the branch encodings of the ARMv7-M Architecture Reference Manual, sections A5.1, A5.3 and A7.7. Everything
//! that does not change the program counter is skipped unread, so no encoding that the compiler may use can be unknown.

/// What an instruction does to the program counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flow {
    /// Nothing.
    Next,
    /// `BL`: a call.
    Call(u64),
    /// `B`, `B<c>`, `CBZ`: a jump, within the function or to another.
    Jump(u64),
    /// `BLX Rm`, `BX Rm`, `MOV PC, Rm`, `LDR PC, [..]`: the target is not in the instruction.
    Indirect,
    /// `BX LR`, `POP {..PC}`: return.
    Return,
    /// `TBB`, `TBH`: a jump table behind the instruction, within the function.
    Table,
}

/// Length of the instruction that starts with this halfword.
pub fn length(first: u16) -> u64 {
    if first >> 11 >= 0b11101 { 4 } else { 2 }
}

fn sign_extend(value: u32, bits: u32) -> i64 {
    i64::from((value << (32 - bits)) as i32 >> (32 - bits))
}

/// Decodes a 16-bit instruction at `address`.
pub fn decode_16(address: u64, half: u16) -> Flow {
    let word = u32::from(half);
    let to = |offset: i64| Flow::Jump((address + 4).wrapping_add_signed(offset));
    match half {
        // B<c> T1; conditions 14 and 15 are UDF and SVC.
        _ if half >> 12 == 0b1101 && (half >> 8) & 0xf < 14 => to(sign_extend(word & 0xff, 8) * 2),
        // B T2
        _ if half >> 11 == 0b11100 => to(sign_extend(word & 0x7ff, 11) * 2),
        // CBZ, CBNZ
        _ if half & 0xf500 == 0xb100 => {
            to(i64::from((word >> 3 & 0x1f) << 1 | (word >> 9 & 1) << 6))
        }
        0x4770 => Flow::Return,
        // BX Rm, BLX Rm
        _ if half & 0xff00 == 0x4700 => Flow::Indirect,
        // MOV PC, Rm and ADD PC, Rm
        _ if half & 0xff87 == 0x4687 || half & 0xff87 == 0x4487 => Flow::Indirect,
        // POP {.., PC}
        _ if half & 0xff00 == 0xbd00 => Flow::Return,
        _ => Flow::Next,
    }
}

/// Decodes a 32-bit instruction at `address`.
pub fn decode_32(address: u64, first: u16, second: u16) -> Flow {
    let (a, b) = (u32::from(first), u32::from(second));
    let sign = a >> 10 & 1;
    let (j1, j2) = (b >> 13 & 1, b >> 11 & 1);
    let to = |offset: i64| (address + 4).wrapping_add_signed(offset);
    let far = || {
        let (i1, i2) = (!(j1 ^ sign) & 1, !(j2 ^ sign) & 1);
        let bits = sign << 24 | i1 << 23 | i2 << 22 | (a & 0x3ff) << 12 | (b & 0x7ff) << 1;
        to(sign_extend(bits, 25))
    };
    if a >> 11 == 0b11110 && b >> 15 == 1 {
        return match (b >> 14 & 1, b >> 12 & 1) {
            (1, 1) => Flow::Call(far()),
            (0, 1) => Flow::Jump(far()),
            // B<c>.W T3; condition 14 and 15 are other instructions.
            (0, 0) if a >> 6 & 0xf < 14 => {
                let bits = sign << 20 | j2 << 19 | j1 << 18 | (a & 0x3f) << 12 | (b & 0x7ff) << 1;
                Flow::Jump(to(sign_extend(bits, 21)))
            }
            _ => Flow::Next,
        };
    }
    // TBB, TBH
    if a & 0xfff0 == 0xe8d0 && b & 0xffe0 == 0xf000 {
        return Flow::Table;
    }
    // LDMIA SP!, {.., PC}
    if a == 0xe8bd && b >> 15 == 1 {
        return Flow::Return;
    }
    // LDR.W PC, [SP], #4 is a return too, LDR.W PC, [..] is not; LDM Rn, {.., PC} neither.
    if a == 0xf85d && b == 0xfb04 {
        return Flow::Return;
    }
    let loads_pc = a & 0xff70 == 0xf850 && b >> 12 == 0xf;
    let loads_many_to_pc = (a & 0xffd0 == 0xe890 || a & 0xffd0 == 0xe910) && b >> 15 == 1;
    if loads_pc || loads_many_to_pc { Flow::Indirect } else { Flow::Next }
}

/// The value that `MOVW` or `MOVT` carries.
pub fn move_immediate(first: u16, second: u16) -> Option<(bool, u32)> {
    let is_top = match first & 0xfbf0 {
        0xf240 => false,
        0xf2c0 => true,
        _ => return None,
    };
    let (a, b) = (u32::from(first), u32::from(second));
    Some((is_top, (a & 0xf) << 12 | (a >> 10 & 1) << 11 | (b >> 12 & 7) << 8 | (b & 0xff)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Encodings as llvm-mc (LLVM 14, thumbv7em) assembles them.
    #[test]
    fn branches_as_assembled() {
        assert_eq!(decode_16(0x100, 0xe7fe), Flow::Jump(0x100)); // b .
        assert_eq!(decode_16(0x100, 0xd001), Flow::Jump(0x106)); // beq .+6
        assert_eq!(decode_16(0x100, 0xb118), Flow::Jump(0x10a)); // cbz r0, .+10
        assert_eq!(decode_16(0x100, 0x4770), Flow::Return); // bx lr
        assert_eq!(decode_16(0x100, 0x4760), Flow::Indirect); // bx ip
        assert_eq!(decode_16(0x100, 0x4798), Flow::Indirect); // blx r3
        assert_eq!(decode_16(0x100, 0xbd80), Flow::Return); // pop {r7, pc}
        assert_eq!(decode_16(0x100, 0xde00), Flow::Next); // udf
        assert_eq!(decode_32(0x100, 0xf000, 0xf800), Flow::Call(0x104)); // bl .+4
        assert_eq!(decode_32(0x100, 0xf7ff, 0xfffe), Flow::Call(0x100)); // bl .
        assert_eq!(decode_32(0x100, 0xf7ff, 0xbffe), Flow::Jump(0x100)); // b.w .
        assert_eq!(decode_32(0x100, 0xf43f, 0xaffe), Flow::Jump(0x100)); // beq.w .
        assert_eq!(decode_32(0x100, 0xe8df, 0xf000), Flow::Table); // tbb [pc, r0]
        assert_eq!(decode_32(0x100, 0xe8bd, 0x8ff0), Flow::Return); // pop.w {r4-r11, pc}
        assert_eq!(decode_32(0x100, 0xf85d, 0xfb04), Flow::Return); // ldr pc, [sp], #4
        assert_eq!(decode_32(0x100, 0xf8df, 0xf004), Flow::Indirect); // ldr.w pc, [pc, #4]
        assert_eq!(decode_32(0x100, 0xfb80, 0x2301), Flow::Next); // smull r2, r3, r0, r1
    }

    #[test]
    fn immediates_as_assembled() {
        // movw ip, #0x9aa4 and movt ip, #0x801
        assert_eq!(move_immediate(0xf649, 0x2ca4), Some((false, 0x9aa4)));
        assert_eq!(move_immediate(0xf6c0, 0x0c01), Some((true, 0x0801)));
        assert_eq!(move_immediate(0xf000, 0xf800), None);
    }
}
