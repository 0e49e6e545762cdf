//! A node that lies to the robot: it makes up, replays, withholds, delays, reorders and misdates what it delivers, and it makes
//! up answers and proofs.

use crate::client::sign;
use crate::clock::{EPOCH, MILLISECOND, SECOND};
use crate::robot::{Delivery, Robot, Told};
use crate::world::World;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_light::Proof;
use std::fmt;

/// A kind of lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Untruth {
    /// A grant and a message under it, signed by somebody who has no such grant.
    Grant,
    /// A message of an earlier block.
    Replay,
    /// A message that the ledger has refused.
    Denied,
    /// Ends, revocations and new descriptions are left out.
    Withhold,
    /// A height far ahead.
    Height,
    /// A block time that is ahead or behind.
    Time,
    /// An end that never was.
    End,
    /// A revocation that never was.
    Revocation,
    /// Events come in another order.
    Reorder,
    /// A delivery comes later.
    HoldBack,
    /// A message is changed.
    Tamper,
    /// Nothing comes for a while.
    Silence,
    /// A question is not passed on.
    Ignore,
    /// The answer to an earlier question, with its proof.
    OldAnswer,
    /// Another answer to this one.
    MadeUpAnswer,
    /// A statement that nobody but the liar has signed.
    MadeUpProof,
}

impl Untruth {
    /// Every kind.
    pub const ALL: [Self; 16] = [
        Self::Grant,
        Self::Replay,
        Self::Denied,
        Self::Withhold,
        Self::Height,
        Self::Time,
        Self::End,
        Self::Revocation,
        Self::Reorder,
        Self::HoldBack,
        Self::Tamper,
        Self::Silence,
        Self::Ignore,
        Self::OldAnswer,
        Self::MadeUpAnswer,
        Self::MadeUpProof,
    ];
    /// Those about a delivery.
    const ABOUT_EVENTS: [Self; 12] = [
        Self::Grant,
        Self::Replay,
        Self::Denied,
        Self::Withhold,
        Self::Height,
        Self::Time,
        Self::End,
        Self::Revocation,
        Self::Reorder,
        Self::HoldBack,
        Self::Tamper,
        Self::Silence,
    ];
}

impl fmt::Display for Untruth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "lie to a robot: {self:?}")
    }
}

impl World {
    pub(super) fn untruth(&mut self, kind: Untruth) {
        *self.coverage.untruths.entry(kind).or_default() += 1;
        self.note(format_args!("robot: its node lies: {kind:?}"));
    }

    /// Lies about what is to be delivered, now and then.
    pub(super) fn distort(&mut self, robot: &mut Robot, batch: &mut Vec<Delivery>) {
        if !robot.held_back.is_empty() && self.random.robot.percent(10) {
            batch.append(&mut robot.held_back);
        }
        // Seldom if there is nothing to lie about.
        let chance = if batch.iter().any(|delivery| !delivery.events.is_empty()) { 50 } else { 5 };
        if !self.random.robot.percent(chance) {
            return;
        }
        let Some(kind) = self.random.robot.pick(&Untruth::ABOUT_EVENTS).copied() else { return };
        let Some(newest) = self.blocks.last().map(|block| block.outcome.header.clone()) else { return };
        let Some(service) = self.random.robot.pick(&robot.watched).map(|watched| watched.id) else { return };
        let own = |events: Vec<Told>| Delivery {
            height: newest.height,
            time: newest.time,
            events,
            early: false,
            heads: Vec::new(),
        };
        match kind {
            Untruth::Grant => {
                batch.push(own(self.made_up_grant(service, newest.time)));
            }
            Untruth::Replay | Untruth::Denied => {
                let Some(old) = self.earlier(robot, kind == Untruth::Denied) else { return };
                batch.push(own(vec![old]));
            }
            Untruth::Withhold => {
                let ends = |event: &Told| matches!(&*event.name, "released" | "revoked" | "revocation_list" | "robot");
                if !batch.iter().flat_map(|delivery| &delivery.events).any(ends) {
                    return;
                }
                batch.iter_mut().for_each(|delivery| delivery.events.retain(|event| !ends(event)));
            }
            Untruth::Height => {
                let height = u64::MAX >> self.random.robot.below(3);
                batch.push(Delivery { height, time: newest.time, events: Vec::new(), early: false, heads: Vec::new() });
            }
            Untruth::Time => {
                let by = [4 * SECOND, 3600 * SECOND, u64::MAX >> 1];
                let by = self.random.robot.pick(&by).copied().unwrap_or(SECOND);
                let back = self.random.robot.percent(50);
                batch.push(own(Vec::new()));
                for delivery in batch.iter_mut() {
                    let time = delivery.time;
                    delivery.time = if back { time.saturating_sub(by) } else { time.saturating_add(by) };
                }
            }
            Untruth::End => {
                let Some((holder, epoch)) = self.holder(service) else { return };
                let epoch = if self.random.robot.percent(80) { epoch } else { epoch + self.random.robot.below(3) };
                let end =
                    format!(r#"{{"service":"{service}","holder":"{holder}","epoch":{epoch},"reason":"released"}}"#);
                batch.push(own(vec![told("released", service, &end, Bytes::new())]));
            }
            Untruth::Revocation => {
                let Some(person) = self.random.robot.pick(self.people.persons()) else { return };
                let (issuer, serial) = (hex::encode(person.identity.issuer), hex::encode(&person.identity.serial));
                let revoked = format!(r#"{{"issuer":"{issuer}","serial":"{serial}"}}"#);
                let event = Told { chaincode: "msp".into(), ..told("revoked", "", &revoked, Bytes::new()) };
                batch.push(own(vec![event]));
            }
            Untruth::Reorder => {
                match batch.iter().map(|delivery| delivery.events.len()).sum() {
                    0 => return,
                    // What comes later comes first.
                    1 => robot.held_back.append(batch),
                    _ => {
                        batch.reverse();
                        batch.iter_mut().for_each(|delivery| delivery.events.reverse());
                    }
                }
            }
            Untruth::HoldBack => {
                if batch.is_empty() {
                    return;
                }
                robot.held_back.append(batch);
            }
            Untruth::Tamper => {
                let message = |event: &&mut Told| event.name == "message" && event.transaction.len() > 8;
                let Some(event) = batch.iter_mut().flat_map(|delivery| &mut delivery.events).find(message) else {
                    return;
                };
                let mut bytes = event.transaction.to_vec();
                let at = self.random.robot.below(bytes.len() as u64) as usize;
                bytes[at] ^= 1 << self.random.robot.below(8);
                event.transaction = bytes.into();
            }
            _ => {
                let until = self.now + self.random.robot.between(100, 2_000) * MILLISECOND;
                if let Some(stream) = &mut robot.stream {
                    stream.silent_until = until;
                }
            }
        }
        self.untruth(kind);
    }

    /// A grant that never was, and a message under it.
    fn made_up_grant(&mut self, service: &str, time: u64) -> Vec<Told> {
        let (holder, newest) = self.holder(service).unwrap_or_default();
        let random = &mut self.random.robot;
        let epoch = match random.below(5) {
            0 => 0,
            1 => newest + 1,
            2 => u64::MAX,
            3 => newest.saturating_sub(1),
            _ => newest,
        };
        let (number, nonce, at) = (random.between(1, 1 << 40), random.number(), random.below(100));
        // Often its holder, under another grant.
        let holder = self.people.index(&holder, 0).filter(|_| at < 40);
        let person = &self.people.all[holder.unwrap_or(at as usize % self.people.persons().len())];
        let not_after = EPOCH + self.now + 2 * SECOND;
        let payload = [&[0, 1, 0, 0][..], &nonce.to_be_bytes()].concat();
        let args = [service.to_owned(), epoch.to_string(), number.to_string()].map(Bytes::from);
        let args = args.into_iter().chain([Bytes::from(payload)]).collect();
        let transaction = sign(person, self.network, nonce, not_after, ("abac", "set", args), true);
        let (certificate, holder) = (person.certificate.clone(), person.id());
        let grant = serde_json::json!({
            "service": service, "holder": holder, "epoch": epoch, "expires": time + 5 * SECOND, "mode": "exclusive",
            "acquired_at": time, "lease_ms": 5000, "next_seq": 0,
        });
        let message = Told { certificate, ..told("message", service, "{}", transaction.encoded().clone()) };
        vec![told("granted", service, &grant.to_string(), Bytes::new()), message]
    }

    /// A call of `set` in an earlier block that concerns the robot: one that was executed, or one that was refused.
    fn earlier(&mut self, robot: &Robot, denied: bool) -> Option<Told> {
        let blocks = self.blocks.len() as u64;
        let from = blocks.saturating_sub(1 + self.random.robot.below(200));
        let blocks = self.blocks.iter().skip(from as usize);
        let mut calls = blocks.flat_map(|block| block.outcome.transactions.iter().zip(&block.outcome.results));
        calls.find_map(|(bytes, result)| {
            let transaction = Transaction::decode(bytes.clone()).ok()?;
            let body = transaction.body();
            let service =
                robot.watched.iter().find(|watched| body.args.first().is_some_and(|arg| arg == watched.id))?;
            let wanted = body.function == "set" && denied != (result.code() == ledger_base::rejection::Code::Ok);
            let person = self.people.by_fingerprint(&transaction.creator()).filter(|_| wanted)?;
            let certificate = person.certificate.clone();
            Some(Told { certificate, ..told("message", service.id, "{}", bytes.clone()) })
        })
    }

    fn holder(&self, service: &str) -> Option<(String, u64)> {
        self.invariants.grant_exclusivity.holders(service)?.iter().next().cloned()
    }

    /// The answer that a node gives: what the function has answered, or something else.
    pub(super) fn made_up_answer(&mut self, robot: &Robot, response: &Bytes) -> Bytes {
        if !self.deceives(robot) {
            return response.clone();
        }
        if let Some((old, _)) = robot.old.first().filter(|_| self.random.robot.percent(50)) {
            let old = old.clone();
            self.untruth(Untruth::OldAnswer);
            return old;
        }
        self.untruth(Untruth::MadeUpAnswer);
        let text = String::from_utf8_lossy(response).replace("Org1/Salma", "Org1/Farhad");
        Bytes::from(text.replace("\"epoch\":", "\"epoch\":1"))
    }

    /// The proof that a node gives: the true one, that of an earlier answer, or one that only it has signed.
    pub(super) fn made_up_proof(&mut self, robot: &mut Robot, node: u64, proof: Proof) -> Proof {
        if robot.liar != Some(node) {
            return proof;
        }
        let response = robot.question.as_ref().and_then(|question| question.response.clone()).unwrap_or_default();
        let old = self.random.robot.pick(&robot.old).map(|(_, proof)| proof.clone());
        if robot.old.len() < 8 {
            robot.old.push((response, proof.clone()));
        }
        if !self.deceives(robot) {
            return proof;
        }
        if let Some(old) = old.filter(|_| self.random.robot.percent(50)) {
            self.untruth(Untruth::OldAnswer);
            return old;
        }
        self.untruth(Untruth::MadeUpProof);
        let mut forged = proof;
        let statement = forged.certificate.statement;
        let own = self.people.node(node, self.plan.organisations);
        let signed = statement.sign(node, own.certificate.clone(), &own.key).unwrap();
        // Under the names of all who had signed.
        for signature in &mut forged.certificate.signatures {
            let node = signature.node;
            *signature = signed.signature.clone();
            signature.node = node;
        }
        forged
    }

    /// Does the node of this question lie about its answer?
    fn deceives(&mut self, robot: &Robot) -> bool {
        let asked = robot.question.as_ref().map(|question| question.node);
        self.chaos && robot.liar.is_some() && asked == robot.liar && self.random.robot.percent(10)
    }
}

fn told(name: &str, subject: &str, payload: &str, transaction: Bytes) -> Told {
    Told {
        index: 1 << 20,
        chaincode: "abac".to_owned(),
        name: name.to_owned(),
        subject: subject.to_owned(),
        payload: Bytes::copy_from_slice(payload.as_bytes()),
        transaction,
        certificate: Bytes::new(),
    }
}
