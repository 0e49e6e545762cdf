//! Addresses of nodes: what may be registered, and what is never dialled.
//!
//! A node registers its own address, and every other node dials it. So it must not lead to what only the dialling machine
//! reaches: services of its cloud, its own links, groups. Loopback and private addresses stay allowed, as networks in one
//! machine or one building use them. A name is looked up when it is dialled, and what it leads to is checked then.

use ledger_base::rejection::{Code, Rejection};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

/// Longest address, in bytes.
const ADDRESS_BYTES_MAX: usize = 256;
/// Longest part of a name between two dots, in bytes (RFC 1035 §2.3.4).
const LABEL_BYTES_MAX: usize = 63;
/// Longest name, in bytes (RFC 1035 §2.3.4).
const HOST_BYTES_MAX: usize = 253;
/// Services for virtual machines outside the link-local range: of Alibaba Cloud, Azure and Oracle Cloud.
const METADATA: [Ipv4Addr; 3] =
    [Ipv4Addr::new(100, 100, 100, 200), Ipv4Addr::new(168, 63, 129, 16), Ipv4Addr::new(192, 0, 0, 192)];
/// That of Amazon EC2.
const METADATA_V6: Ipv6Addr = Ipv6Addr::new(0xfd00, 0xec2, 0, 0, 0, 0, 0, 0x254);

/// Checks `HOST:PORT`. The host is a name, or an IP address that nodes dial.
pub(super) fn check_address(address: &str) -> Result<(), Rejection> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.:[]%".contains(c);
    let host = address.rsplit_once(':').filter(|(host, port)| {
        !host.is_empty() && port.parse::<u16>().is_ok_and(|number| number != 0 && number.to_string() == *port)
    });
    let usable = address.len() <= ADDRESS_BYTES_MAX && address.chars().all(plain);
    let refused = |what: &str| {
        Err(Rejection::new(Code::BadArgument, format!("the address of the node {what}"))
            .found(format!("{:?}", address.chars().take(80).collect::<String>()))
            .wanted("HOST:PORT under which the other nodes reach it, such as 10.0.0.4:7450"))
    };
    let Some((host, _)) = host.filter(|_| usable) else { return refused("is not usable") };
    match literal(host) {
        Some(ip) => {
            never_dialled(ip).map_or(Ok(()), |kind| refused(&format!("is {kind}, to which nodes do not connect")))
        }
        None if is_name(host) => Ok(()),
        None => refused("has no usable host"),
    }
}

/// Why nodes never dial this address, in words; none if they may.
pub fn never_dialled(ip: IpAddr) -> Option<&'static str> {
    match ip {
        IpAddr::V4(ip) => never_dialled_v4(ip),
        IpAddr::V6(ip) => match within(ip) {
            Some(inner) => never_dialled_v4(inner),
            None if ip.is_unspecified() => Some("the unspecified address"),
            None if ip.is_multicast() => Some("a multicast address"),
            None if ip.segments()[0] & 0xffc0 == 0xfe80 => Some("a link-local address"),
            None if ip == METADATA_V6 => Some("a metadata service"),
            None => None,
        },
    }
}

fn never_dialled_v4(ip: Ipv4Addr) -> Option<&'static str> {
    match ip.octets() {
        [0, ..] => Some("the unspecified address"),
        [169, 254, ..] => Some("a link-local address"),
        [224..=239, ..] => Some("a multicast address"),
        [240..=255, ..] => Some("a reserved address"),
        _ if METADATA.contains(&ip) => Some("a metadata service"),
        _ => None,
    }
}

/// The IPv4 address inside of one that only wraps it: mapped (RFC 4291 §2.5.5), 6to4 (RFC 3056) and NAT64 (RFC 6052).
fn within(ip: Ipv6Addr) -> Option<Ipv4Addr> {
    let [a, b, c, d, e, f, g, h] = ip.segments();
    let v4 = |high: u16, low: u16| {
        let ([a, b], [c, d]) = (high.to_be_bytes(), low.to_be_bytes());
        Ipv4Addr::new(a, b, c, d)
    };
    match [a, b, c, d, e, f] {
        [0, 0, 0, 0, 0, 0xffff] | [0x64, 0xff9b, 0, 0, 0, 0] => Some(v4(g, h)),
        [0x2002, ..] => Some(v4(b, c)),
        _ => None,
    }
}

/// The host, if it is an IP address; one of version 6 stands in brackets.
fn literal(host: &str) -> Option<IpAddr> {
    match host.strip_prefix('[').and_then(|host| host.strip_suffix(']')) {
        Some(host) => host.parse().ok().map(IpAddr::V6),
        None => host.parse().ok().map(IpAddr::V4),
    }
}

/// Is it a name? Not what the C library reads as a number: `2130706433`, `127.1`, `0x7f.1`.
fn is_name(host: &str) -> bool {
    let label = |label: &str| {
        (1..=LABEL_BYTES_MAX).contains(&label.len())
            && label.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
            && !label.starts_with('-')
            && !label.ends_with('-')
    };
    let last = host.rsplit('.').next().unwrap_or_default().to_ascii_lowercase();
    let number = last.bytes().all(|byte| byte.is_ascii_digit())
        || last.strip_prefix("0x").is_some_and(|rest| rest.bytes().all(|byte| byte.is_ascii_hexdigit()));
    host.len() <= HOST_BYTES_MAX && host.split('.').all(label) && !number
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn nodes_dial_no_links_groups_or_services_of_the_machine_they_run_on() {
        for dialled in
            ["127.0.0.1", "10.0.0.4", "192.168.1.7", "172.16.3.4", "8.8.8.8", "::1", "fd12::7", "2001:db8::1"]
        {
            assert_eq!(never_dialled(dialled.parse().unwrap()), None, "{dialled}");
        }
        for never in [
            "0.0.0.0",
            "0.1.2.3",
            "169.254.0.1",
            "169.254.169.254",
            "224.0.0.251",
            "239.1.2.3",
            "255.255.255.255",
            "100.100.100.200",
            "168.63.129.16",
            "::",
            "fe80::1",
            "febf::1",
            "ff02::1",
            "fd00:ec2::254",
            "::ffff:169.254.169.254",
            "64:ff9b::a9fe:a9fe",
            "2002:a9fe:a9fe::1",
        ] {
            assert!(never_dialled(never.parse().unwrap()).is_some(), "{never}");
        }
    }

    #[test]
    fn a_registered_address_is_a_name_or_an_address_that_nodes_dial() {
        for usable in ["node9:7450", "a.b-c.example:1", "my_node:7450", "10.0.0.4:7450", "[::1]:7450", "localhost:1"] {
            assert_eq!(check_address(usable), Ok(()), "{usable}");
        }
        let long = format!("{}:1", "a".repeat(64));
        for unusable in [
            "169.254.169.254:80",
            "[fe80::1]:7450",
            "0.0.0.0:7450",
            "2852039166:80",
            "127.1:80",
            "0xa9fea9fe:80",
            "::1:7450",
            "a..b:1",
            "-a:1",
            "[fe80::1%eth0]:1",
            &long,
        ] {
            assert_eq!(check_address(unusable).unwrap_err().code, Code::BadArgument, "{unusable}");
        }
    }
}
