//! A participant of the simulation, and what must hold of its outputs at any time.

use super::random::mix;
use crate::Participant;
use crate::guid::{EntityId, Guid, GuidPrefix};
use crate::interface::{Config, EndpointSettings, Input, LossReason, OutgoingSample, Output};
use crate::limits::{ANNOUNCEMENTS_BYTES_MAX, PARTICIPANT_BYTES_MAX};
use crate::qos::{Policy, Reliability};
use crate::time::Now;
use bytes::Bytes;
use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddrV4;

/// An own endpoint as the test opened it.
pub(super) struct Own {
    pub(super) settings: EndpointSettings,
    pub(super) is_writer: bool,
    /// Samples so far.
    pub(super) written: i64,
    pub(super) acknowledged: u64,
}

/// The samples of a writer since it matches a reader.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Reception {
    pub(super) first: i64,
    pub(super) last: i64,
    pub(super) samples: u64,
    numbers: BTreeSet<i64>,
    pub(super) lost: BTreeMap<LossReason, u64>,
}

pub(super) struct Node {
    pub(super) config: Config,
    pub(super) participant: Participant,
    pub(super) own: BTreeMap<EntityId, Own>,
    pub(super) found: BTreeSet<Guid>,
    pub(super) gone: u64,
    pub(super) matches: BTreeMap<(EntityId, Guid), Reception>,
    pub(super) incompatible: Vec<(EntityId, Guid, Policy)>,
    /// Own readers, and matched writers whose liveliness has ended.
    pub(super) not_alive: BTreeSet<(EntityId, Guid)>,
    pub(super) deadlines_missed: BTreeMap<EntityId, u64>,
    pub(super) resynchronized: u64,
    /// Participants that cannot be reached.
    pub(super) unreachable: BTreeSet<Guid>,
    /// The wall clock is ahead of the steady one by this.
    pub(super) wall: u64,
    /// Bytes and datagrams that it sent.
    pub(super) sent: (u64, u64),
    pub(super) steps: u64,
    /// Samples of these may be wrong.
    pub(super) liars: BTreeSet<GuidPrefix>,
}

/// The content of a sample: it follows from its writer and number. A multiple of four bytes, to which DATA is padded.
pub(super) fn content(writer: Guid, sequence: i64) -> Bytes {
    let seed = writer.to_bytes().iter().fold(sequence.cast_unsigned(), |sum, byte| mix(sum ^ u64::from(*byte)));
    let length = match seed % 100 {
        0 => 40_000 + seed % 30_000,
        1..6 => 1_300 + seed % 3_000,
        _ => seed % 200,
    };
    let body = (0..length / 4 * 4).map(|at| u8::try_from(mix(seed ^ at) & 0xff).unwrap());
    [0, 1, 0, 0].into_iter().chain(body).collect()
}

impl Node {
    pub(super) fn new(config: Config, steady: u64, wall: u64) -> Self {
        let participant = Participant::new(config.clone(), Now { steady, wall: wall + steady });
        Self {
            config,
            participant,
            own: BTreeMap::new(),
            found: BTreeSet::new(),
            gone: 0,
            matches: BTreeMap::new(),
            incompatible: Vec::new(),
            not_alive: BTreeSet::new(),
            deadlines_missed: BTreeMap::new(),
            resynchronized: 0,
            unreachable: BTreeSet::new(),
            wall,
            sent: (0, 0),
            steps: 0,
            liars: BTreeSet::new(),
        }
    }

    pub(super) fn guid(&self, entity: EntityId) -> Guid {
        Guid::new(self.config.prefix, entity)
    }

    /// Returns what it sends.
    pub(super) fn step(&mut self, steady: u64, input: Input) -> Vec<(Vec<SocketAddrV4>, Bytes)> {
        let mut out = Vec::new();
        self.steps += 1;
        self.participant.step(Now { steady, wall: self.wall + steady }, input, &mut out);
        assert!(self.participant.held_bytes() <= PARTICIPANT_BYTES_MAX + 3 * ANNOUNCEMENTS_BYTES_MAX);
        out.into_iter().filter_map(|output| self.note(output)).collect()
    }

    pub(super) fn write(&mut self, steady: u64, writer: EntityId) -> Vec<(Vec<SocketAddrV4>, Bytes)> {
        let guid = self.guid(writer);
        let own = self.own.get_mut(&writer).unwrap();
        own.written += 1;
        let sample = OutgoingSample { payload: content(guid, own.written), timestamp: None, related: None };
        self.step(steady, Input::Write { writer, sample })
    }

    fn note(&mut self, output: Output) -> Option<(Vec<SocketAddrV4>, Bytes)> {
        let prefix = self.config.prefix;
        match output {
            Output::Send { to, bytes } => {
                self.sent = (self.sent.0 + bytes.len() as u64, self.sent.1 + to.len() as u64);
                assert!(bytes.len() <= crate::limits::DATAGRAM_BYTES_MAX && !to.is_empty());
                return Some((to, bytes));
            }
            Output::Opened(_) => {}
            Output::Written { writer, sequence } => assert_eq!(sequence.0, self.own[&writer].written),
            Output::Sample { reader, sample } => {
                let reception = self.matches.get_mut(&(reader, sample.writer)).unwrap_or_else(|| {
                    panic!("{prefix:?}: a sample of {:?} for {reader:?}, which it does not match", sample.writer)
                });
                let number = sample.sequence.0;
                if !self.liars.contains(&sample.writer.prefix) {
                    // Numbers that are low for long are taken for a writer that began again; a process that stood still sees that in
                    // late samples. Repair prevents it.
                    let is_repaired = self.own[&reader].settings.qos.reliability == Reliability::Reliable;
                    let is_next = number > reception.last || !is_repaired;
                    assert!(
                        is_next && reception.numbers.insert(number),
                        "{prefix:?} {reader:?}: {number} after {}",
                        reception.last
                    );
                    let is_true = sample.payload == content(sample.writer, number);
                    assert!(is_true, "{prefix:?} {reader:?}: {number} is not what was sent");
                }
                reception.first = if reception.samples == 0 { number } else { reception.first };
                reception.last = reception.last.max(number);
                reception.samples += 1;
            }
            Output::Matched { endpoint, other } => {
                assert!(self.found.contains(&other), "{prefix:?}: matched before it was found");
                let before = self.matches.insert((endpoint, other), Reception::default());
                assert_eq!(before, None, "{prefix:?}: {other:?} was matched twice");
            }
            Output::Unmatched { endpoint, other } => {
                assert!(self.matches.remove(&(endpoint, other)).is_some(), "{prefix:?}: {other:?} did not match");
                self.not_alive.remove(&(endpoint, other));
            }
            Output::Incompatible { endpoint, other, policy } => self.incompatible.push((endpoint, other, policy)),
            Output::Lost { reader, writer, count, reason } => {
                assert!(count > 0);
                *self.matches.get_mut(&(reader, writer)).unwrap().lost.entry(reason).or_default() += count;
            }
            Output::Unreachable(participant) => assert!(self.unreachable.insert(participant.guid)),
            Output::NotUnreachable(guid) => assert!(self.unreachable.remove(&guid)),
            Output::Resynchronized { .. } => self.resynchronized += 1,
            Output::Liveliness { reader, writer, is_alive } => {
                assert!(self.matches.contains_key(&(reader, writer)), "{prefix:?}: {writer:?} does not match");
                let is_new = if is_alive {
                    self.not_alive.remove(&(reader, writer))
                } else {
                    self.not_alive.insert((reader, writer))
                };
                assert!(is_new, "{prefix:?}: {writer:?} was reported twice");
            }
            Output::DeadlineMissed { reader, count } => {
                assert!(count > 0);
                *self.deadlines_missed.entry(reader).or_default() += count;
            }
            Output::Acknowledged(writer) => self.own.get_mut(&writer).unwrap().acknowledged += 1,
            Output::Found(endpoint) => {
                self.found.insert(endpoint.guid);
            }
            Output::Gone(guid) => {
                assert!(self.found.remove(&guid), "{prefix:?}: {guid:?} has gone and was not there");
                assert!(
                    self.matches.keys().all(|(_, other)| *other != guid),
                    "{prefix:?}: {guid:?} has gone and matches"
                );
                self.gone += 1;
            }
        }
        None
    }

    /// Opens an endpoint; returns it, and what is sent.
    pub(super) fn open(
        &mut self,
        steady: u64,
        settings: EndpointSettings,
        is_writer: bool,
    ) -> (EntityId, Vec<(Vec<SocketAddrV4>, Bytes)>) {
        let input = if is_writer { Input::OpenWriter } else { Input::OpenReader };
        let mut out = Vec::new();
        let now = Now { steady, wall: self.wall + steady };
        self.participant.step(now, input(settings.clone()), &mut out);
        let opened = out.iter().find_map(|output| match output {
            Output::Opened(entity) => Some(*entity),
            _ => None,
        });
        let entity = opened.unwrap();
        self.own.insert(entity, Own { settings, is_writer, written: 0, acknowledged: 0 });
        (entity, out.into_iter().filter_map(|output| self.note(output)).collect())
    }

    pub(super) fn close(&mut self, steady: u64, entity: EntityId) -> Vec<(Vec<SocketAddrV4>, Bytes)> {
        let sent = self.step(steady, Input::Close(entity));
        self.own.remove(&entity);
        self.matches.retain(|(own, _), _| *own != entity);
        self.not_alive.retain(|(own, _)| *own != entity);
        sent
    }
}
