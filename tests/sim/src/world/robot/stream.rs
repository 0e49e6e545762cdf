//! The stream of events from a node to the robot (`src/clients/gateway/subscribe.rs`).

use super::Happening;
use crate::clock::MILLISECOND;
use crate::robot::{Delivery, Robot, Stream, Told};
use crate::world::{Awake, Block, Event as Happens, World};
use ledger::transaction::{KnownBlock, Transaction};
use ledger_storage::result::Event;
use std::collections::BTreeSet;

/// Most blocks that a node looks at in one go.
const BLOCKS_MAX: u64 = 64;
/// A node gives a sign of life that often, microseconds.
const HEARTBEAT: u64 = 250 * MILLISECOND;
/// The names of the events that the robot wants.
const NAMES: [&str; 9] =
    ["message", "granted", "released", "robot", "stopped", "resumed", "revoked", "revocation_list", "keyed"];

impl World {
    /// The robot turns to a node: often to the one that lies, while it does.
    pub(super) fn connect(&mut self, robot: &mut Robot) {
        let members = self.gateways();
        let up = |id: &u64| matches!(self.awake(*id), Awake::Yes) && self.tip(*id).is_some();
        let nodes: Vec<u64> = members.into_iter().filter(up).collect();
        let liar = robot.liar.filter(|id| self.chaos && up(id));
        let liar = liar.filter(|_| self.random.robot.percent(70));
        let Some(node) = liar.or_else(|| self.random.robot.pick(&nodes).copied()) else {
            robot.stream = None;
            return;
        };
        let after = self.tip(node).map_or(1, |tip| tip.0 + 1);
        robot.streams += 1;
        let number = robot.streams;
        // What a node has told of blocks that do not exist does not make the robot deaf.
        let next = if robot.next == 0 { after } else { robot.next.min(after) };
        robot.next = next;
        let (now, start) = (self.now, self.start_of(node));
        robot.stream = Some(Stream {
            number,
            node,
            start,
            next,
            heads: next - 1,
            shown: BTreeSet::new(),
            opened: now,
            sent: now,
            arrives: now,
            heard: now,
            silent_until: 0,
        });
        self.note(format_args!("robot: stream {number} from n{node}, block {next} on"));
        let delay = self.random.robot.between(1, 20) * MILLISECOND;
        self.happens(delay, Happening::Look { stream: number });
    }

    /// A stream is lost.
    pub(super) fn lost(&mut self, robot: &mut Robot, number: u64) {
        if robot.stream.as_ref().is_some_and(|stream| stream.number == number) {
            robot.stream = None;
        }
    }

    /// The node looks for what is to be delivered.
    pub(super) fn look_for(&mut self, robot: &mut Robot, number: u64) {
        let Some(stream) = robot.stream.as_ref().filter(|stream| stream.number == number) else { return };
        let (node, start) = (stream.node, stream.start);
        match self.awake(node) {
            Awake::At(later) => return self.schedule_at(later, Happens::Robot(Happening::Look { stream: number })),
            Awake::Yes if self.start_of(node) == start => {}
            _ => return self.happens(1, Happening::Lost { stream: number }),
        }
        let mut batch = self.news(robot, node);
        if robot.liar == Some(node) && self.chaos {
            self.distort(robot, &mut batch);
        }
        for delivery in batch {
            if !self.send_to_robot(robot, delivery) {
                return self.happens(1, Happening::Lost { stream: number });
            }
        }
        let next = self.random.robot.between(5, 40) * MILLISECOND;
        self.happens(next, Happening::Look { stream: number });
    }

    /// The deliveries of an honest node.
    fn news(&mut self, robot: &mut Robot, node: u64) -> Vec<Delivery> {
        let (now, tip) = (self.now, self.tip(node).map_or(0, |tip| tip.0));
        let Some(stream) = &mut robot.stream else { return Vec::new() };
        let until = tip.min(stream.next.saturating_add(BLOCKS_MAX));
        let mut batch = Vec::new();
        while stream.next <= until {
            let height = stream.next;
            stream.next += 1;
            let Some(block) = self.blocks.get(height as usize - 1) else { break };
            let (outcome, mut last) = (&block.outcome, None);
            let mut events = Vec::new();
            for emitted in &outcome.events {
                let event = &emitted.event;
                let is_of_robot = event.subject.split('/').next() == Some(robot.name);
                let wanted = event.chaincode == "abac" && is_of_robot || event.chaincode == "msp";
                if !wanted || !NAMES.contains(&&*event.name) {
                    continue;
                }
                let index = emitted.index.unwrap_or_default();
                let mut told = Told {
                    index,
                    chaincode: event.chaincode.clone(),
                    name: event.name.clone(),
                    subject: event.subject.clone(),
                    payload: event.payload.clone(),
                    transaction: bytes::Bytes::new(),
                    certificate: bytes::Bytes::new(),
                };
                // A transaction with several events is sent with the first of them.
                if emitted.index.is_some() && last != emitted.index {
                    last = emitted.index;
                    told.transaction = outcome.transactions.get(index as usize).cloned().unwrap_or_default();
                    let creator = Transaction::decode(told.transaction.clone()).map(|signed| signed.creator());
                    if let Some(creator) =
                        creator.ok().filter(|creator| stream.shown.insert((event.subject.clone(), *creator)))
                    {
                        let person = self.people.by_fingerprint(&creator);
                        told.certificate = person.map(|person| person.certificate.clone()).unwrap_or_default();
                    }
                }
                events.push(told);
            }
            if !events.is_empty() {
                let heads = heads(&self.blocks, &mut stream.heads, height);
                batch.push(Delivery { height, time: outcome.header.time, events, early: false, heads });
            }
        }
        if batch.is_empty() && now >= stream.sent + HEARTBEAT {
            let height = stream.next.saturating_sub(1).min(tip);
            let time = self.blocks.get((height as usize).wrapping_sub(1)).map_or(0, |block| block.outcome.header.time);
            let heads = heads(&self.blocks, &mut stream.heads, height);
            batch.push(Delivery { height, time, events: Vec::new(), early: false, heads });
        }
        if now < stream.silent_until {
            batch.clear();
        }
        batch
    }

    /// A node has taken a call in: the robot is notified of a stop before it is ordered (`src/peers/early_stop.rs`). Its own node judges
    /// the call as if a user of its own had submitted it, unless the way from the other one is cut. Is it notified?
    pub(in crate::world) fn notify_robot(&mut self, from: u64, transaction: &Transaction) -> bool {
        let Some(mut robot) = self.robot.take() else { return false };
        let node = robot.stream.as_ref().map(|stream| stream.node);
        let passed_on = node.filter(|node| *node == from || self.random.robot.percent(80));
        let foreseen = passed_on.and_then(|node| {
            let node = self.nodes.get(&node)?;
            let running = node.up.as_ref()?;
            Some((running.ledger.foresee(transaction, node.clock.now(self.now))?, running.ledger.tip()))
        });
        let mut is_notified = false;
        if let Some((events, tip)) = foreseen {
            let of_robot = events.into_iter().filter(|event| event.subject == robot.name);
            let told = |event: Event| Told {
                index: 0,
                chaincode: event.chaincode,
                name: event.name,
                subject: event.subject,
                payload: event.payload,
                transaction: transaction.encoded().clone(),
                certificate: bytes::Bytes::new(),
            };
            let events: Vec<_> = of_robot.map(told).collect();
            if !events.is_empty() {
                let delivery = Delivery { height: tip.height, time: tip.time, events, early: true, heads: Vec::new() };
                is_notified = self.send_to_robot(&mut robot, delivery);
            }
        }
        self.robot = Some(robot);
        is_notified
    }

    /// Sends a delivery on its way, behind those before it. False if the connection is lost.
    fn send_to_robot(&mut self, robot: &mut Robot, delivery: Delivery) -> bool {
        let Some(stream) = &mut robot.stream else { return false };
        let Some(at) = self.links.client(self.now, &mut self.random.robot, &mut self.coverage) else { return false };
        (stream.sent, stream.arrives) = (self.now, at.max(stream.arrives));
        let (number, at) = (stream.number, stream.arrives);
        self.schedule_at(at, Happens::Robot(Happening::Delivered { stream: number, delivery }));
        true
    }
}

/// The hashes of the blocks that were not told yet, up to this height.
fn heads(blocks: &[Block], told: &mut u64, height: u64) -> Vec<u8> {
    let from = std::mem::replace(told, height.max(*told)) as usize;
    let hashes = blocks.iter().take(height as usize).skip(from).map(|block| block.outcome.hash);
    hashes.filter_map(|hash| KnownBlock::prefix(&hash.0)).flatten().collect()
}
