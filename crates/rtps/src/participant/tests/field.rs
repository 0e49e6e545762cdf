//! Peers as they are met: other transports, sizes of fragments, addresses that come and go.

use super::by_hand::*;
use super::network::{Network, Weather, config};
use super::node::Node;
use crate::Participant;
use crate::announcement::ParticipantData;
use crate::discovery::locators::data_port;
use crate::guid::{EntityId, Guid, GuidPrefix, PREFIX_BYTES, SequenceNumber, VendorId};
use crate::interface::{
    Channel, Config, EndpointSettings, IncomingSample, Input, LossReason, Output, TopicDescription,
    UnreachableParticipant,
};
use crate::qos::{Durability, Qos, Reliability};
use crate::wire::read;
use crate::wire::submessage::{DataFrag, InlineQos, NumberSet, Payload, Submessage};
use bytes::Bytes;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;

/// The datagrams of a file with captures.
fn captured(text: &str) -> Vec<Bytes> {
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines.map(|line| line.as_bytes().chunks(2).map(byte).collect()).collect()
}

fn source(datagram: &Bytes) -> GuidPrefix {
    GuidPrefix(*datagram[8..].first_chunk::<PREFIX_BYTES>().unwrap())
}

/// A participant in the place of one that was captured.
fn in_place_of(prefix: GuidPrefix) -> Participant {
    let host = vec![Ipv4Addr::LOCALHOST];
    let config = Config { prefix, domain: 7, addresses: host.clone(), host, ..config(0, 1, 10 * LEASE) };
    Participant::new(config, at(0))
}

fn receive(participant: &mut Participant, steady: u64, bytes: &Bytes) -> Vec<Output> {
    let from = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 9161);
    step(participant, steady, Input::Datagram { from, channel: Channel::DiscoveryUnicast, bytes: bytes.clone() })
}

fn samples(out: &[Output]) -> Vec<IncomingSample> {
    let sample = |output: &Output| match output {
        Output::Sample { sample, .. } => Some(sample.clone()),
        _ => None,
    };
    out.iter().filter_map(sample).collect()
}

#[test]
fn fast_dds_with_large_data_is_reported_as_unreachable_until_it_leaves() {
    let mut participant = alone();
    let datagrams = captured(include_str!("../../announcement/captures/fastdds-2.14.5-large-data.hex"));
    let others = [source(&datagrams[0]), source(&datagrams[1])];
    let unreachable = |prefix| UnreachableParticipant {
        guid: Guid::new(prefix, EntityId::PARTICIPANT),
        vendor: VendorId::FAST_DDS,
        host: Ipv4Addr::LOCALHOST,
    };
    let [first, second] = others.map(unreachable);
    assert!(receive(&mut participant, 1, &datagrams[0]).contains(&Output::Unreachable(first)));
    assert!(!receive(&mut participant, 2, &datagrams[0]).contains(&Output::Unreachable(first)), "it is said once");
    receive(&mut participant, 3, &datagrams[1]);
    assert_eq!(participant.unreachable().count(), 2);
    assert!(receive(&mut participant, 4, &datagrams[2]).contains(&Output::NotUnreachable(first.guid)));
    assert_eq!(participant.unreachable().collect::<Vec<_>>(), [second]);
}

#[test]
fn ipv6_addresses_are_ignored_beside_others_and_alone_make_a_participant_unreachable() {
    // One locator of UDPv6 in front of what is announced.
    let with_ipv6 = |data: &ParticipantData| {
        let payload = data.to_payload();
        let mut bytes = payload[..4].to_vec();
        for id in [0x32_u16, 0x31] {
            bytes.extend(id.to_le_bytes());
            bytes.extend([24, 0, 2, 0, 0, 0, 0xf2, 0x1c, 0, 0]);
            bytes.extend([0xfe, 0x80, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 7]);
        }
        bytes.extend(&payload[4..]);
        bytes
    };
    let mut participant = alone();
    let hello = |data: &ParticipantData| {
        datagram(
            STRANGER,
            &[super::by_hand::data(
                EntityId::SPDP_WRITER,
                1,
                Payload::Data(with_ipv6(data).into()),
                InlineQos::default(),
            )],
        )
    };
    let (both, ipv4) = (participant_data(STRANGER), vec![FROM]);
    assert_eq!(announcements(&step(&mut participant, 0, hello(&both))).first(), Some(&ipv4), "it is answered by IPv4");
    assert_eq!(participant.unreachable().count(), 0);
    let alone = ParticipantData { discovery_unicast: Vec::new(), data_unicast: Vec::new(), ..both.clone() };
    step(&mut participant, 1, hello(&alone));
    assert_eq!(participant.unreachable().count(), 1);
    let out = step(&mut participant, 2, hello(&both));
    assert!(out.contains(&Output::NotUnreachable(Guid::new(STRANGER, EntityId::PARTICIPANT))));
    assert!(!out.iter().any(|output| matches!(output, Output::Send { to, .. } if *to != ipv4)));
}

#[test]
fn a_sample_of_cyclonedds_in_fragments_of_4000_bytes_is_put_together() {
    let datagrams = captured(include_str!("../../announcement/captures/cyclonedds-11.0.1-fragments.hex"));
    let publisher = source(datagrams.iter().find(|datagram| datagram.len() > 3000).unwrap());
    let subscriber = datagrams.iter().map(source).find(|prefix| *prefix != publisher).unwrap();
    let mut participant = in_place_of(subscriber);
    let topic = |name: &str| TopicDescription {
        name: name.into(),
        type_name: "sensor_msgs::msg::dds_::Image_".into(),
        keyed: false,
    };
    // Its reader had the second key.
    for name in ["rt/other", "rt/image"] {
        let settings = EndpointSettings { topic: topic(name), ..settings(name, reliable(Durability::Volatile)) };
        step(&mut participant, 0, Input::OpenReader(settings));
    }
    let (mut received, mut requested) = (Vec::new(), Vec::new());
    for (number, datagram) in (1..).zip(&datagrams) {
        if source(datagram) != publisher {
            continue;
        }
        let out = receive(&mut participant, number * 2_000, datagram);
        received.extend(samples(&out));
        for output in out.iter().chain(&step(&mut participant, number * 2_000 + 1_500, Input::Time)) {
            let Output::Send { bytes, .. } = output else { continue };
            for message in read::submessages(bytes) {
                match message.submessage {
                    Submessage::NackFrag(nack) => requested.push(nack.missing),
                    Submessage::AckNack(acknack) if acknack.writer == EntityId([0, 0, 2, 3]) => {
                        requested.push(acknack.missing)
                    }
                    _ => {}
                }
            }
        }
    }
    let [sample] = &received[..] else { panic!("{received:?}") };
    assert!(sample.payload.len() > 7000 && sample.sequence == SequenceNumber(1));
    // It sent fragments before they were matched, so that they were requested as Cyclone's own reader did.
    let second = || {
        let mut set = NumberSet::new(2);
        set.insert(2);
        set
    };
    assert!(requested.contains(&second()), "{requested:?}");
}

#[test]
fn best_effort_samples_in_fragments_of_512_bytes_arrive_and_incomplete_ones_are_counted() {
    let mut participant = alone();
    step(&mut participant, 0, Input::OpenReader(settings("rt/t", Qos::default())));
    let hello = [announced(&participant_data(STRANGER)), published(1, &endpoint_data(writer_of(STRANGER, 1)))];
    step(&mut participant, 0, datagram(STRANGER, &hello));
    let content: Vec<u8> = (0..=255).cycle().take(3000).collect();
    let fragment = |sequence, first: u32| {
        let from = (usize::try_from(first).unwrap() - 1) * 512;
        Submessage::DataFrag(DataFrag {
            reader: EntityId::UNKNOWN,
            writer: EntityId::writer(1, false),
            sequence: SequenceNumber(sequence),
            first,
            count: 1,
            fragment_bytes: 512,
            sample_bytes: 3000,
            inline_qos: InlineQos::default(),
            is_key: false,
            payload: Bytes::copy_from_slice(&content[from..(from + 512).min(3000)]),
        })
    };
    let mut received = Vec::new();
    let mut lost = Vec::new();
    // Of every third sample one fragment is missing; the others come in order, in reverse, or twice.
    for sequence in 1..=9_i64 {
        let mut order: Vec<u32> = (1..=6).collect();
        match sequence % 3 {
            0 => drop(order.remove(2)),
            1 => order.reverse(),
            _ => order.extend(1..=6),
        }
        for first in order {
            let out = step(&mut participant, 1, datagram(STRANGER, &[fragment(sequence, first)]));
            received.extend(samples(&out));
            lost.extend(out.into_iter().filter_map(|output| match output {
                Output::Lost { count, reason, .. } => Some((count, reason)),
                _ => None,
            }));
        }
    }
    assert!(received.iter().all(|sample| sample.payload == content));
    assert_eq!(received.iter().map(|sample| sample.sequence.0).collect::<Vec<_>>(), [1, 2, 4, 5, 7, 8]);
    assert_eq!(lost, [(1, LossReason::Incomplete); 2], "that of the last one may still come");
}

#[test]
fn samples_follow_a_peer_whose_address_changes_and_nothing_reliable_is_lost() {
    // They seldom announce themselves: here the test does.
    let mut network = Network::new(7, (0..2).map(|slot| config(slot, 1, 1000 * LEASE)));
    (0..2).for_each(|slot| network.start(slot));
    let reader = network.open(0, settings("rt/t", reliable(Durability::Volatile)), false);
    let writer = network.open(1, settings("rt/t", reliable(Durability::Volatile)), true);
    network.run(LEASE / 2);
    let other = network.node(1).guid(writer);
    let announce = |network: &mut Network, ip: Ipv4Addr| {
        // What the participant of slot 0 would announce after it has moved.
        network.slots[0].config.addresses = vec![ip];
        let config = network.slots[0].config.clone();
        let data = ParticipantData {
            vendor: VendorId::OWN,
            lease: Duration::from_micros(1000 * LEASE),
            discovery_unicast: vec![SocketAddrV4::new(ip, 7410)],
            data_unicast: vec![SocketAddrV4::new(ip, data_port(0, config.participant_id).unwrap())],
            ..participant_data(config.prefix)
        };
        let Input::Datagram { bytes, .. } = datagram(config.prefix, &[announced(&data)]) else { panic!() };
        network.send_to(0, SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 2), 7410), &bytes);
        network.run(50_000);
    };
    for last in 1..=4 {
        let ip = Ipv4Addr::new(10, 0, 7, last);
        // Written while it has no address that works: repaired when it has one.
        network.slots[0].config.addresses = Vec::new();
        network.slots[0].config.addresses.push(Ipv4Addr::new(192, 0, 2, 1));
        network.write(1, writer);
        network.run(50_000);
        announce(&mut network, ip);
        network.write(1, writer);
        network.run(2 * LEASE);
        let reception = &network.node(0).matches[&(reader, other)];
        assert_eq!((reception.first, reception.samples, reception.last), (1, u64::from(last) * 2, i64::from(last) * 2));
    }
    assert_eq!(network.node(0).gone + network.node(1).gone, 0);
}

#[test]
fn forty_participants_with_eighty_topics_that_start_at_once_find_each_other() {
    const PARTICIPANTS: usize = 40;
    let mut network = Network::new(1, (0..PARTICIPANTS).map(|slot| config(slot, 10, 10 * LEASE)));
    network.weather = Weather { loss: 2, twice: 2, delay: 2_000 };
    for slot in 0..PARTICIPANTS {
        network.start(slot);
        // Each topic has a writer here and a reader in the next participant.
        for topic in 0..2 {
            let name = |owner: usize| format!("rt/topic_{}_{topic}", owner % PARTICIPANTS);
            network.open(slot, settings(&name(slot), reliable(Durability::Volatile)), true);
            network.open(slot, settings(&name(slot + 1), reliable(Durability::Volatile)), false);
        }
    }
    let is_complete = |node: &Node| node.found.len() == 4 * (PARTICIPANTS - 1) && node.matches.len() == 4;
    let end = network.now + 60 * LEASE;
    while network.slots.iter().any(|slot| !slot.node.as_ref().is_some_and(is_complete)) {
        network.run(50_000);
        assert!(network.now < end, "not within a minute");
    }
    network.weather = Weather { delay: 200, ..Weather::default() };
    network.run(10 * LEASE);
    let sent: u64 = network.slots.iter().filter_map(|slot| slot.node.as_ref()).map(|node| node.sent.1).sum();
    network.run(10 * LEASE);
    let after: u64 = network.slots.iter().filter_map(|slot| slot.node.as_ref()).map(|node| node.sent.1).sum();
    // Five announcements of each in its lease, and nothing else.
    assert_eq!(after - sent, 5 * PARTICIPANTS as u64);
    assert!(
        network.slots.iter().all(|slot| slot.node.as_ref().is_some_and(|node| is_complete(node) && node.gone == 0))
    );
}

#[test]
fn a_best_effort_reader_matches_a_reliable_writer_that_has_no_address_of_its_own() {
    // The micro-ROS agent announces endpoints without locators: those of its participant count.
    let mut participant = alone();
    let qos = Qos { reliability: Reliability::BestEffort, ..Qos::default() };
    step(&mut participant, 0, Input::OpenReader(settings("rt/t", qos)));
    let mut endpoint = endpoint_data(writer_of(STRANGER, 1));
    endpoint.qos = reliable(Durability::Volatile);
    let hello = [announced(&participant_data(STRANGER)), published(1, &endpoint)];
    let out = step(&mut participant, 0, datagram(STRANGER, &hello));
    assert!(out.iter().any(|output| matches!(output, Output::Matched { .. })));
}
