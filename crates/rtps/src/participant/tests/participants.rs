//! Rules of participants: announcing, leases, leaving. One in each test.

use super::by_hand::*;
use super::network::{Network, config};
use super::random::Random;
use crate::announcement::ParticipantData;
use crate::discovery::locators::GROUP;
use crate::guid::{EntityId, GuidPrefix};
use crate::interface::{Channel, Config, Input};
use crate::limits::PARTICIPANTS_MAX;
use crate::qos::{Durability, Qos};
use crate::wire::submessage::{InlineQos, Payload, Submessage};
use crate::wire::write::DatagramBuilder;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;

#[test]
fn a_participant_announces_itself_at_once_and_five_times_in_its_lease() {
    let mut participant = alone();
    let mut times = Vec::new();
    while let Some(due) = participant.deadline().filter(|due| *due < LEASE) {
        let out = step(&mut participant, due, Input::Time);
        times.extend(announcements(&out).into_iter().map(|to| (due, to)));
    }
    let group = vec![SocketAddrV4::new(GROUP, 7400)];
    assert_eq!(times, [0, 1, 2, 3, 4].map(|time| (time * LEASE / 5, group.clone())));
}

#[test]
fn a_new_participant_is_answered_at_once_and_a_known_one_is_not() {
    let mut participant = alone();
    step(&mut participant, 0, Input::Time);
    let hello = datagram(STRANGER, &[announced(&participant_data(STRANGER))]);
    assert_eq!(announcements(&step(&mut participant, 1, hello.clone())), [vec![FROM]]);
    assert_eq!(announcements(&step(&mut participant, 2, hello)).len(), 0);
}

#[test]
fn made_up_participants_get_few_answers_and_take_no_more_than_their_places() {
    let mut participant = alone();
    step(&mut participant, 0, Input::Time);
    let mut answers = 0;
    for number in 0..5 * PARTICIPANTS_MAX {
        let [high, low] = u16::try_from(number).unwrap().to_be_bytes();
        let prefix = GuidPrefix([0xee, high, low, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        let hello = [announced(&participant_data(prefix)), published(1, &endpoint_data(writer_of(prefix, 1)))];
        answers += announcements(&step(&mut participant, 1, datagram(prefix, &hello))).len();
    }
    assert_eq!(answers, 64);
    assert_eq!(participant.publishers().count(), PARTICIPANTS_MAX);
    // They are silent: their places become free.
    let mut ends = 0;
    while let Some(due) = participant.deadline().filter(|due| *due <= LEASE + 1) {
        ends += gone(&step(&mut participant, due, Input::Time)).len();
    }
    assert_eq!((ends, participant.publishers().count()), (PARTICIPANTS_MAX, 0));
}

#[test]
fn a_participant_counts_only_if_it_announces_itself_in_this_domain() {
    let mut participant = alone();
    step(&mut participant, 0, Input::Time);
    let [prefix, other] = [GuidPrefix([1; 12]), GuidPrefix([2; 12])];
    let by_another = datagram(other, &[announced(&participant_data(prefix))]);
    let elsewhere = datagram(prefix, &[announced(&ParticipantData { domain: Some(1), ..participant_data(prefix) })]);
    let itself = datagram(participant.guid().prefix, &[announced(&participant_data(participant.guid().prefix))]);
    for input in [by_another, elsewhere, itself] {
        assert_eq!(announcements(&step(&mut participant, 1, input)).len(), 0);
    }
    let unsaid = datagram(prefix, &[announced(&ParticipantData { domain: None, ..participant_data(prefix) })]);
    assert_eq!(announcements(&step(&mut participant, 1, unsaid)).len(), 1);
}

#[test]
fn a_relay_is_not_believed_and_what_is_for_another_participant_is_ignored() {
    let mut participant = alone();
    step(&mut participant, 0, Input::Time);
    let hello = announced(&participant_data(STRANGER));
    let mut builder = DatagramBuilder::new(STRANGER);
    builder.destination(GuidPrefix([3; 12]));
    builder.push(&hello);
    let for_another = Input::Datagram { from: FROM, channel: Channel::DataUnicast, bytes: builder.finish() };
    assert_eq!(announcements(&step(&mut participant, 1, for_another)).len(), 0);
    let Input::Datagram { bytes, .. } = datagram(STRANGER, &[hello]) else { panic!() };
    let (header, rest) = bytes.split_at(20);
    let info_source = [&[0x0c, 1, 20, 0, 0, 0, 0, 0, 2, 5, 1, 0x21][..], &STRANGER.0].concat();
    let mut relayed = header.to_vec();
    relayed[8..20].copy_from_slice(&[5; 12]);
    let relayed = Input::Datagram {
        from: FROM,
        channel: Channel::DiscoveryUnicast,
        bytes: [&relayed[..], &info_source, rest].concat().into(),
    };
    assert_eq!(announcements(&step(&mut participant, 1, relayed)).len(), 0);
}

#[test]
fn a_silent_participant_is_gone_with_its_endpoints_after_its_lease_and_anything_of_it_renews_it() {
    let mut participant = alone();
    let hello = [announced(&participant_data(STRANGER)), published(1, &endpoint_data(writer_of(STRANGER, 1)))];
    step(&mut participant, 0, datagram(STRANGER, &hello));
    let mut ends = Vec::new();
    let anything = data(EntityId::writer(9, false), 1, Payload::None, InlineQos::default());
    step(&mut participant, 600_000, datagram(STRANGER, &[anything]));
    while let Some(due) = participant.deadline().filter(|due| *due <= 3 * LEASE) {
        let out = step(&mut participant, due, Input::Time);
        ends.extend(gone(&out).into_iter().map(|guid| (due, guid)));
    }
    assert_eq!(ends, [(600_000 + LEASE, writer_of(STRANGER, 1))]);
    // It comes back with the same numbers.
    assert_eq!(found(&step(&mut participant, 4 * LEASE, datagram(STRANGER, &hello))), [writer_of(STRANGER, 1)]);
}

#[test]
fn a_participant_that_stood_still_takes_in_what_waits_before_it_gives_others_up() {
    let mut participant = alone();
    let hello = [announced(&participant_data(STRANGER)), published(1, &endpoint_data(writer_of(STRANGER, 1)))];
    step(&mut participant, 0, datagram(STRANGER, &hello));
    assert_eq!(gone(&step(&mut participant, 600 * LEASE, Input::Time)), []);
    step(&mut participant, 600 * LEASE, datagram(STRANGER, &hello));
    let mut ends = Vec::new();
    while let Some(due) = participant.deadline().filter(|due| *due <= 610 * LEASE) {
        ends.extend(gone(&step(&mut participant, due, Input::Time)).into_iter().map(|_| due));
    }
    assert_eq!(ends, [601 * LEASE]);
}

#[test]
fn a_participant_that_leaves_is_gone_at_once() {
    let mut network = network(3);
    let reader = network.open(0, settings("rt/t", reliable(Durability::Volatile)), false);
    let writer = network.open(1, settings("rt/t", reliable(Durability::Volatile)), true);
    network.run(LEASE / 2);
    let other = network.node(1).guid(writer);
    assert_eq!(network.node(0).matches.keys().collect::<Vec<_>>(), [&(reader, other)]);
    network.step(1, Input::Leave);
    network.run(1_000);
    assert_eq!((network.node(0).matches.len(), network.node(0).found.len(), network.node(2).found.len()), (0, 0, 1));
    assert_eq!(network.node(1).participant.deadline(), None);
    assert_eq!(network.node(1).step(9 * LEASE, Input::Time).len(), 0);
}

#[test]
fn static_peers_find_each_other_without_multicast() {
    let without = |slot: usize, peers: &[u8]| Config {
        multicast: false,
        static_peers: peers.iter().map(|host| Ipv4Addr::new(10, 0, 0, *host)).collect(),
        ..config(slot, 2, LEASE)
    };
    // Slots 0 and 1 share a host; only slot 2 knows of them.
    let mut network = Network::new(1, [without(0, &[]), without(1, &[1]), without(2, &[1])]);
    for slot in 0..3 {
        network.start(slot);
        network.open(slot, settings("rt/t", Qos::default()), true);
    }
    network.run(4 * LEASE);
    for slot in 0..3 {
        assert_eq!((network.node(slot).found.len(), network.node(slot).gone), (2, 0), "slot {slot}");
    }
}

#[test]
fn participants_with_nothing_to_say_rest() {
    let long = |slot| Config { lease: Duration::from_secs(10), ..config(slot, 1, LEASE) };
    let mut network = Network::new(1, (0..3).map(long));
    for slot in 0..3 {
        network.start(slot);
        network.open(slot, settings("rt/t", reliable(Durability::TransientLocal)), true);
        network.open(slot, settings("rt/t", reliable(Durability::TransientLocal)), false);
        let writer = network.open(slot, settings("rt/u", reliable(Durability::Volatile)), true);
        network.write(slot, writer);
    }
    network.run(10_000_000);
    let before = network.node(0).steps;
    network.run(60_000_000);
    let steps = network.node(0).steps - before;
    assert!(steps < 60 * 10, "{steps} steps in a minute");
}

#[test]
fn random_bytes_are_harmless() {
    let mut participant = alone();
    let mut random = Random(1);
    let hello = [announced(&participant_data(STRANGER)), published(1, &endpoint_data(writer_of(STRANGER, 1)))];
    let Input::Datagram { bytes, .. } = datagram(STRANGER, &hello) else { panic!() };
    for steady in 0..20_000 {
        let mut bytes = bytes.to_vec();
        for _ in 0..random.below(6) {
            let at = random.index(bytes.len());
            bytes[at] = u8::try_from(random.below(256)).unwrap();
        }
        bytes.truncate(random.index(2 * bytes.len()).max(1));
        step(
            &mut participant,
            steady,
            Input::Datagram { from: FROM, channel: Channel::DiscoveryMulticast, bytes: bytes.into() },
        );
    }
    assert!(participant.publishers().count() <= 20_000);
}

#[test]
fn a_participant_whose_announcements_begin_again_is_found_as_a_new_one() {
    let mut participant = alone();
    step(&mut participant, 0, Input::OpenReader(settings("rt/t", Qos::default())));
    let endpoints: Vec<Submessage> =
        (1..=9).map(|key| published(key, &endpoint_data(writer_of(STRANGER, key.try_into().unwrap())))).collect();
    let mut hello = vec![announced(&participant_data(STRANGER))];
    hello.extend(endpoints);
    assert_eq!(found(&step(&mut participant, 0, datagram(STRANGER, &hello))).len(), 9);
    let mut ends = 0;
    for (steady, last) in [(1, 1), (100_000, 2), (200_000, 3), (300_000, 4)] {
        ends += gone(&step(&mut participant, steady, datagram(STRANGER, &[heartbeat(last)]))).len();
    }
    assert_eq!(ends, 9);
    let again = step(&mut participant, 400_000, datagram(STRANGER, &hello[..3]));
    assert_eq!(found(&again), [writer_of(STRANGER, 1), writer_of(STRANGER, 2)]);
}
