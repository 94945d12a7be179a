//! USB descriptors, read as a host reads them and checked field by field (USB 2.0 chapter 9; USB 3.2 9.6.2 for BOS;
//! Microsoft OS 2.0 Descriptors Specification). A deviation is a sentence, never a panic.

/// An endpoint as described.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// bEndpointAddress: direction in bit 7.
    pub address: u8,
    /// Transfer type: 2 bulk, 3 interrupt.
    pub kind: u8,
    /// wMaxPacketSize.
    pub max_packet: u16,
    /// Interface it belongs to.
    pub interface: u8,
}

/// What a host knows about a device after it looked at it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Device {
    /// idVendor.
    pub vid: u16,
    /// idProduct.
    pub pid: u16,
    /// bcdUSB.
    pub usb: u16,
    /// bcdDevice.
    pub release: u16,
    /// bDeviceClass, subclass, protocol.
    pub class: [u8; 3],
    /// iManufacturer, iProduct, iSerialNumber.
    pub string_index: [u8; 3],
    /// Manufacturer, product and serial number strings.
    pub strings: [String; 3],
    /// bConfigurationValue of the first configuration.
    pub configuration: u8,
    /// bMaxPower in mA.
    pub max_power_ma: u16,
    /// bmAttributes of the configuration.
    pub attributes: u8,
    /// `(number, class, subclass, protocol)` of every interface.
    pub interfaces: Vec<[u8; 4]>,
    /// Every endpoint but 0.
    pub endpoints: Vec<Endpoint>,
    /// Vendor code and length of the Microsoft OS 2.0 descriptor set, from the BOS.
    pub msos: Option<(u8, u16)>,
    /// Compatible IDs in the set, "WINUSB" for a driverless device.
    pub compatible_ids: Vec<String>,
    /// `DeviceInterfaceGUIDs` in the set.
    pub interface_guids: Vec<String>,
    /// Everything a strict host would object to.
    pub problems: Vec<String>,
}

fn u16_at(b: &[u8], at: usize) -> u16 {
    b.get(at..at + 2).map_or(0, |s| u16::from_le_bytes([s[0], s[1]]))
}

impl Device {
    /// The first bulk endpoint of a direction.
    pub fn bulk(&self, input: bool) -> Option<u8> {
        self.endpoints
            .iter()
            .find(|e| e.kind == 2 && (e.address & 0x80 != 0) == input)
            .map(|e| e.address & 15)
    }

    fn problem(&mut self, what: impl Into<String>) {
        self.problems.push(what.into());
    }

    fn expect<T: PartialEq + std::fmt::Debug>(&mut self, field: &str, found: T, expected: T) {
        if found != expected {
            self.problem(format!("{field} is {found:?}, expected {expected:?}"));
        }
    }

    /// Device descriptor (9.6.1).
    pub fn read_device(&mut self, b: &[u8]) {
        self.expect("device descriptor length", b.len(), 18);
        if b.len() < 18 {
            return;
        }
        self.expect("device bLength", b[0], 18);
        self.expect("device bDescriptorType", b[1], 1);
        self.usb = u16_at(b, 2);
        if !matches!(self.usb, 0x0200 | 0x0201 | 0x0210) {
            self.problem(format!("bcdUSB is {:#06x}, expected 0x0200, 0x0201 or 0x0210", self.usb));
        }
        self.class = [b[4], b[5], b[6]];
        self.expect("bMaxPacketSize0", b[7], 64);
        (self.vid, self.pid, self.release) = (u16_at(b, 8), u16_at(b, 10), u16_at(b, 12));
        self.string_index = [b[14], b[15], b[16]];
        for (name, index) in
            ["iManufacturer", "iProduct", "iSerialNumber"].iter().zip(self.string_index)
        {
            if index == 0 {
                self.problem(format!("{name} is 0: no string"));
            }
        }
        self.expect("bNumConfigurations", b[17], 1);
    }

    /// Configuration descriptor and everything behind it (9.6.3, 9.6.5, 9.6.6).
    pub fn read_configuration(&mut self, b: &[u8]) {
        if b.len() < 9 {
            return self.problem(format!(
                "configuration descriptor has {} bytes, expected at least 9",
                b.len()
            ));
        }
        self.expect("configuration bDescriptorType", b[1], 2);
        self.expect("wTotalLength", u16_at(b, 2) as usize, b.len());
        let interfaces = b[4];
        self.configuration = b[5];
        if self.configuration == 0 {
            self.problem("bConfigurationValue is 0, which means unconfigured");
        }
        self.attributes = b[7];
        self.expect("bmAttributes bit 7", b[7] >> 7, 1);
        self.expect("bmAttributes bits 4..0", b[7] & 0x1f, 0);
        self.max_power_ma = b[8] as u16 * 2;
        let (mut at, mut declared, mut current) = (0, 0, 0);
        while at + 2 <= b.len() {
            let length = b[at] as usize;
            if length < 2 || at + length > b.len() {
                return self.problem(format!(
                    "descriptor at offset {at} has bLength {length}, {} bytes are left",
                    b.len() - at
                ));
            }
            let d = &b[at..at + length];
            match d[1] {
                4 if length == 9 => {
                    current = d[2];
                    if d[3] == 0 {
                        self.interfaces.push([d[2], d[5], d[6], d[7]]);
                        declared += d[4] as usize;
                    }
                }
                5 if length == 7 => {
                    let e = Endpoint {
                        address: d[2],
                        kind: d[3] & 3,
                        max_packet: u16_at(d, 4),
                        interface: current,
                    };
                    if e.kind == 2 && !matches!(e.max_packet, 8 | 16 | 32 | 64) {
                        self.problem(format!(
                            "bulk endpoint {:#04x} has wMaxPacketSize {}",
                            e.address, e.max_packet
                        ));
                    }
                    if self.endpoints.iter().any(|o| o.address == e.address) {
                        self.problem(format!("endpoint {:#04x} is described twice", e.address));
                    }
                    self.endpoints.push(e);
                }
                4 | 5 => self.problem(format!("descriptor type {} has bLength {length}", d[1])),
                _ => {}
            }
            at += length;
        }
        self.expect("bNumInterfaces", interfaces as usize, self.interfaces.len());
        self.expect("sum of bNumEndpoints", declared, self.endpoints.len());
    }

    /// A string descriptor (9.6.7).
    pub fn read_string(&mut self, which: usize, b: &[u8]) {
        let name = ["manufacturer", "product", "serial number"][which];
        if b.len() < 2 || b[0] as usize != b.len() || b[1] != 3 || !b.len().is_multiple_of(2) {
            return self.problem(format!("{name} string descriptor is malformed: {b:02x?}"));
        }
        let units: Vec<u16> =
            b[2..].chunks_exact(2).map(|c| u16::from_le_bytes([c[0], c[1]])).collect();
        match String::from_utf16(&units) {
            Ok(s) if !s.is_empty() => self.strings[which] = s,
            _ => self.problem(format!("{name} string is empty or not UTF-16")),
        }
    }

    /// Binary object store: finds the Microsoft OS 2.0 platform capability.
    pub fn read_bos(&mut self, b: &[u8]) {
        const MS_OS_20: [u8; 16] = [
            0xdf, 0x60, 0xdd, 0xd8, 0x89, 0x45, 0xc7, 0x4c, 0x9c, 0xd2, 0x65, 0x9d, 0x9e, 0x64,
            0x8a, 0x9f,
        ];
        if b.len() < 5 || b[0] != 5 || b[1] != 15 {
            return self.problem(format!("BOS descriptor is malformed: {b:02x?}"));
        }
        self.expect("BOS wTotalLength", u16_at(b, 2) as usize, b.len());
        let (mut at, mut capabilities) = (5, 0);
        while at + 3 <= b.len() {
            let length = b[at] as usize;
            if length < 3 || at + length > b.len() {
                return self.problem(format!("BOS capability at {at} has bLength {length}"));
            }
            let d = &b[at..at + length];
            self.expect("BOS capability bDescriptorType", d[1], 16);
            capabilities += 1;
            if d[2] == 5 && length >= 28 && d[4..20] == MS_OS_20 {
                if u32::from_le_bytes([d[20], d[21], d[22], d[23]]) < 0x0603_0000 {
                    self.problem("MS OS 2.0 dwWindowsVersion is below 0x06030000 (Windows 8.1)");
                }
                self.msos = Some((d[26], u16_at(d, 24)));
            }
            at += length;
        }
        self.expect("BOS bNumDeviceCaps", b[4] as usize, capabilities);
    }

    /// Microsoft OS 2.0 descriptor set: headers, subsets, compatible IDs, registry properties.
    pub fn read_msos(&mut self, b: &[u8]) {
        if b.len() < 10 || u16_at(b, 0) != 10 || u16_at(b, 2) != 0 {
            return self.problem(format!("MS OS 2.0 set header is malformed: {b:02x?}"));
        }
        self.expect("MS OS 2.0 wTotalLength", u16_at(b, 8) as usize, b.len());
        if let Some((_, length)) = self.msos {
            self.expect("MS OS 2.0 set length in the BOS", length as usize, b.len());
        }
        let mut at = 10;
        while at + 4 <= b.len() {
            let (length, kind) = (u16_at(b, at) as usize, u16_at(b, at + 2));
            if length < 4 || at + length > b.len() {
                return self.problem(format!("MS OS 2.0 descriptor at {at} has wLength {length}"));
            }
            let d = &b[at..at + length];
            match kind {
                // Configuration and function subset headers: bytes from the header to the end of the subset.
                1 | 2 => {
                    self.expect("MS OS 2.0 subset length", u16_at(d, 6) as usize, b.len() - at);
                }
                3 if length == 20 => {
                    let id: String =
                        d[4..12].iter().take_while(|c| **c != 0).map(|c| *c as char).collect();
                    self.compatible_ids.push(id);
                }
                4 => self.read_property(d),
                _ => self.problem(format!("MS OS 2.0 descriptor type {kind} with length {length}")),
            }
            at += length;
        }
        self.expect("bytes behind the last MS OS 2.0 descriptor", b.len() - at, 0);
    }

    fn read_property(&mut self, d: &[u8]) {
        let wide = |s: &[u8]| {
            let units: Vec<u16> =
                s.chunks_exact(2).map(|c| u16::from_le_bytes([c[0], c[1]])).collect();
            String::from_utf16_lossy(&units)
        };
        let (kind, name_length) = (u16_at(d, 4), u16_at(d, 6) as usize);
        let Some(name) = d.get(8..8 + name_length) else {
            return self.problem(format!(
                "registry property name length {name_length} exceeds the descriptor"
            ));
        };
        let data_length = u16_at(d, 8 + name_length) as usize;
        let Some(data) = d.get(10 + name_length..10 + name_length + data_length) else {
            return self.problem(format!(
                "registry property data length {data_length} exceeds the descriptor"
            ));
        };
        let name = wide(name);
        if name == "DeviceInterfaceGUIDs\0" {
            self.expect("DeviceInterfaceGUIDs property type (7 = REG_MULTI_SZ)", kind, 7);
            let text = wide(data);
            if !text.ends_with("\0\0") {
                self.problem("DeviceInterfaceGUIDs does not end in two NULs");
            }
            self.interface_guids
                .extend(text.split('\0').filter(|s| !s.is_empty()).map(str::to_owned));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_total_length_is_named() {
        let mut d = Device::default();
        let mut c = vec![9, 2, 32, 0, 1, 1, 0, 0x80, 50, 9, 4, 0, 0, 2, 0xff, 0, 0, 0];
        c.extend([7, 5, 0x81, 2, 64, 0, 0, 7, 5, 0x01, 2, 64, 0, 0]);
        d.read_configuration(&c);
        assert!(d.problems.is_empty(), "{:?}", d.problems);
        assert_eq!((d.bulk(true), d.bulk(false), d.max_power_ma), (Some(1), Some(1), 100));
        let mut d = Device::default();
        c[2] = 40;
        c[4] = 2;
        d.read_configuration(&c);
        assert_eq!(d.problems.len(), 2);
        assert!(d.problems[0].contains("wTotalLength is 40, expected 32"));
    }
}
