//! The people: clients that call, and the operator who does what stopped nodes say.

use super::copy::{Copy, Up};
use super::world::{Happening, World};
use crate::client::{Call, SERVICES, sign};
use crate::clock::{Clock, EPOCH, MILLISECOND, SECOND};
use crate::invariant::{Check, Violation};
use crate::node::Node;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_raft::{Input, Lane};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// A call is given to a node of another organisation after this time.
const AGAIN_AFTER: u64 = SECOND;
/// A call counts for this long.
const CALL_TIME: u64 = 28 * SECOND;
/// In a calm network, a control call is executed within this time for each node that lies, and this once more. A leader that
/// orders nothing is complained about after five seconds; then another one is elected.
const CALM_MAX: u64 = 8 * SECOND;
/// Time after the liars are gone until it is looked whether the rest serves.
const REST: u64 = 15 * SECOND;
/// The same where nodes have stopped because most others have another history.
const FORKED_REST: u64 = 60 * SECOND;

/// A person that calls.
pub(super) struct Client {
    person: String,
    orders: Vec<Call>,
    waits: Option<Waits>,
    nonce: u64,
}

/// A call that is under way.
struct Waits {
    transaction: Transaction,
    lane: Lane,
    since: u64,
    given: u64,
    /// The node that had it last.
    node: u64,
    /// It would be executed in any state.
    must_be_ordered: bool,
}

impl World {
    /// The owner sets the robots up, then drivers of two organisations call.
    pub(super) fn employ(&mut self) {
        for (client, person) in ["Org1/admin", "Org1/driver", "Org2/driver", "Org2/admin"].into_iter().enumerate() {
            let orders = if client == 0 { vec![Call::Setup { open: true }] } else { Vec::new() };
            self.clients.push(Client {
                person: person.to_owned(),
                orders,
                waits: None,
                nonce: client as u64 * 1_000_000,
            });
            let delay = if client == 0 { SECOND } else { 2 * SECOND };
            self.schedule(delay, Happening::Client { client });
        }
    }

    /// A client looks what became of its call, and makes the next one.
    pub(super) fn work(&mut self, client: usize) -> Check {
        let now = self.now;
        if let Some(waits) = self.clients[client].waits.take() {
            let is_done = self.done.contains(&waits.transaction.id());
            if !is_done {
                return self.waits_on(client, waits);
            }
        }
        if self.plan.ends + REST < now {
            return Ok(());
        }
        let service = SERVICES[self.random.below(SERVICES.len() as u64) as usize].to_owned();
        let stops = self.plan.calm && client == 0;
        let next = self.clients[client].orders.pop().unwrap_or_else(|| match self.random.below(8) {
            _ if stops => Call::Stop { robot: "Turtlebot4" },
            0 | 1 => Call::Acquire { service, lease_ms: None },
            2 => Call::Release { service },
            3 => Call::Stop { robot: "Turtlebot4" },
            4 => Call::Resume { robot: "Turtlebot4" },
            _ => {
                let (epoch, seq) = (self.random.below(4), self.clients[client].nonce % 1_000_000);
                Call::Set { service, epoch, seq }
            }
        });
        let person = self.clients[client].person.clone();
        let transaction = self.signed(client, &person, &next);
        let lane = if matches!(next, Call::Set { .. }) { Lane::Data } else { Lane::Control };
        self.note(format_args!("{person} calls {} {}", next.name(), transaction.id()));
        // Its own robots, an admin may always stop.
        let must_be_ordered = client == 0 && matches!(next, Call::Stop { .. });
        let waits = Waits { transaction, lane, since: now, given: 0, node: 0, must_be_ordered };
        self.waits_on(client, waits)
    }

    fn signed(&mut self, client: usize, person: &str, call: &Call) -> Transaction {
        self.sign_as(client, person, call.transaction())
    }

    pub(super) fn sign_as(&mut self, client: usize, person: &str, call: (&str, &str, Vec<Bytes>)) -> Transaction {
        let nonce = self.clients[client].nonce;
        self.clients[client].nonce += 1;
        let cast = Arc::clone(&self.cast);
        sign(cast.person(person), self.network, nonce, EPOCH + self.now + CALL_TIME, call, true)
    }

    /// In a calm network: must a call that waits for this time, microseconds, have been ordered?
    pub(super) fn leader_is_too_late(&self, waited: u64) -> bool {
        let liars = self.copies.iter().filter(|copy| copy.lies).count() as u64;
        let is_calm = self.plan.calm && self.lying && self.plan.can_depose();
        is_calm && waited > CALM_MAX * (liars + 1)
    }

    fn waits_on(&mut self, client: usize, mut waits: Waits) -> Check {
        let now = self.now;
        let waited = now - waits.since;
        if waits.lane == Lane::Control && waits.must_be_ordered && self.leader_is_too_late(waited) {
            let what = format!("{} was called {waited} us ago", waits.transaction.id());
            return Err(Violation::new("no leader withholds a call for good", what));
        }
        // In a calm network, only its end ends a call.
        if waited > CALL_TIME {
            let next = self.random.around(self.plan.think);
            self.schedule(next, Happening::Client { client });
            return Ok(());
        }
        if waits.given == 0 || now - waits.given >= AGAIN_AFTER {
            let honest = |copy: &(usize, &Copy)| {
                let is_other = copy.1.node.id != waits.node;
                !copy.1.lies && copy.1.up.is_some() && is_other
            };
            let nodes: Vec<usize> = self.copies.iter().enumerate().filter(honest).map(|(at, _)| at).collect();
            if let Some(at) = self.random.pick(&nodes).copied() {
                (waits.given, waits.node) = (now, self.copies[at].node.id);
                let transaction = waits.transaction.encoded().clone();
                if waits.transaction.body().function == "stop" {
                    self.notify(at, &waits.transaction)?;
                }
                self.input(at, Input::Submit { lane: waits.lane, transaction })?;
            }
        }
        // Data is not repeated.
        let pause = if waits.lane == Lane::Data { self.random.around(self.plan.think) } else { 100 * MILLISECOND };
        if waits.lane == Lane::Control {
            self.clients[client].waits = Some(waits);
        }
        self.schedule(pause, Happening::Client { client });
        Ok(())
    }

    /// The liars are gone, and everything that is broken is mended.
    pub(super) fn end_lies(&mut self) -> Check {
        self.lying = false;
        (self.is_cut, self.reign) = (false, None);
        self.parts.clear();
        (self.plan.lose_per_mille, self.plan.disk_max) = (0, MILLISECOND);
        // The story that is certified goes on.
        let certified =
            |face: usize| self.copies.iter().filter(|copy| copy.face == face || !copy.lies).map(Copy::certified).max();
        let of_liars =
            |face: usize| self.copies.iter().filter(|copy| copy.lies && copy.face == face).map(Copy::certified).max();
        let story = usize::from((of_liars(1), certified(1)) > (of_liars(0), certified(0)));
        for at in 0..self.copies.len() {
            if self.copies[at].lies && (!self.plan.repents || self.copies[at].face != story) {
                if self.copies[at].up.is_some() {
                    self.stop(at, false);
                }
                self.copies[at].gone = true;
            } else {
                self.schedule(MILLISECOND, Happening::Start { at });
            }
        }
        // One story is left, and everybody hears it.
        for copy in self.copies.iter_mut().filter(|copy| copy.lies && !copy.gone) {
            copy.face = 0;
        }
        self.note(format_args!("the lies are over"));
        Ok(())
    }

    /// Looks whether the rest serves, and does what nodes say that have stopped.
    pub(super) fn is_healed(&mut self) -> Result<bool, Violation> {
        self.rejoin_all()?;
        if self.now < self.plan.ends + REST {
            return Ok(false);
        }
        if !self.judge.is_binding() && self.judge.strict {
            // More organisations lie than certificates bear: nothing is promised but what each node promises for itself.
            return Ok(true);
        }
        let alive = self.running();
        let together = self.largest_together(&alive);
        let voters = self.plan.voters() as usize;
        // One that is proved to lie does not lead any more, and gives no vote to a shorter log than its own.
        let proved: BTreeSet<u64> = alive.iter().flat_map(|at| self.copies[*at].evidence.liars()).collect();
        // The new number of a node votes when a leader has ordered the change.
        let effective: BTreeSet<u64> = alive.iter().flat_map(|at| self.effective_voters(*at)).collect();
        let counts = |at: &&usize| {
            let id = self.copies[**at].node.id;
            effective.contains(&id) && !proved.contains(&id)
        };
        // Nodes that most others contradict have stopped, and no certificate says who is right: people choose (LGR-5008). The rest may
        // have a leader that it has deposed too often to elect it soon.
        let is_forked = self.copies.iter().any(|copy| !copy.gone && copy.ended == Some(Code::Forked));
        let is_stuck = is_forked && self.now > self.plan.ends + FORKED_REST;
        if 2 * together.iter().filter(counts).count() > voters && !is_stuck {
            return self.serves(&together);
        }
        let what = if together.len() == alive.len() && self.copies.iter().all(|copy| copy.ended.is_none()) {
            "the rest is too few to order"
        } else {
            self.is_shown(&alive)?;
            "honest nodes have two histories that nobody certifies"
        };
        self.judge.counts.count(what);
        Ok(true)
    }

    /// The voters that elections ask, as a node knows them.
    fn effective_voters(&self, at: usize) -> BTreeSet<u64> {
        let members = self.copies[at].up.as_ref().and_then(|up| up.ledger.members().ok());
        members.map(|members| members.voters.into_iter().collect()).unwrap_or_default()
    }

    /// All members, as a node knows them.
    fn members(&self, at: usize) -> BTreeSet<u64> {
        let members = self.copies[at].up.as_ref().and_then(|up| up.ledger.members().ok());
        members.map(|members| members.nodes()).unwrap_or_default()
    }

    /// The voters that run, liars that have become honest among them.
    fn running(&self) -> Vec<usize> {
        (0..self.copies.len()).filter(|at| self.copies[*at].up.is_some()).collect()
    }

    /// The honest voters that run.
    fn alive(&self) -> Vec<usize> {
        (0..self.copies.len()).filter(|at| !self.copies[*at].lies && self.copies[*at].up.is_some()).collect()
    }

    /// The largest set of nodes of which no two have different entries of one height and term, nor different blocks.
    fn largest_together(&self, alive: &[usize]) -> Vec<usize> {
        let parted: BTreeSet<(usize, usize)> = alive
            .iter()
            .flat_map(|one| alive.iter().map(|other| (*one, *other)))
            .filter(|(one, other)| one < other && self.are_parted(*one, *other))
            .collect();
        let mut best = Vec::new();
        for set in 0_u32..1 << alive.len() {
            let members: Vec<usize> =
                alive.iter().enumerate().filter(|(place, _)| set >> place & 1 == 1).map(|(_, at)| *at).collect();
            let fits = |one: &usize| members.iter().all(|other| !parted.contains(&(*one, *other)));
            if members.len() > best.len() && members.iter().all(fits) {
                best = members;
            }
        }
        best
    }

    fn are_parted(&self, one: usize, other: usize) -> bool {
        let (Some(one), Some(other)) = (&self.copies[one].up, &self.copies[other].up) else { return false };
        let tips = one.ledger.tip().height.min(other.ledger.tip().height);
        if one.point(tips).map(|point| point.hash) != other.point(tips).map(|point| point.hash) {
            return true;
        }
        let last = one.store.last_index().min(other.store.last_index());
        // An executed entry stays, and a log that ends in a later term is not replaced by one that has it.
        let newest = |up: &Up| up.entry(up.store.last_index()).map_or(0, |entry| entry.0);
        let stays = |up: &Up, than: &Up, height: u64| height <= up.ledger.tip().height && newest(than) >= newest(up);
        let mut differ = false;
        (tips + 1..=last).any(|height| {
            let (Some(a), Some(b)) = (one.entry(height), other.entry(height)) else { return false };
            differ |= a != b;
            // One term has one log up to each of its entries.
            differ && (a.0 == b.0 || stays(one, other, height) || stays(other, one, height))
        })
    }

    /// Where people must decide, a node says so.
    fn is_shown(&self, alive: &[usize]) -> Check {
        let shows = |at: &usize| {
            let up = self.copies[*at].up.as_ref();
            up.is_some_and(|up| !up.contradicting.is_empty() || !up.company.describe().is_empty())
        };
        if alive.iter().any(shows) || self.copies.iter().any(|copy| copy.ended.is_some()) {
            return Ok(());
        }
        Err(Violation::new("where people must decide, a node says so", self.describe()))
    }

    /// Do these nodes, which are most voters, order? And certify, if they are enough? All honest nodes that run must be among them.
    fn serves(&mut self, together: &[usize]) -> Result<bool, Violation> {
        // A call at any of them, again and again. It is admissible in every state: voters complain about a leader for such calls only.
        let at = together[self.random.below(together.len() as u64) as usize];
        let transaction = self.signed(0, "Org1/admin", &Call::Stop { robot: "Turtlebot4" });
        self.input(at, Input::Submit { lane: Lane::Control, transaction: transaction.encoded().clone() })?;
        let tip = |at: &usize| self.copies[*at].up.as_ref().map(|up| up.ledger.tip());
        let Some(first) = tip(&at) else { return Ok(false) };
        let alive = self.alive();
        // The newest block may be on its way.
        let near = |at: &usize| tip(at).is_some_and(|tip| tip.height + 3 >= first.height);
        let since = self.copies[at].up.as_ref().and_then(|up| up.headers.get(&first.height)).map_or(0, |tip| tip.time);
        let is_new = since > EPOCH + self.plan.ends + REST;
        let certifies = together.len() >= self.judge.quorum();
        let certified = |at: &usize| {
            let height = self.copies[*at].certified();
            let time =
                self.copies[*at].up.as_ref().and_then(|up| up.headers.get(&height)).map_or(0, |block| block.time);
            time > EPOCH + self.plan.ends + REST
        };
        let all_there = alive.iter().all(|at| together.contains(at))
            && self.copies.iter().all(|copy| copy.gone || !copy.is_contradicted());
        let healed = is_new && all_there && alive.iter().all(near) && (!certifies || alive.iter().all(certified));
        if healed {
            self.judge.counts.count("the network serves again");
            self.judge.serves = true;
        }
        Ok(healed)
    }

    /// Nodes that a strict certificate contradicts say `ledgerd rejoin`: their people type it when most voters order. So do those of a node
    /// whose log the others contradict for long, as docs/operations.md says (*No history is certified*). So do those of a liar that has
    /// become honest and finds no leader: it lacks what its other copy has acknowledged.
    fn rejoin_all(&mut self) -> Check {
        let is_long = self.now >= self.plan.ends + 2 * REST && self.now.is_multiple_of(SECOND);
        let together = if is_long { self.largest_together(&self.running()) } else { Vec::new() };
        for at in 0..self.copies.len() {
            let copy = &self.copies[at];
            let is_apart = is_long && !copy.lies && !together.contains(&at);
            let is_stuck = is_apart && copy.up.as_ref().is_some_and(|up| !up.contradicting.is_empty());
            let follows_nobody = |up: &Up| up.replica.status().role.leader.is_none();
            let is_lost = is_long && copy.lies && copy.up.as_ref().is_some_and(follows_nobody);
            if !copy.gone && (copy.is_contradicted() || is_stuck || is_lost) {
                self.rejoin(at)?;
            }
        }
        Ok(())
    }

    /// The node signs that it joins anew; it keeps its vote and gets another number. Its own blocks are put aside.
    fn rejoin(&mut self, at: usize) -> Check {
        let name = self.copies[at].name.clone();
        let before = self.copies[at].node.id;
        let tip = |other: &usize| self.copies[*other].up.as_ref().map(|up| up.ledger.tip().height);
        let fits = |other: &usize| *other != at && self.truth_holds(*other);
        let helper = self.alive().into_iter().filter(fits).max_by_key(tip);
        let Some(helper) = helper else { return Ok(()) };
        let Some(up) = &self.copies[helper].up else { return Ok(()) };
        let records = ledger::msp::nodes(&**up.ledger.state()).unwrap();
        let full = |record: &ledger::msp::NodeRecord| format!("{}/{}", record.organisation, record.name);
        let newest = records.iter().filter(|record| full(record) == name).map(|record| record.id).max();
        match newest {
            Some(number) if number > before => {
                self.note(format_args!("n{before} comes back as n{number}"));
                self.judge.comes_back(before, number);
                self.judge.counts.count("a contradicted node is back");
                let seed = self.random.number();
                let evidence = Arc::clone(&self.copies[at].evidence);
                if self.copies[at].up.is_some() {
                    self.stop(at, false);
                }
                self.copies[at].gone = true;
                let back = Copy {
                    node: Node::new(number, seed, Clock::new(0, 0)),
                    name,
                    face: 0,
                    lies: false,
                    gone: false,
                    ended: None,
                    evidence,
                    certificates: BTreeMap::new(),
                    joins: None,
                    up: None,
                };
                self.copies.push(back);
                let at = self.copies.len() - 1;
                self.schedule(MILLISECOND, Happening::Start { at });
                Ok(())
            }
            _ => {
                if !self.now.is_multiple_of(SECOND) {
                    return Ok(());
                }
                // The same one again, so that it gets one number.
                if let Some(joins) = &self.copies[at].joins {
                    let transaction = joins.encoded().clone();
                    return self.input(helper, Input::Submit { lane: Lane::Control, transaction });
                }
                let join = format!(r#"{{"address":"127.0.0.1:{}","replace":true}}"#, 7000 + before);
                let transaction = self.sign_as(0, &name, ("msp", "join_node", vec![join.into()]));
                self.copies[at].joins = Some(transaction.clone());
                self.input(helper, Input::Submit { lane: Lane::Control, transaction: transaction.encoded().clone() })
            }
        }
    }

    /// A node that lacks blocks fetches those that are certified, and starts again (`src/peers/sync.rs`): here at the next moment, and
    /// only when the lies are over.
    pub(super) fn fetch(&mut self, at: usize) -> Check {
        let Some(up) = self.copies[at].up.as_ref().filter(|_| !self.lying && !self.copies[at].lies) else {
            return Ok(());
        };
        let tip = up.ledger.tip();
        let has_more = |other: &&Copy| {
            let point = other.up.as_ref().and_then(|up| up.point(tip.height));
            !other.lies && other.certified() > tip.height && point.is_some_and(|point| point.hash == tip.hash)
        };
        let Some(other) = self.copies.iter().filter(has_more).max_by_key(|other| other.certified()) else {
            return Ok(());
        };
        let (Some(there), Some((height, certificate))) = (&other.up, other.certificates.last_key_value()) else {
            return Ok(());
        };
        let (height, certificate) = (*height, certificate.clone());
        for height in tip.height + 1..=height {
            let Some(entry) = there.store.entry(height).unwrap() else { return Ok(()) };
            up.store.append(&[entry], None).unwrap();
        }
        up.store.flush().unwrap();
        self.note(format_args!("{} fetches blocks up to {height}", self.label(at)));
        self.copies[at].certificates.insert(height, certificate);
        self.stop(at, false);
        self.schedule(MILLISECOND, Happening::Start { at });
        Ok(())
    }

    /// Does this node have every certified block that it is as far as?
    fn truth_holds(&self, at: usize) -> bool {
        let Some(up) = &self.copies[at].up else { return false };
        let tip = up.ledger.tip().height;
        let has = |height: u64, block: &Hash| up.point(height).is_some_and(|point| point.hash == *block);
        self.judge.truth().range(..=tip).all(|(height, block)| has(*height, block))
    }

    /// A node starts: what its own certificates cover is there.
    pub(super) fn look_back_at(&self, at: usize) -> Check {
        let copy = &self.copies[at];
        let Some(up) = copy.up.as_ref().filter(|_| !copy.lies) else { return Ok(()) };
        let tip = up.ledger.tip().height;
        for (height, certificate) in copy.certificates.range(..=tip).filter(|_| self.judge.strict) {
            if up.point(*height).map(|point| point.hash) != Some(certificate.statement.block) {
                let what = format!("n{} has certified block {height}, and has another one", copy.node.id);
                return Err(Violation::new("nothing certified is dropped", what));
            }
        }
        Ok(())
    }

    /// In the end: every chain has what is certified, and every node has what others can prove.
    pub(super) fn look_back(&mut self) -> Check {
        // Proofs are sent again now and then.
        self.run_until(self.now + 6 * SECOND)?;
        let alive = self.alive();
        for at in &alive {
            self.look_back_at(*at)?;
            if self.judge.is_binding() && !self.truth_holds(*at) {
                let what = format!("n{} does not have what is certified", self.copies[*at].node.id);
                return Err(Violation::new("nothing certified is dropped", what));
            }
        }
        let liars = |at: &usize| self.copies[*at].evidence.liars();
        for at in &alive {
            // A number that no leader has made a member yet is sent nothing.
            let id = self.copies[*at].node.id;
            let sends = |other: &&usize| self.members(**other).contains(&id);
            let all: BTreeSet<u64> = alive.iter().filter(sends).flat_map(liars).collect();
            let missing: Vec<_> = all.difference(&liars(at)).copied().collect();
            if !missing.is_empty() {
                let what = format!("n{id} has no proof against {missing:?}");
                return Err(Violation::new("evidence travels", what));
            }
        }
        Ok(())
    }

    /// For people: how the nodes stand.
    pub(super) fn describe(&self) -> String {
        let one = |copy: &Copy| {
            let Some(up) = &copy.up else { return format!("n{} {:?} gone {}", copy.node.id, copy.ended, copy.gone) };
            let (tip, status) = (up.ledger.tip(), up.replica.status());
            format!(
                "n{} height {} {} last {} certified {} {:?}",
                copy.node.id,
                tip.height,
                tip.hash,
                status.last,
                copy.certified(),
                status.role
            )
        };
        self.copies.iter().map(one).collect::<Vec<_>>().join("; ")
    }
}
