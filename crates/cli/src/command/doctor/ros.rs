//! The ROS graph of this machine: domain, range, interfaces, multicast, receive buffers.

use super::finding::Finding;
use ledger_base::units::size;
use netdev::Interface;
use ros_bridge::Config;
use ros_bridge::config::PROGRAM_SECTIONS;
use ros_bridge::domain::{Domain, ROS_DOMAIN_ID};
use ros_bridge::environment::OutOfReach;
use ros_bridge::reach::{Range, Reach, Settings};
use std::fs;
use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::path::Path;
use std::time::Duration;

/// The group in which participants of DDS find each other.
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);
/// How long a datagram to ourselves may take.
const ECHO_MAX: Duration = Duration::from_millis(300);
/// The largest receive buffer that the system allows.
const RECEIVE_BUFFER: &str = "/proc/sys/net/core/rmem_max";
/// Large enough for the largest message of the ledger: 4 MiB.
const RECEIVE_BUFFER_MIN: u64 = 4 << 20;
/// The ports that the system gives away by itself.
const EPHEMERAL: &str = "/proc/sys/net/ipv4/ip_local_port_range";
/// Ports of DDS: the first of domain 0, how many a domain has, and how many of them are used by a full host.
const PORTS: (u32, u32, u32) = (7400, 250, 250);

/// Looks at the graph that a bridge on this machine would join.
pub(super) fn look(config: Option<&Path>, domain: Option<u16>, findings: &mut Vec<Finding>) {
    let config = config.and_then(|path| settings(path, findings));
    let environment = |name: &str| std::env::var(name).ok();
    let setting = domain.or(config.as_ref().and_then(|config| config.domain_id));
    findings.push(match Domain::choose(setting, environment(ROS_DOMAIN_ID).as_deref()) {
        Ok(domain) => ports(&domain, &fs::read_to_string(EPHEMERAL).unwrap_or_default()),
        Err(refused) => Finding::refused("DDS domain", &refused),
    });
    let hidden = OutOfReach::find(environment);
    findings.extend(hidden.into_iter().map(|found| Finding::wrong("DDS domain", found.to_string(), found.remedy)));
    let interfaces = netdev::get_interfaces();
    let reach = config.map_or_else(Settings::default, |config| config.reach);
    match Reach::choose(&reach, environment) {
        Ok(reach) => findings.push(reached(&reach, &interfaces)),
        Err(refused) => findings.push(Finding::refused("DDS interfaces", &refused)),
    }
    findings.push(multicast(&interfaces, echoes));
    findings.push(buffers(fs::read_to_string(RECEIVE_BUFFER).ok().as_deref()));
}

/// The settings of a bridge, if they can be used.
fn settings(path: &Path, findings: &mut Vec<Finding>) -> Option<Config> {
    match Config::load(path, |root| root.ignore(&PROGRAM_SECTIONS)) {
        Ok(config) => {
            findings.push(Finding::ok("bridge", format!("{} can be used", path.display())));
            Some(config)
        }
        Err(faults) => {
            findings.extend(faults.into_iter().map(|fault| Finding::refused("bridge", &fault.into())));
            None
        }
    }
}

/// The domain, and whether the system gives its ports to others.
fn ports(domain: &Domain, ephemeral: &str) -> Finding {
    let first = PORTS.0 + PORTS.1 * u32::from(domain.id);
    let last = first + PORTS.2 - 1;
    let text = format!("domain {}, by {}: UDP ports {first} to {last}", domain.id, domain.chosen_by);
    let mut given = ephemeral.split_whitespace().map(|port| port.parse::<u32>().ok());
    match (given.next().flatten(), given.next().flatten()) {
        (Some(from), Some(to)) if first <= to && last >= from => Finding::advice(
            "DDS domain",
            format!("{text}; the system assigns ports {from} to {to} to other programs"),
            "choose a domain from 0 to 100: in this one, ports may be taken",
        ),
        _ => Finding::ok("DDS domain", text),
    }
}

/// The interfaces that the bridge would use, and whether they lead where it shall reach.
fn reached(reach: &Reach, interfaces: &[Interface]) -> Finding {
    let used = |address: &Ipv4Addr| reach.interfaces.as_ref().is_none_or(|used| used.contains(address));
    let addresses: Vec<(Ipv4Addr, &Interface)> = interfaces
        .iter()
        .filter(|interface| interface.is_up())
        .flat_map(|interface| interface.ipv4.iter().map(move |net| (net.addr(), interface)))
        .collect();
    let missing =
        reach.interfaces.iter().flatten().find(|wanted| !addresses.iter().any(|(address, _)| address == *wanted));
    if let Some(missing) = missing {
        let repair = "correct `interfaces` in the configuration of the bridge: ip -4 address";
        return Finding::wrong("DDS interfaces", format!("no interface has {missing}"), repair);
    }
    let named: Vec<String> = addresses
        .iter()
        .filter(|(address, _)| used(address))
        .map(|(address, interface)| format!("{} {address}", interface.name))
        .collect();
    let is_far = reach.range == Range::Subnet || !reach.static_peers.is_empty();
    let leads_far = addresses.iter().any(|(address, interface)| used(address) && !interface.is_loopback());
    let text = format!("{reach}, over {}", if named.is_empty() { "none".to_owned() } else { named.join(", ") });
    match (named.is_empty(), is_far && !leads_far) {
        (true, _) => Finding::wrong(
            "DDS interfaces",
            text,
            "bring up at least the loopback interface: ip link set lo \
                                                             up",
        ),
        (false, true) => {
            Finding::wrong("DDS interfaces", text, "connect this machine to the network of the other hosts: ip link")
        }
        (false, false) => Finding::ok("DDS interfaces", text),
    }
}

/// Over which interfaces a datagram to the group of DDS comes back.
fn multicast(interfaces: &[Interface], echoes: impl Fn(Ipv4Addr) -> io::Result<()>) -> Finding {
    let mut works = Vec::new();
    let mut fails = Vec::new();
    for interface in interfaces.iter().filter(|interface| interface.is_up()) {
        for address in interface.ipv4.iter().map(|net| net.addr()) {
            let name = format!("{} {address}", interface.name);
            match echoes(address) {
                Ok(()) => works.push(name),
                Err(error) => fails.push(format!("{name}: {error}")),
            }
        }
    }
    match (works.is_empty(), fails.is_empty()) {
        (false, true) => Finding::ok("multicast", format!("received over {}", works.join(", "))),
        (false, false) => Finding::advice(
            "multicast",
            format!("received over {}, not over {}", works.join(", "), fails.join(", ")),
            "ip link set INTERFACE multicast on; or name the hosts behind it in ROS_STATIC_PEERS",
        ),
        (true, _) => Finding::wrong(
            "multicast",
            format!(
                "not received: {}",
                if fails.is_empty() { "no interface is up".to_owned() } else { fails.join(", ") }
            ),
            "ip link set lo multicast on && ip route add 239.0.0.0/8 dev lo; or name the hosts in ROS_STATIC_PEERS",
        ),
    }
}

/// Sends a datagram to the group over the interface with this address, and waits for it.
fn echoes(address: Ipv4Addr) -> io::Result<()> {
    let hears = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    hears.join_multicast_v4(&GROUP, &address)?;
    hears.set_read_timeout(Some(ECHO_MAX))?;
    // The system chooses the interface by the address of the sender.
    let says = UdpSocket::bind((address, 0))?;
    says.set_multicast_ttl_v4(0)?;
    says.send_to(b"ledgerctl doctor", (GROUP, hears.local_addr()?.port()))?;
    let from = says.local_addr()?;
    let mut heard = [0; 32];
    loop {
        match hears.recv_from(&mut heard) {
            Ok((_, sender)) if sender == from => return Ok(()),
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                return Err(io::Error::other("no multicast packet was received"));
            }
            Err(error) => return Err(error),
        }
    }
}

/// The receive buffers that the system allows.
fn buffers(limit: Option<&str>) -> Finding {
    let Some(bytes) = limit.and_then(|text| text.trim().parse::<u64>().ok()) else {
        let message = format!("{RECEIVE_BUFFER} cannot be read here");
        return Finding::unknown("receive buffers", message, "outside the container: sysctl net.core.rmem_max");
    };
    match bytes < RECEIVE_BUFFER_MIN {
        true => Finding::advice(
            "receive buffers",
            format!("at most {}: bursts of larger ROS messages are lost", size(bytes)),
            format!("sysctl -w net.core.rmem_max={RECEIVE_BUFFER_MIN}; add it to /etc/sysctl.d to make it permanent"),
        ),
        false => Finding::ok("receive buffers", format!("up to {}", size(bytes))),
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::State;
    use super::*;
    use ros_bridge::domain::ChosenBy;

    #[test]
    fn a_domain_whose_ports_any_program_may_get_is_advised_against() {
        let state = |id, ephemeral| ports(&Domain { id, chosen_by: ChosenBy::Default }, ephemeral).state;
        assert_eq!(state(0, "32768\t60999\n"), State::Ok);
        assert_eq!(state(120, "32768\t60999\n"), State::Advice);
        assert_eq!(state(120, ""), State::Ok);
    }

    #[test]
    fn small_buffers_are_advised_against_and_what_cannot_be_read_is_unknown() {
        assert_eq!(buffers(Some("212992\n")).state, State::Advice);
        assert_eq!(buffers(Some("4194304")).state, State::Ok);
        assert_eq!(buffers(None).state, State::Unknown);
    }

    #[test]
    fn multicast_that_nowhere_comes_back_is_wrong() {
        let interfaces = netdev::get_interfaces();
        assert_eq!(multicast(&interfaces, |_| Ok(())).state, State::Ok);
        let fails = |_| Err(io::Error::other("nothing comes back"));
        assert_eq!(multicast(&interfaces, fails).state, State::Wrong);
        let not_loopback = |address: Ipv4Addr| if address.is_loopback() { Ok(()) } else { fails(address) };
        assert_ne!(multicast(&interfaces, not_loopback).state, State::Wrong);
    }

    #[test]
    fn a_bridge_for_other_hosts_needs_more_than_the_loopback() {
        let loopback: Vec<Interface> =
            netdev::get_interfaces().into_iter().filter(|interface| interface.is_loopback()).collect();
        let far = Reach { range: Range::Subnet, ..Reach::default() };
        let elsewhere = Reach { interfaces: Some(vec![Ipv4Addr::new(192, 0, 2, 1)]), ..Reach::default() };
        let state = |reach: &Reach, interfaces: &[Interface]| reached(reach, interfaces).state;
        assert_eq!(state(&Reach::default(), &loopback), State::Ok);
        assert_eq!(state(&far, &loopback), State::Wrong);
        assert_eq!(state(&elsewhere, &loopback), State::Wrong);
        assert_eq!(state(&Reach::default(), &[]), State::Wrong);
    }
}
