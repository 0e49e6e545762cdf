//! Rules of packing.

use super::network::config;
use crate::endpoint::Outgoing;
use crate::guid::{EntityId, GuidPrefix, SequenceNumber};
use crate::interface::Output;
use crate::participant::packing::pack;
use crate::wire::read;
use crate::wire::submessage::{Data, InlineQos, Payload, Submessage};
use std::net::{Ipv4Addr, SocketAddrV4};

const PEER: [u8; 4] = [10, 0, 0, 2];
const OTHER: [u8; 4] = [10, 0, 0, 3];
const OWN: [u8; 4] = [10, 0, 0, 1];

fn group(ips: &[[u8; 4]], sequences: &[i64], bytes: usize) -> Outgoing {
    let data = |sequence: &i64| {
        Submessage::Data(Data {
            reader: EntityId::UNKNOWN,
            writer: EntityId::writer(1, false),
            sequence: SequenceNumber(*sequence),
            inline_qos: InlineQos::default(),
            payload: Payload::Data(vec![0; bytes].into()),
        })
    };
    Outgoing {
        to: ips.iter().map(|ip| SocketAddrV4::new(Ipv4Addr::from(*ip), 7411)).collect(),
        destination: GuidPrefix([9; 12]),
        timestamp: None,
        submessages: sequences.iter().map(data).collect(),
    }
}

/// Sequence numbers and addresses of each datagram.
fn packed(outgoing: Vec<Outgoing>) -> Vec<(Vec<i64>, usize)> {
    let mut out = Vec::new();
    pack(&config(0, 1, 1), outgoing, &mut out);
    let numbers = |output| {
        let Output::Send { to, bytes } = output else { return (Vec::new(), 0) };
        let numbers = read::submessages(&bytes).filter_map(|message| match message.submessage {
            Submessage::Data(data) => Some(data.sequence.0),
            _ => None,
        });
        (numbers.collect(), to.len())
    };
    out.into_iter().map(numbers).collect()
}

#[test]
fn what_goes_to_the_same_addresses_shares_a_datagram_up_to_a_frame() {
    assert_eq!(
        packed(vec![group(&[PEER], &[1, 2], 400), group(&[PEER], &[3, 4], 400)]),
        [(vec![1, 2, 3], 1), (vec![4], 1)]
    );
    assert_eq!(packed(vec![group(&[OWN], &[1, 2], 1300), group(&[OWN], &[3, 4], 1300)]), [(vec![1, 2, 3, 4], 1)]);
    assert_eq!(packed(vec![group(&[], &[1], 10)]), []);
}

#[test]
fn nothing_overtakes_what_went_to_one_of_the_same_addresses_before() {
    let mixed = vec![group(&[PEER], &[1], 10), group(&[PEER, OTHER], &[2], 10), group(&[PEER], &[3], 10)];
    assert_eq!(packed(mixed), [(vec![1], 1), (vec![2], 2), (vec![3], 1)]);
    let apart = vec![group(&[PEER], &[1], 10), group(&[OTHER], &[2], 10), group(&[PEER], &[3], 10)];
    assert_eq!(packed(apart), [(vec![1, 3], 1), (vec![2], 1)]);
}

#[test]
fn a_large_submessage_begins_a_datagram_and_a_small_one_may_follow() {
    let large = vec![group(&[OWN], &[1], 10), group(&[OWN], &[2, 3], 16_000), group(&[OWN], &[4], 10)];
    assert_eq!(packed(large), [(vec![1], 1), (vec![2], 1), (vec![3, 4], 1)]);
}

#[test]
fn datagrams_that_may_still_grow_are_bounded() {
    let to = |last| group(&[[10, 0, 1, last]], &[1 + i64::from(last)], 10);
    let many: Vec<Outgoing> = (0..=255).chain(0..=255).map(to).collect();
    let datagrams = packed(many);
    assert_eq!((datagrams.len(), datagrams.first().unwrap()), (512, &(vec![1], 1)));
}
