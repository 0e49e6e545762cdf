//! Participants over a bad network. Each output is checked at once ([`super::node`]). In the end all have found each other, and
//! all reliable readers have the samples that their policies promise.

use super::network::{Network, Weather, config};
use super::node::Own;
use super::random::Random;
use crate::guid::{EntityId, Guid};
use crate::interface::{EndpointSettings, TopicDescription};
use crate::qos::{Durability, History, Qos, Reliability};
use bytes::Bytes;
use std::collections::BTreeSet;

/// Seeds of each run of the tests.
const SEEDS: u64 = 200;
/// Seeds that once failed.
const FAILED: &[u64] = &[];

fn settings(random: &mut Random, is_writer: bool) -> EndpointSettings {
    let reliability = random.of(&[Reliability::Reliable, Reliability::Reliable, Reliability::BestEffort]);
    let durability = random.of(&[Durability::Volatile, Durability::TransientLocal]);
    let history = if random.chance(50) { History::KeepAll } else { History::KeepLast(random.of(&[1, 5, 20])) };
    // Some of the other kind: samples of topics with keys are carried as well.
    let topic = TopicDescription {
        name: random.of(&["rt/t0", "rt/t1"]).into(),
        type_name: "T".into(),
        keyed: random.chance(20),
    };
    let user_data = Bytes::from_static(b"typehash=RIHS01_00;");
    let without_history = !is_writer && durability == Durability::Volatile && random.chance(30);
    EndpointSettings {
        topic,
        qos: Qos { reliability, durability, history, ..Qos::default() },
        user_data,
        without_history,
    }
}

struct Run {
    network: Network,
    lease: u64,
    is_lying: bool,
    /// Has a process stood still? It gives others up later.
    has_stopped: bool,
    /// Has the network been parted?
    has_parted: bool,
}

/// One run of 2 to 20 participants, as the seed says.
fn run(seed: u64) {
    let mut random = Random(seed);
    let slots = if random.chance(5) { 20 } else { 2 + random.index(4) };
    let (lease, per_host) = (random.of(&[1_000_000, 2_000_000]), 1 + random.index(3));
    let mut network = Network::new(random.next(), (0..slots).map(|slot| config(slot, per_host, lease)));
    let is_lying = random.chance(25);
    if is_lying {
        network.liars.insert(slots - 1);
    }
    network.weather =
        Weather { loss: random.of(&[0, 2, 20]), twice: random.of(&[0, 10]), delay: random.of(&[100, 5_000, 80_000]) };
    let mut run = Run { network, lease, is_lying, has_stopped: false, has_parted: false };
    for slot in 0..slots {
        run.start(slot);
    }
    for _ in 0..15 + 2 * slots {
        run.disturb();
        let time = run.network.random.below(150_000);
        run.network.run(time);
    }
    run.heal();
    run.check_discovery();
    run.write_the_last();
    run.check_samples();
}

impl Run {
    fn start(&mut self, slot: usize) {
        self.network.start(slot);
        for _ in 0..self.network.random.below(5) {
            self.open(slot);
        }
    }

    fn open(&mut self, slot: usize) {
        let is_writer = self.network.random.chance(50);
        let settings = settings(&mut self.network.random, is_writer);
        self.network.open(slot, settings, is_writer);
    }

    fn own(&mut self, slot: usize, is_wanted: impl Fn(&Own) -> bool) -> Option<EntityId> {
        let all: Vec<EntityId> =
            self.network.node(slot).own.iter().filter(|(_, own)| is_wanted(own)).map(|(entity, _)| *entity).collect();
        (!all.is_empty()).then(|| self.network.random.of(&all))
    }

    fn disturb(&mut self) {
        let slots = self.network.slots.len();
        let slot = self.network.random.index(slots);
        let is_running = self.network.running().contains(&slot);
        match self.network.random.below(40) {
            0 if is_running => {
                self.network.step(slot, crate::interface::Input::Leave);
                self.network.crash(slot);
            }
            1 if is_running => {
                self.network.crash(slot);
            }
            2 if is_running => {
                self.network.slots[slot].is_stopped = true;
                self.has_stopped = true;
            }
            3..6 if self.network.slots[slot].is_stopped => self.network.resume(slot),
            6..9 if self.network.slots[slot].node.is_none() => {
                let is_liar = self.network.liars.contains(&slot);
                if !is_liar && (self.has_stopped || self.network.random.chance(50)) {
                    self.network.renew_prefix(slot);
                } else {
                    // The same GUID prefix: others must have given it up, or they take it for the same participant.
                    self.network.run(self.lease + 500_000);
                }
                self.start(slot);
            }
            9 => {
                let other = self.network.random.index(slots);
                self.network.partitions.insert((slot.min(other), slot.max(other)));
                self.has_parted = true;
            }
            10 | 11 => {
                self.network.partitions.pop_first();
            }
            12 if is_running => {
                let by = self.network.random.of(&[3_600_000_000, 1, 1_000_000_000_000_000]);
                self.network.node(slot).wall = by;
            }
            13..16 if is_running => self.open(slot),
            16 if is_running => {
                if let Some(entity) = self.own(slot, |_| true) {
                    self.network.close(slot, entity);
                }
            }
            17.. if is_running => {
                for _ in 0..self.network.random.below(10) {
                    if let Some(writer) = self.own(slot, |own| own.is_writer) {
                        self.network.write(slot, writer);
                    }
                }
            }
            _ => {}
        }
    }

    /// The network is good again, and all that stood still go on. Afterwards all have found each other.
    fn heal(&mut self) {
        self.network.partitions.clear();
        self.network.weather = Weather { delay: 200, ..Weather::default() };
        for slot in 0..self.network.slots.len() {
            if self.network.slots[slot].is_stopped && self.network.slots[slot].node.is_some() {
                self.network.resume(slot);
            }
        }
        self.network.run(3 * self.lease + 2_000_000);
    }

    /// Participants that do not lie.
    fn honest(&self) -> Vec<usize> {
        self.network.running().into_iter().filter(|slot| !self.network.liars.contains(slot)).collect()
    }

    fn check_discovery(&mut self) {
        let honest = self.honest();
        let liars: BTreeSet<_> =
            self.network.liars.iter().map(|slot| self.network.slots[*slot].config.prefix).collect();
        let mut all = BTreeSet::new();
        for slot in &honest {
            let node = self.network.node(*slot);
            all.extend(node.own.keys().map(|entity| node.guid(*entity)));
        }
        for slot in honest {
            let node = self.network.node(slot);
            let prefix = node.config.prefix;
            let of_honest = |guid: &&Guid| !liars.contains(&guid.prefix);
            let found: BTreeSet<_> = node.found.iter().filter(of_honest).collect();
            let expected: BTreeSet<_> = all.iter().filter(|guid| guid.prefix != prefix).collect();
            assert_eq!(found, expected, "{prefix:?} has not found what there is");
            let listed = node.participant.publishers().chain(node.participant.subscribers());
            assert_eq!(listed.map(|endpoint| &endpoint.guid).filter(of_honest).collect::<BTreeSet<_>>(), expected);
        }
        self.check_matches();
    }

    /// Calls `f` with a reader's slot and the pair of each honest writer and reader of one topic.
    fn pairs(&self) -> Vec<(usize, EntityId, usize, EntityId)> {
        let mut pairs = Vec::new();
        let nodes =
            || self.honest().into_iter().filter_map(|slot| Some((slot, self.network.slots[slot].node.as_ref()?)));
        for (a, of_writer) in nodes() {
            for (b, of_reader) in nodes().filter(|(b, _)| *b != a) {
                for (writer, w) in of_writer.own.iter().filter(|(_, own)| own.is_writer) {
                    let is_same = |r: &Own| !r.is_writer && r.settings.topic.name == w.settings.topic.name;
                    let readers = of_reader.own.iter().filter(|(_, own)| is_same(own));
                    pairs.extend(readers.map(|(reader, _)| (a, *writer, b, *reader)));
                }
            }
        }
        pairs
    }

    fn check_matches(&mut self) {
        for (a, writer, b, reader) in self.pairs() {
            let [of_writer, of_reader] = [a, b].map(|slot| self.network.slots[slot].node.as_ref().unwrap());
            let mismatches = of_writer.own[&writer].settings.qos.mismatches(&of_reader.own[&reader].settings.qos);
            let (w, r) = (of_writer.guid(writer), of_reader.guid(reader));
            let is_matched =
                (of_writer.matches.contains_key(&(writer, r)), of_reader.matches.contains_key(&(reader, w)));
            let expected = mismatches.is_empty();
            assert_eq!(is_matched, (expected, expected), "{w:?} {r:?}: {mismatches:?}");
            if let Some(policy) = mismatches.first() {
                assert!(
                    of_writer.incompatible.contains(&(writer, r, *policy)),
                    "{w:?} was not told that {r:?} does not fit"
                );
                assert!(
                    of_reader.incompatible.contains(&(reader, w, *policy)),
                    "{r:?} was not told that {w:?} does not fit"
                );
            }
        }
    }

    /// Each writer writes more, as all are matched.
    fn write_the_last(&mut self) {
        for _ in 0..3 {
            for slot in self.network.running() {
                let writers = self.network.node(slot).own.iter().filter(|(_, own)| own.is_writer);
                for writer in writers.map(|(writer, _)| *writer).collect::<Vec<_>>() {
                    self.network.write(slot, writer);
                }
            }
            self.network.run(50_000);
        }
        self.network.run(3_000_000);
    }

    fn check_samples(&mut self) {
        for (a, writer, b, reader) in self.pairs() {
            let [of_writer, of_reader] = [a, b].map(|slot| self.network.slots[slot].node.as_ref().unwrap());
            let (w, r) = (&of_writer.own[&writer], &of_reader.own[&reader]);
            let Some(reception) = of_reader.matches.get(&(reader, of_writer.guid(writer))) else { continue };
            let names = format!(
                "{:?} -> {:?}: {reception:?}, {} written",
                of_writer.guid(writer),
                of_reader.guid(reader),
                w.written
            );
            assert_eq!(reception.last, w.written, "{names}: the last sample is missing");
            let is_durable = |own: &Own| own.settings.qos.durability == Durability::TransientLocal;
            let is_reliable = |own: &Own| own.settings.qos.reliability == Reliability::Reliable;
            if is_reliable(w) && is_reliable(r) && w.settings.qos.history == History::KeepAll {
                // A writer that gave its reader up for a while, and was not given up by it, does not keep all for it.
                let has_gap = reception.samples.cast_signed() != reception.last + 1 - reception.first;
                // A reader that wants nothing from before still takes what came before the first HEARTBEAT.
                let skips_old = r.settings.without_history || (is_durable(w) && !is_durable(r));
                assert!(!has_gap || skips_old || self.has_stopped || self.has_parted, "{names}: a gap");
                if is_durable(w) && is_durable(r) {
                    assert_eq!(reception.first, 1, "{names}: the first sample is missing");
                }
            }
        }
        for slot in self.honest() {
            let is_lying = self.is_lying;
            let node = self.network.node(slot);
            for writer in node.own.iter().filter(|(_, own)| own.is_writer && !is_lying).map(|(writer, _)| *writer) {
                assert!(node.participant.is_acknowledged(writer), "{:?} waits", node.guid(writer));
                assert_eq!(node.participant.unacknowledged_bytes(writer), 0);
                assert!(node.own[&writer].acknowledged > 0);
            }
        }
    }
}

#[test]
fn all_find_each_other_and_reliable_readers_get_what_is_promised() {
    let from: u64 = std::env::var("RTPS_SEED").ok().and_then(|text| text.parse().ok()).unwrap_or(0);
    let seeds: u64 = std::env::var("RTPS_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(SEEDS);
    for seed in FAILED.iter().copied().chain(from..from + seeds) {
        if let Err(cause) = std::panic::catch_unwind(|| run(seed)) {
            let text = cause.downcast_ref::<String>().cloned().unwrap_or_default();
            panic!("seed {seed}: {text}");
        }
    }
}
