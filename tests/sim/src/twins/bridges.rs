//! Robots and drivers: the real gate of a robot at a node that may lie, and people who drive it through other nodes.
//!
//! A bridge trusts its node for nothing about control (`crates/ros-bridge/src/routes/delivery.rs`): it asks the voters through it, and
//! trusts a proof. Its node may be a copy of a liar, which has another history, or an honest one that follows a liar. A driver signs
//! with the epoch that its own node reports, so commands arrive that only one history allows.

use super::control::{Block, STALE_AFTER, result_of};
use super::world::{Happening, World};
use crate::client::{Call, sign_knowing};
use crate::clock::{EPOCH, MILLISECOND, SECOND};
use crate::invariant::{Check, Violation};
use bytes::Bytes;
use ledger::CallRef;
use ledger::transaction::{KnownBlock, Transaction};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_gate::gate::{COMMAND_TTL, Now, Settings};
use ledger_gate::guard::{Act, Block as Delivered, Guard, Told};
use ledger_gate::standing::{Members, Standing};
use ledger_light::fact::Fact;
use ledger_light::{Governance, Proof, Way};
use ledger_raft::{Input, Lane};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The robots that are looked at.
const BRIDGES: usize = 2;
/// People who drive.
const DRIVERS: [&str; 2] = ["Org1/driver", "Org2/driver"];
/// A question without an answer for this time is given up, and another node is asked.
const ANSWER_MAX: u64 = 2 * SECOND;
/// Most blocks that a node delivers at once.
const BLOCKS_MAX: u64 = 64;
/// Most changes of who governs that a node shows.
const CHANGES_MAX: usize = 1024;
/// Signing numbers of bridges and drivers are beyond those of the clients.
const NONCES: u64 = 1 << 40;
/// Largest message.
const SAMPLE_BYTES_MAX: usize = 1024;

/// The bridge of a robot, of which one service is looked at.
pub(super) struct Bridge {
    service: &'static str,
    guard: Guard,
    home: Option<Home>,
    governance: Governance,
    members: Members,
    question: Option<Question>,
    /// Since when it waits for an answer, at honest nodes without a break.
    waits_since: Option<u64>,
    /// Messages that were delivered, by their payload.
    delivered: BTreeMap<Bytes, Transaction>,
    /// Signer and epoch of the command that passed last.
    driver: Option<(String, u64)>,
}

/// The node that a bridge is connected to, and how far it has read there.
struct Home {
    at: usize,
    start: u64,
    next: u64,
    heads: u64,
    shown: BTreeSet<Hash>,
}

/// A question to the voters that has no answer yet.
struct Question {
    id: Hash,
    asked: u64,
}

/// A person who drives.
pub(super) struct Driver {
    person: &'static str,
    service: &'static str,
    home: Option<usize>,
    /// When it turns to another node.
    leaves: u64,
    /// When it asks for the service again.
    acquires: u64,
    sequence: u64,
    /// The newest block that it knows, and since when.
    known: (Hash, u64),
}

impl World {
    /// Two robots' bridges, and two who drive, where the plan wants them.
    pub(super) fn build_bridges(&mut self) {
        if !self.plan.robots {
            return;
        }
        // In calm seeds one client does nothing but stop the other robot.
        let service = if self.plan.calm || self.random.percent(50) { "Husky/cmd_vel" } else { "Turtlebot4/cmd_vel" };
        for at in 0..BRIDGES {
            let bridge = self.opened(service);
            self.bridges.push(Some(bridge));
            self.schedule(2 * SECOND, Happening::Bridge { at });
        }
        for (at, person) in DRIVERS.into_iter().enumerate() {
            let known = (Hash::ZERO, 0);
            self.drivers.push(Driver { person, service, home: None, leaves: 0, acquires: 0, sequence: 0, known });
            self.schedule(2 * SECOND, Happening::Drive { driver: at });
        }
    }

    fn opened(&self, service: &'static str) -> Bridge {
        let settings = Settings {
            network: self.network,
            sample_bytes_max: SAMPLE_BYTES_MAX,
            max_age: None,
            stale_after: Duration::from_micros(STALE_AFTER),
            command_timeout: None,
        };
        Bridge {
            service,
            guard: Guard::new(settings, service, self.steady()),
            home: None,
            members: Members::of(&self.founded).unwrap(),
            governance: self.founded.clone(),
            question: None,
            waits_since: None,
            delivered: BTreeMap::new(),
            driver: None,
        }
    }

    fn steady(&self) -> Now {
        Now { wall: EPOCH + self.now, steady: self.now }
    }

    /// A person signs the next command, or asks for the service.
    pub(super) fn drive(&mut self, at: usize) -> Check {
        if self.now > self.plan.ends + 10 * SECOND {
            return Ok(());
        }
        let next = self.random.between(150, 450) * MILLISECOND;
        self.schedule(next, Happening::Drive { driver: at });
        let driver = &self.drivers[at];
        let is_up = |home: &usize| self.copies[*home].up.is_some();
        if driver.home.filter(is_up).is_none() || self.now >= driver.leaves {
            // The second one often drives through a liar's copy.
            let home = self.some_copy(if at == 0 { 10 } else { 80 });
            let leaves = self.now + self.random.between(1, 5) * SECOND;
            let driver = &mut self.drivers[at];
            (driver.home, driver.leaves) = (home, leaves);
        }
        let Some(home) = self.drivers[at].home else { return Ok(()) };
        let Some(up) = &self.copies[home].up else { return Ok(()) };
        let tip = up.ledger.tip();
        let epoch = self
            .control
            .block(&tip.hash)
            .and_then(|block| block.rights.epoch(self.drivers[at].service, self.drivers[at].person));
        let (now, driver) = (self.now, &mut self.drivers[at]);
        if driver.known.0 != tip.hash {
            driver.known = (tip.hash, now);
        }
        let known_us = now - driver.known.1;
        let service = driver.service.to_owned();
        let (call, lane) = match epoch {
            Some(epoch) => {
                driver.sequence += 1;
                (Call::Set { service, epoch, seq: driver.sequence }, Lane::Data)
            }
            None if now >= driver.acquires => {
                driver.acquires = now + 500 * MILLISECOND;
                (Call::Acquire { service, lease_ms: None }, Lane::Control)
            }
            None => return Ok(()),
        };
        let hash = KnownBlock::prefix(&tip.hash.0).map(|hash| Bytes::copy_from_slice(&hash)).unwrap_or_default();
        let known = KnownBlock { height: tip.height, hash, known_us };
        let (person, nonce) = (driver.person, self.next_nonce());
        let not_after = EPOCH + self.now + COMMAND_TTL.as_micros() as u64;
        let signer = self.cast.person(person);
        let signed = sign_knowing(signer, self.network, nonce, not_after, call.transaction(), true, Some(known));
        self.input(home, Input::Submit { lane, transaction: signed.encoded().clone() })
    }

    fn next_nonce(&mut self) -> u64 {
        self.nonces += 1;
        NONCES + self.nonces
    }

    /// A copy that runs: one of a liar with this probability in percent, if there is one.
    fn some_copy(&mut self, percent: u64) -> Option<usize> {
        let wants_liar = self.lying && self.random.percent(percent);
        let fits = |at: &usize| self.copies[*at].up.is_some() && self.copies[*at].lies == wants_liar;
        let mut copies: Vec<usize> = (0..self.copies.len()).filter(fits).collect();
        if copies.is_empty() {
            copies = (0..self.copies.len()).filter(|at| self.copies[*at].up.is_some()).collect();
        }
        self.random.pick(&copies).copied()
    }

    /// A bridge reads what its node has, and asks what is due.
    pub(super) fn bridge(&mut self, at: usize) -> Check {
        let Some(mut bridge) = self.bridges[at].take() else { return Ok(()) };
        if self.now > self.plan.ends + 10 * SECOND {
            return Ok(());
        }
        let next = self.random.between(20, 60) * MILLISECOND;
        self.schedule(next, Happening::Bridge { at });
        if self.random.below(1000) == 0 {
            self.note(format_args!("bridge {at} starts again"));
            self.control.forgets(at);
            bridge = self.opened(bridge.service);
        }
        let done = self.look_after(at, &mut bridge);
        self.bridges[at] = Some(bridge);
        done
    }

    fn look_after(&mut self, at: usize, bridge: &mut Bridge) -> Check {
        let now = self.steady();
        if let Some(reason) = bridge.guard.overdue(now) {
            self.stopped(at, reason);
        }
        if let Some(fault) = bridge.guard.gate().fault().map(str::to_owned) {
            if self.judge.is_binding() {
                return Err(Violation::new("gate", fault));
            }
            // Its voters have certified two histories. The robot stands, and the bridge ends and starts again.
            self.note(format_args!("bridge {at} ends: {fault}"));
            self.control.forgets(at);
            *bridge = self.opened(bridge.service);
        }
        if let Some((person, epoch)) = bridge.driver.as_ref().filter(|_| bridge.guard.gate().is_moving())
            && self.judge.is_binding()
        {
            self.control.moves(at, bridge.service, (person, *epoch), self.now)?;
        }
        let runs = |home: &Home| {
            let copy = &self.copies[home.at];
            copy.up.is_some() && copy.node.start == home.start
        };
        let is_late = bridge.question.as_ref().is_some_and(|question| self.now >= question.asked + ANSWER_MAX);
        if is_late {
            bridge.guard.unanswered(None);
            bridge.question = None;
        }
        if is_late || bridge.home.as_ref().is_none_or(|home| !runs(home)) {
            self.connect(at, bridge);
        }
        let waits = bridge.waits_since.map_or(0, |since| self.now - since);
        if self.leader_is_too_late(waits) {
            let what = format!("bridge {at} has no answer for {waits} us");
            return Err(Violation::new("no leader withholds a call for good", what));
        }
        self.read(at, bridge)?;
        self.answer(at, bridge)?;
        self.ask_voters(bridge)
    }

    fn stopped(&mut self, at: usize, reason: &'static str) {
        self.note(format_args!("bridge {at} stops its robot: {reason}"));
        self.judge.counts.count("a gate stops its robot");
    }

    /// Turns to another node, as often to a liar's as not.
    fn connect(&mut self, at: usize, bridge: &mut Bridge) {
        bridge.home = None;
        let Some(home) = self.some_copy(50) else { return };
        let copy = &self.copies[home];
        let Some(up) = &copy.up else { return };
        let tip = up.ledger.tip().height;
        let (start, label) = (copy.node.start, self.label(home));
        self.note(format_args!("bridge {at} connects to {label}"));
        bridge.waits_since = bridge.waits_since.filter(|_| !self.copies[home].lies);
        bridge.home = Some(Home { at: home, start, next: tip + 1, heads: tip, shown: BTreeSet::new() });
    }

    /// The node delivers the events of new blocks (`src/clients/gateway/subscribe.rs`), and that it lives.
    fn read(&mut self, at: usize, bridge: &mut Bridge) -> Check {
        let Some(home) = &mut bridge.home else { return Ok(()) };
        let Some(up) = &self.copies[home.at].up else { return Ok(()) };
        let tip = up.ledger.tip().height;
        let until = tip.min(home.next + BLOCKS_MAX);
        let hashes = (home.next..=until).filter_map(|height| up.point(height)).map(|point| point.hash);
        let blocks: Vec<_> = hashes.filter_map(|hash| self.control.block(&hash)).collect();
        home.next = until + 1;
        let now = self.steady();
        for block in blocks {
            let header = &block.outcome.header;
            bridge.guard.heard(header.time, now);
            if let Some(home) = bridge.home.as_mut().filter(|home| home.heads < header.height) {
                home.heads = header.height;
                let head = KnownBlock::prefix(&block.outcome.hash.0).unwrap_or_default();
                bridge.guard.heads(header.height, &head, now);
            }
            let acts = self.deliver_events(bridge, &block);
            self.act(at, bridge, acts)?;
        }
        // A sign of life.
        let up = bridge.home.as_ref().and_then(|home| self.copies[home.at].up.as_ref());
        if let Some(up) = up {
            bridge.guard.heard(up.ledger.tip().time, now);
        }
        Ok(())
    }

    fn deliver_events(&self, bridge: &mut Bridge, block: &Block) -> Vec<Act> {
        let (outcome, now) = (&block.outcome, self.steady());
        let mut delivered = Delivered::new(outcome.header.height, outcome.header.time);
        let (mut acts, mut last) = (Vec::new(), None);
        let robot = bridge.service.split('/').next().unwrap_or_default();
        for emitted in &outcome.events {
            let event = &emitted.event;
            if event.chaincode != "msp" && event.subject != bridge.service && event.subject != robot {
                continue;
            }
            let (mut transaction, mut certificate) = (Bytes::new(), Bytes::new());
            // A transaction with several events is sent with the first of them, a certificate with the first of its signer.
            if let Some(index) = emitted.index.filter(|index| last != Some(*index)) {
                last = Some(index);
                transaction = outcome.transactions.get(index as usize).cloned().unwrap_or_default();
                if let Ok(signed) = Transaction::decode(transaction.clone()) {
                    let is_new = bridge.home.as_mut().is_some_and(|home| home.shown.insert(signed.creator()));
                    let person = self.cast.by_fingerprint(&signed.creator()).filter(|_| is_new);
                    certificate = person.map(|person| person.certificate.clone()).unwrap_or_default();
                    if let Some(payload) = signed.body().args.get(3).cloned() {
                        bridge.delivered.insert(payload, signed);
                    }
                }
            }
            let index = emitted.index.unwrap_or_default();
            let (chaincode, name, payload) = (&*event.chaincode, &*event.name, &*event.payload);
            let told = Told { index, chaincode, name, payload, transaction: &transaction, certificate: &certificate };
            acts.extend(bridge.guard.told(&mut delivered, &told, now));
        }
        acts
    }

    fn act(&mut self, at: usize, bridge: &mut Bridge, acts: Vec<Act>) -> Check {
        for act in acts {
            match act {
                Act::Stop(reason) => self.stopped(at, reason),
                Act::Refused { refused, .. } => {
                    self.judge.counts.count("a command does not pass a gate");
                    self.note(format_args!("bridge {at} rejects a command: {}", refused.name()));
                }
                Act::Publish(passed) => {
                    for sample in passed.samples {
                        let Some(signed) = bridge.delivered.get(sample.wire()) else {
                            return Err(Violation::new("gate", format!("bridge {at} makes up {sample:?}")));
                        };
                        let person = self.cast.by_fingerprint(&signed.creator()).map(|person| person.id());
                        let epoch =
                            signed.body().args.get(1).and_then(|epoch| std::str::from_utf8(epoch).ok()?.parse().ok());
                        let driver = person.zip(epoch).unwrap_or_default();
                        let lies = bridge.home.as_ref().is_some_and(|home| self.copies[home.at].lies);
                        self.judge.counts.count(if lies && self.lying {
                            "a command passes a gate at a lying node"
                        } else {
                            "a command passes a gate"
                        });
                        self.note(format_args!("bridge {at} lets {} of {} pass", signed.id(), driver.0));
                        if self.judge.is_binding() {
                            self.control.passes(at, bridge.service, (&driver.0, driver.1), self.now)?;
                        }
                        bridge.driver = Some(driver);
                    }
                }
            }
        }
        Ok(())
    }

    /// The answer to the question, if the node has it with its certificate.
    fn answer(&mut self, at: usize, bridge: &mut Bridge) -> Check {
        let (Some(question), Some(home)) = (&bridge.question, &bridge.home) else { return Ok(()) };
        let copy = &self.copies[home.at];
        let Some(up) = &copy.up else { return Ok(()) };
        let is_here = |block: &Block| {
            let (height, hash) = (block.outcome.header.height, block.outcome.hash);
            height <= up.ledger.tip().height && up.point(height).is_some_and(|point| point.hash == hash)
        };
        let blocks = self.control.blocks_of(&question.id);
        let Some(block) = blocks.into_iter().find(|block| is_here(block)) else { return Ok(()) };
        let Some((index, result)) = result_of(&block, &question.id) else { return Ok(()) };
        if result.code() != Code::Ok {
            self.note(format_args!("bridge {at} gets no answer: {}", result.code()));
            bridge.guard.unanswered(None);
            bridge.question = None;
            return Ok(());
        }
        let height = block.outcome.header.height;
        let wanted = |fact: &Fact<'_>| matches!(fact, Fact::Verdict { index: at, .. } if *at == index);
        let certificate = copy.certificates.get(&height).cloned();
        let facts = certificate.as_ref().and_then(|_| up.ledger.shown(height, wanted).unwrap());
        let Some((certificate, facts)) = certificate.zip(facts) else { return Ok(()) };
        let changes = up.ledger.changes(bridge.governance.height(), CHANGES_MAX).unwrap();
        let mut way = Way::from(bridge.governance.clone());
        let proof = Proof { certificate, facts };
        let mut shown = changes.into_iter().filter(|change| change.height <= height);
        let standing = shown
            .try_for_each(|change| way.change(change.height, &change.to_bytes()))
            .and_then(|()| proof.answers(&question.id, &result.response))
            .and_then(|()| {
                way.follow(proof);
                let governance = way.end()?.governance;
                let members = Members::of(&governance)?;
                let standing = Standing::declared(&result.response, &members, &governance)?;
                Ok((governance, members, standing))
            });
        let asked = question.asked;
        bridge.question = None;
        match standing {
            Ok((governance, members, standing)) => {
                bridge.waits_since = None;
                (bridge.governance, bridge.members) = (governance, members);
                self.judge.counts.count("the voters answer a gate");
                self.note(format_args!("bridge {at} learns the state of block {height}"));
                let Ok(service) = standing.service(bridge.service) else { return Ok(()) };
                let acts = bridge.guard.answered(&service, &standing, asked, self.steady());
                self.act(at, bridge, acts)
            }
            Err(rejection) => {
                self.note(format_args!("bridge {at} does not believe an answer: {rejection}"));
                bridge.guard.unanswered(None);
                self.connect(at, bridge);
                Ok(())
            }
        }
    }

    /// Asks for the certified state, through the node.
    fn ask_voters(&mut self, bridge: &mut Bridge) -> Check {
        let is_due = bridge.guard.asks_at().is_some_and(|due| due <= self.now);
        let Some(home) = bridge.home.as_ref().map(|home| home.at).filter(|_| is_due && bridge.question.is_none())
        else {
            return Ok(());
        };
        bridge.guard.ask(self.steady());
        let robot = bridge.service.split('/').next().unwrap_or_default();
        let stops = bridge.guard.open_stops().map(|stop| Bytes::from(stop.to_string()));
        let call = ("abac", "declare", std::iter::once(Bytes::from(robot)).chain(stops).collect());
        let (nonce, not_after) = (self.next_nonce(), EPOCH + self.now + 5 * SECOND);
        let signed = sign_knowing(self.cast.person("Org1/admin"), self.network, nonce, not_after, call, true, None);
        bridge.question = Some(Question { id: signed.id(), asked: self.now });
        if !self.copies[home].lies {
            bridge.waits_since.get_or_insert(self.now);
        }
        self.input(home, Input::Submit { lane: Lane::Data, transaction: signed.encoded().clone() })
    }

    /// A stop has arrived at a node, which notifies the robots before it is ordered (`src/peers/early_stop.rs`): directly, or through
    /// their own nodes, which judge the call by their own state. A liar does not pass it on.
    pub(super) fn notify(&mut self, from: usize, stop: &Transaction) -> Check {
        for at in 0..self.bridges.len() {
            let Some(mut bridge) = self.bridges[at].take() else { continue };
            let home = bridge.home.as_ref().map(|home| home.at);
            let reaches = |home: &usize| *home == from || !self.copies[*home].lies && !self.is_cut;
            let reached = home.filter(reaches).filter(|home| *home == from || self.random.percent(80));
            let foreseen = reached.and_then(|home| {
                let up = self.copies[home].up.as_ref()?;
                Some((up.ledger.foresee(stop, EPOCH + self.now)?, up.ledger.tip()))
            });
            if let Some((events, tip)) = foreseen {
                let robot = bridge.service.split('/').next().unwrap_or_default();
                let mut delivered = Delivered::new(tip.height, tip.time);
                let (now, none) = (self.steady(), Bytes::new());
                let mut acts = Vec::new();
                for event in events.iter().filter(|event| event.subject == robot) {
                    let told = Told {
                        index: 0,
                        chaincode: &event.chaincode,
                        name: &event.name,
                        payload: &event.payload,
                        transaction: stop.encoded(),
                        certificate: &none,
                    };
                    acts.extend(bridge.guard.told(&mut delivered, &told, now));
                }
                // The gate keeps the stop if it can verify its signature.
                let open: BTreeSet<CallRef> = bridge.guard.open_stops().collect();
                if open.contains(&stop.call_ref()) {
                    self.control.notified(at, stop.call_ref());
                    self.judge.counts.count("a gate is notified of a stop before it is ordered");
                }
                self.act(at, &mut bridge, acts)?;
            }
            self.bridges[at] = Some(bridge);
        }
        Ok(())
    }
}
