//! DfuSe files: what dfu-util and ST's programmer flash over the ROM's USB loader (ST UM0391, USB DFU 1.1 appendix B).

use crc::{CRC_32_JAMCRC, Crc};

/// USB id of the ROM loader.
const VENDOR: u16 = 0x0483;
const PRODUCT: u16 = 0xdf11;

/// A file with one target (alternate setting 0: internal flash) of one element.
pub fn file(address: u64, content: &[u8]) -> Vec<u8> {
    const PREFIX: usize = 11;
    const TARGET_PREFIX: usize = 274;
    const ELEMENT_PREFIX: usize = 8;
    let element = ELEMENT_PREFIX + content.len();
    let mut out = Vec::with_capacity(PREFIX + TARGET_PREFIX + element + 16);
    out.extend(b"DfuSe\x01");
    out.extend(((PREFIX + TARGET_PREFIX + element) as u32).to_le_bytes());
    out.push(1);
    let mut name = [0; 255];
    name[..9].copy_from_slice(b"flexstage");
    out.extend(b"Target\x00");
    out.extend(1u32.to_le_bytes());
    out.extend(name);
    out.extend((element as u32).to_le_bytes());
    out.extend(1u32.to_le_bytes());
    out.extend((address as u32).to_le_bytes());
    out.extend((content.len() as u32).to_le_bytes());
    out.extend(content);
    // Any device release of this product of this vendor, DfuSe 1.1a.
    out.extend(0xffff_u16.to_le_bytes());
    out.extend(PRODUCT.to_le_bytes());
    out.extend(VENDOR.to_le_bytes());
    out.extend(0x011a_u16.to_le_bytes());
    out.extend(b"UFD\x10");
    let sum = Crc::<u32>::new(&CRC_32_JAMCRC).checksum(&out);
    out.extend(sum.to_le_bytes());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_suffix_are_where_dfu_util_looks() {
        let bytes = file(0x0800_0000, &[1, 2, 3, 4]);
        let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!(u32_at(6) as usize + 16, bytes.len());
        assert_eq!(&bytes[11..17], b"Target");
        assert_eq!(u32_at(11 + 266), 12);
        assert_eq!(u32_at(285), 0x0800_0000);
        assert_eq!(&bytes[bytes.len() - 8..bytes.len() - 5], b"UFD");
        let body = &bytes[..bytes.len() - 4];
        assert_eq!(Crc::<u32>::new(&CRC_32_JAMCRC).checksum(body), u32_at(bytes.len() - 4));
    }
}
