//! A network of hosts in virtual time: loss, duplicates, delays, partitions.

use super::node::Node;
use super::random::Random;
use crate::discovery::locators::{GROUP, data_port, discovery_port};
use crate::guid::{EntityId, GuidPrefix};
use crate::interface::{Channel, Config, EndpointSettings, Input};
use bytes::Bytes;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;

/// Datagrams that wait for a process that stands still: what a receive buffer holds.
const WAITING_MAX: usize = 100;

/// A place for a participant.
pub(super) struct Slot {
    /// None: it does not run.
    pub(super) node: Option<Node>,
    pub(super) config: Config,
    /// Stands still (SIGSTOP).
    pub(super) is_stopped: bool,
    waiting: VecDeque<Input>,
}

/// How bad the network is.
#[derive(Clone, Copy, Default)]
pub(super) struct Weather {
    /// Lost datagrams, percent.
    pub(super) loss: u64,
    /// Datagrams that come twice, percent.
    pub(super) twice: u64,
    /// Longest delay, microseconds. Datagrams overtake each other.
    pub(super) delay: u64,
}

pub(super) struct Network {
    pub(super) now: u64,
    pub(super) random: Random,
    pub(super) weather: Weather,
    pub(super) slots: Vec<Slot>,
    /// Pairs between which nothing goes, the smaller first.
    pub(super) partitions: BTreeSet<(usize, usize)>,
    /// Slots whose datagrams are changed on their way.
    pub(super) liars: BTreeSet<usize>,
    under_way: BTreeMap<(u64, u64), (usize, Input)>,
    count: u64,
}

/// The participant of a slot. Two of three share a host with others.
pub(super) fn config(slot: usize, per_host: usize, lease: u64) -> Config {
    let host = u8::try_from(slot / per_host).unwrap();
    let number = u8::try_from(slot).unwrap();
    let ip = Ipv4Addr::new(10, 0, 0, host + 1);
    Config {
        prefix: GuidPrefix([1, 0x0e, 7, 7, 7, 7, 7, 7, 7, 7, 7, number]),
        domain: 0,
        participant_id: u16::try_from(slot % per_host).unwrap(),
        lease: Duration::from_micros(lease),
        addresses: vec![ip],
        host: vec![ip],
        static_peers: Vec::new(),
        multicast: true,
        name: format!("node {slot}"),
        user_data: Bytes::from_static(b"enclave=/;"),
    }
}

impl Network {
    pub(super) fn new(seed: u64, configs: impl IntoIterator<Item = Config>) -> Self {
        let slot = |config| Slot { node: None, config, is_stopped: false, waiting: VecDeque::new() };
        Self {
            now: 1_000_000,
            random: Random(seed),
            weather: Weather { delay: 200, ..Weather::default() },
            slots: configs.into_iter().map(slot).collect(),
            partitions: BTreeSet::new(),
            liars: BTreeSet::new(),
            under_way: BTreeMap::new(),
            count: 0,
        }
    }

    pub(super) fn start(&mut self, slot: usize) {
        let config = self.slots[slot].config.clone();
        let liars = self.liars.iter().map(|liar| self.slots[*liar].config.prefix).collect();
        self.slots[slot].node = Some(Node { liars, ..Node::new(config, self.now, 1_700_000_000_000_000) });
        self.slots[slot].is_stopped = false;
        self.slots[slot].waiting.clear();
    }

    /// The next participant of a slot is another one.
    pub(super) fn renew_prefix(&mut self, slot: usize) {
        let GuidPrefix([_, _, generation, ..]) = &mut self.slots[slot].config.prefix;
        *generation += 1;
    }

    pub(super) fn crash(&mut self, slot: usize) -> Option<Node> {
        self.slots[slot].node.take()
    }

    pub(super) fn node(&mut self, slot: usize) -> &mut Node {
        self.slots[slot].node.as_mut().unwrap()
    }

    pub(super) fn running(&self) -> Vec<usize> {
        (0..self.slots.len()).filter(|slot| self.slots[*slot].node.is_some() && !self.slots[*slot].is_stopped).collect()
    }

    pub(super) fn open(&mut self, slot: usize, settings: EndpointSettings, is_writer: bool) -> EntityId {
        let now = self.now;
        let (entity, sent) = self.node(slot).open(now, settings, is_writer);
        self.send(slot, sent);
        entity
    }

    pub(super) fn close(&mut self, slot: usize, entity: EntityId) {
        let now = self.now;
        let sent = self.node(slot).close(now, entity);
        self.send(slot, sent);
    }

    pub(super) fn write(&mut self, slot: usize, writer: EntityId) {
        let now = self.now;
        let sent = self.node(slot).write(now, writer);
        self.send(slot, sent);
    }

    pub(super) fn step(&mut self, slot: usize, input: Input) {
        let now = self.now;
        let sent = self.node(slot).step(now, input);
        self.send(slot, sent);
    }

    /// A process that stood still goes on; datagrams that wait come in after the time has passed.
    pub(super) fn resume(&mut self, slot: usize) {
        self.slots[slot].is_stopped = false;
        self.step(slot, Input::Time);
        while let Some(input) = self.slots[slot].waiting.pop_front() {
            self.step(slot, input);
        }
    }

    pub(super) fn send(&mut self, from: usize, sent: Vec<(Vec<SocketAddrV4>, Bytes)>) {
        for (to, bytes) in sent {
            for to in to {
                self.send_to(from, to, &bytes);
            }
        }
    }

    /// Sends a datagram as the participant of a slot would.
    pub(super) fn send_to(&mut self, from: usize, to: SocketAddrV4, bytes: &Bytes) {
        let sender = self.slots[from].config.clone();
        let source = SocketAddrV4::new(sender.addresses[0], data_port(0, sender.participant_id).unwrap());
        for slot in 0..self.slots.len() {
            let Some(channel) = channel(&sender, &self.slots[slot].config, to) else { continue };
            let is_cut = self.partitions.contains(&(from.min(slot), from.max(slot)));
            if is_cut || self.random.chance(self.weather.loss) {
                continue;
            }
            for _ in 0..=u64::from(self.random.chance(self.weather.twice)) {
                let bytes = if self.liars.contains(&from) {
                    super::liar::lie(&mut self.random, sender.prefix, bytes)
                } else {
                    bytes.clone()
                };
                let at = self.now + 20 + self.random.below(self.weather.delay);
                self.count += 1;
                self.under_way.insert((at, self.count), (slot, Input::Datagram { from: source, channel, bytes }));
            }
        }
    }

    /// Lets time pass.
    pub(super) fn run(&mut self, micros: u64) {
        let end = self.now + micros;
        let mut steps_at_once = 0;
        loop {
            let timers = self.running().into_iter().filter_map(|slot| {
                let due = self.slots[slot].node.as_ref()?.participant.deadline()?;
                Some((due.max(self.now), slot))
            });
            let timer = timers.min();
            let arrival = self.under_way.first_key_value().map(|((at, _), _)| *at);
            let at = arrival.into_iter().chain(timer.map(|(at, _)| at)).min().filter(|at| *at <= end);
            let Some(at) = at else { break };
            steps_at_once = if at == self.now { steps_at_once + 1 } else { 0 };
            assert!(steps_at_once < 100_000, "a participant does not rest");
            self.now = at;
            if arrival == Some(at) {
                let (_, (slot, input)) = self.under_way.pop_first().unwrap();
                self.arrive(slot, input);
            } else if let Some((_, slot)) = timer {
                self.step(slot, Input::Time);
            }
        }
        self.now = end;
    }

    fn arrive(&mut self, slot: usize, input: Input) {
        let place = &mut self.slots[slot];
        if place.node.is_none() {
            return;
        }
        if place.is_stopped {
            if place.waiting.len() < WAITING_MAX {
                place.waiting.push_back(input);
            }
            return;
        }
        self.step(slot, input);
    }
}

/// By which socket a participant takes a datagram in. The sender receives its own multicast.
fn channel(sender: &Config, receiver: &Config, to: SocketAddrV4) -> Option<Channel> {
    if *to.ip() == GROUP {
        return match to.port() {
            7400 => Some(Channel::DiscoveryMulticast),
            7401 => Some(Channel::DataMulticast),
            _ => None,
        };
    }
    let is_loopback = to.ip().is_loopback() && sender.host == receiver.host;
    let port = Some(to.port());
    match is_loopback || receiver.addresses.contains(to.ip()) {
        true if port == discovery_port(0, receiver.participant_id) => Some(Channel::DiscoveryUnicast),
        true if port == data_port(0, receiver.participant_id) => Some(Channel::DataUnicast),
        _ => None,
    }
}
