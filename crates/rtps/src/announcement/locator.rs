//! Addresses (§9.3.2.3).

use crate::limits::LOCATORS_MAX;
use crate::wire::cursor::{Cursor, Malformed};
use crate::wire::parameters::ParameterWriter;
use std::net::{Ipv4Addr, SocketAddrV4};

/// `LOCATOR_KIND_INVALID`.
const INVALID: i32 = -1;
/// `LOCATOR_KIND_UDPv4`.
const UDP_V4: i32 = 1;

/// The transport that a locator names.
pub(super) enum Locator {
    UdpV4(SocketAddrV4),
    /// Shared memory, TCP, IPv6.
    Other,
    /// Nothing that can be reached.
    None,
}

impl Locator {
    pub(super) fn read(value: &mut Cursor) -> Result<Self, Malformed> {
        let (kind, port) = (value.i32()?, value.u32()?);
        let address: [u8; 16] = value.array()?;
        let [.., a, b, c, d] = address;
        let address = Ipv4Addr::new(a, b, c, d);
        Ok(match (kind, u16::try_from(port)) {
            (INVALID, _) | (UDP_V4, Ok(0) | Err(_)) => Self::None,
            (UDP_V4, _) if address.is_unspecified() || address.is_broadcast() => Self::None,
            (UDP_V4, Ok(port)) => Self::UdpV4(SocketAddrV4::new(address, port)),
            _ => Self::Other,
        })
    }

    /// Keeps a unicast address, at most [`LOCATORS_MAX`] of them.
    pub(super) fn add_unicast(&self, list: &mut Vec<SocketAddrV4>) {
        self.add(list, |address| !address.is_multicast());
    }

    /// Keeps a multicast address, at most [`LOCATORS_MAX`] of them.
    pub(super) fn add_multicast(&self, list: &mut Vec<SocketAddrV4>) {
        self.add(list, Ipv4Addr::is_multicast);
    }

    fn add(&self, list: &mut Vec<SocketAddrV4>, fits: impl Fn(&Ipv4Addr) -> bool) {
        if let Self::UdpV4(address) = self
            && fits(address.ip())
            && list.len() < LOCATORS_MAX
            && !list.contains(address)
        {
            list.push(*address);
        }
    }
}

pub(super) fn write(id: u16, addresses: &[SocketAddrV4], list: &mut ParameterWriter<'_>) {
    for address in addresses {
        list.add(id, |value| {
            value.i32(UDP_V4);
            value.u32(address.port().into());
            value.slice(&[0; 12]);
            value.slice(&address.ip().octets());
        });
    }
}
