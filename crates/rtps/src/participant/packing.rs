//! Packs submessages into datagrams.

use crate::discovery::locators::is_of_host;
use crate::endpoint::Outgoing;
use crate::interface::{Config, Output};
use crate::wire::write::DatagramBuilder;
use std::collections::VecDeque;
use std::net::SocketAddrV4;

/// Largest datagram with several submessages for another host, bytes: the payload of UDP in a frame of Ethernet.
const DATAGRAM_BYTES: usize = 1472;
/// Largest datagram with several submessages for this host, bytes: below the 65 507 of UDP, and the MTU 65 536 of the loopback.
const DATAGRAM_BYTES_LOCAL: usize = 60_000;
/// Bytes of INFO_DST and INFO_TS, which may stand before a submessage.
const INFO_BYTES: usize = 28;
/// Datagrams that may still grow.
const OPEN_MAX: usize = 16;

/// A datagram that may still grow.
struct Open {
    to: Vec<SocketAddrV4>,
    limit: usize,
    builder: DatagramBuilder,
}

/// Packs what goes to the same addresses, in order. Datagrams to one address keep their order as well. All goes out at the end of a
/// step: no sample waits for others.
pub(super) fn pack(config: &Config, outgoing: Vec<Outgoing>, out: &mut Vec<Output>) {
    let mut open: VecDeque<Open> = VecDeque::new();
    for mut group in outgoing {
        group.to.dedup();
        if group.to.is_empty() {
            continue;
        }
        for submessage in &group.submessages {
            let bytes = DatagramBuilder::bytes_of(submessage) + INFO_BYTES;
            // Nothing of a later datagram to one of these addresses may be overtaken.
            let newest = open.iter_mut().rev().find(|open| open.to.iter().any(|to| group.to.contains(to)));
            // A large one begins a datagram: what is lost with it is then not more than it.
            let has_room = |open: &&mut Open| bytes <= DATAGRAM_BYTES && open.builder.bytes() + bytes <= open.limit;
            let datagram = match newest.filter(|open| open.to == group.to && has_room(open)) {
                Some(datagram) => datagram,
                None => {
                    if open.len() >= OPEN_MAX {
                        out.extend(open.pop_front().map(finish));
                    }
                    open.push_back(start(config, &group.to));
                    let Some(datagram) = open.back_mut() else { continue };
                    datagram
                }
            };
            datagram.builder.destination(group.destination);
            datagram.builder.timestamp(group.timestamp);
            datagram.builder.push(submessage);
        }
    }
    out.extend(open.into_iter().map(finish));
}

fn start(config: &Config, to: &[SocketAddrV4]) -> Open {
    let is_local = to.iter().all(|to| is_of_host(config, *to.ip()));
    let limit = if is_local { DATAGRAM_BYTES_LOCAL } else { DATAGRAM_BYTES };
    Open { to: to.to_vec(), limit, builder: DatagramBuilder::new(config.prefix) }
}

fn finish(open: Open) -> Output {
    Output::Send { to: open.to, bytes: open.builder.finish() }
}
