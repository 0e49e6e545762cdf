//! Proposals in random interleavings: approvals, withdrawals, revocations, organisations that leave and come back, other
//! quorums, time. A small model, written apart from the implementation, judges them: a call is executed exactly when it says.

use crate::world::{DAY, Network, START, User};
use bytes::Bytes;
use ledger::msp::{Decision, JoinOrganisation};
use ledger::network::FoundingOrganisation;
use ledger_base::rejection::Rejection;
use ledger_identity::key::{KeyKind, SigningKey};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};

const SEEDS: u64 = 12;
const STEPS: usize = 120;
const WEEK: u64 = 7 * DAY;
const ADMINS: [&str; 3] = ["Admin", "Boss", "Chief"];
const RULES: [Option<&str>; 9] = [
    None,
    Some("organisations = majority"),
    Some("organisations = all"),
    Some("organisations = 1"),
    Some("organisations = 3"),
    Some("admins = 1"),
    Some("admins = 3"),
    Some("admins of Org2 = 2"),
    Some("admins of Org3 = 1"),
];

/// A proposal's content.
#[derive(Clone, Debug, PartialEq)]
enum Wish {
    /// `listener FUNCTION TEXT`.
    Call(&'static str, &'static str),
    /// Another rule for a function of `listener`.
    Rule(&'static str, Option<&'static str>),
    /// An organisation shall leave.
    Remove(usize),
}

struct Proposal {
    id: String,
    wish: Wish,
    by: usize,
    until: u64,
    /// Organisation and admin, with the number of their certificate.
    agreed: BTreeMap<(usize, &'static str), usize>,
    failed: bool,
}

/// The state that should be.
#[derive(Default)]
struct Model {
    members: BTreeSet<usize>,
    rules: BTreeMap<&'static str, &'static str>,
    revoked: BTreeSet<(usize, &'static str, usize)>,
    proposals: Vec<Proposal>,
    armed: bool,
    done: String,
}

impl Model {
    /// How many are missing.
    fn missing(&self, proposal: &Proposal) -> usize {
        let function = match proposal.wish {
            Wish::Call(function, _) | Wish::Rule(function, _) => function,
            Wish::Remove(_) => "",
        };
        let table = if function == "agree-as-one" { "admins = 2" } else { "organisations = majority" };
        let rule = self.rules.get(function).copied().unwrap_or(table);
        let count = |organisation: usize| proposal.agreed.keys().filter(|(of, _)| *of == organisation).count();
        let organisations = self.members.iter().filter(|organisation| count(**organisation) > 0).count();
        let all = self.members.len();
        let (wanted, found) = match rule {
            "organisations = majority" => (all / 2 + 1, organisations),
            "organisations = all" => (all, organisations),
            "organisations = 1" => (1, organisations),
            "organisations = 3" => (all.min(3), organisations),
            "admins = 1" => (1, count(proposal.by)),
            "admins = 2" => (2, count(proposal.by)),
            "admins = 3" => (3, count(proposal.by)),
            "admins of Org2 = 2" => (2, count(2)),
            _ => (1, count(3)),
        };
        wanted.saturating_sub(found)
    }

    /// Could it be done?
    fn is_possible(&self, wish: &Wish) -> bool {
        match wish {
            Wish::Call(_, text) => !(self.armed && *text == "refuse"),
            Wish::Rule(_, Some("admins of Org2 = 2")) => self.members.contains(&2),
            Wish::Rule(_, Some("admins of Org3 = 1")) => self.members.contains(&3),
            Wish::Rule(..) => true,
            // Org1 has the only voter.
            Wish::Remove(organisation) => *organisation != 1 && self.members.contains(organisation),
        }
    }

    /// Does the oldest that enough agree to.
    fn settle(&mut self) -> bool {
        let due = |proposal: &Proposal| !proposal.failed && self.missing(proposal) == 0;
        let Some(at) = self.proposals.iter().position(due) else { return false };
        if !self.is_possible(&self.proposals[at].wish) {
            self.proposals[at].failed = true;
            return true;
        }
        let proposal = self.proposals.remove(at);
        match proposal.wish {
            Wish::Call(_, text) => {
                let mut names: BTreeMap<usize, BTreeSet<&str>> = BTreeMap::new();
                for (organisation, admin) in proposal.agreed.keys() {
                    names.entry(*organisation).or_default().insert(admin);
                }
                let names: Vec<_> =
                    names.iter().map(|(organisation, names)| format!("Org{organisation} {names:?}")).collect();
                self.done += &format!("b{text:?} by {} for Org{}\n", names.join(", "), proposal.by);
            }
            Wish::Rule(function, Some(rule)) => drop(self.rules.insert(function, rule)),
            Wish::Rule(function, None) => drop(self.rules.remove(function)),
            Wish::Remove(organisation) => {
                self.members.remove(&organisation);
                self.rules.retain(|_, rule| !rule.contains(&format!("of Org{organisation} ")));
                for proposal in &mut self.proposals {
                    proposal.agreed.retain(|(of, _), _| *of != organisation);
                }
            }
        }
        true
    }

    fn settle_all(&mut self) {
        while self.settle() {}
    }

    fn forget(&mut self, now: u64) {
        self.proposals.retain(|proposal| proposal.until >= now);
    }
}

/// Numbers that follow from a seed.
struct Random(u64);

impl Random {
    fn below(&mut self, max: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % max
    }

    fn pick<T: Clone>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())].clone()
    }
}

/// The network, its people, and what the model says of them.
struct Run {
    network: Network,
    model: Model,
    random: Random,
    /// Every certificate of every admin.
    people: BTreeMap<(usize, &'static str), Vec<User>>,
}

fn name(organisation: usize) -> String {
    format!("Org{organisation}")
}

fn argument(wish: &Wish) -> (&'static str, String) {
    match wish {
        Wish::Call(function, text) => {
            ("propose", json!({"chaincode": "listener", "function": function, "args": [hex::encode(text)]}).to_string())
        }
        Wish::Rule(function, None) => {
            ("set_quorum", json!({"chaincode": "listener", "function": function}).to_string())
        }
        Wish::Rule(function, Some(rule)) => {
            ("set_quorum", json!({"chaincode": "listener", "function": function, "quorum": rule}).to_string())
        }
        Wish::Remove(organisation) => ("remove_organisation", json!({"name": name(*organisation)}).to_string()),
    }
}

impl Run {
    fn new(seed: u64) -> Self {
        let network = Network::new(4, 1);
        let mut people = BTreeMap::new();
        for organisation in 1..=4 {
            for admin in ADMINS {
                people.insert(
                    (organisation, admin),
                    vec![network.cas[organisation - 1].user(admin, "admin", KeyKind::Ed25519)],
                );
            }
        }
        let model = Model { members: (1..=4).collect(), ..Model::default() };
        Self { network, model, random: Random(seed), people }
    }

    /// An admin: with their newest certificate, or now and then with an older one.
    fn somebody(&mut self) -> (usize, &'static str, usize) {
        let (organisation, admin) = (1 + self.random.below(4), self.random.pick(&ADMINS));
        let certificates = self.people[&(organisation, admin)].len();
        let certificate = if self.random.below(4) == 0 { self.random.below(certificates) } else { certificates - 1 };
        (organisation, admin, certificate)
    }

    fn counts(&self, (organisation, admin, certificate): (usize, &'static str, usize)) -> bool {
        self.model.members.contains(&organisation) && !self.model.revoked.contains(&(organisation, admin, certificate))
    }

    fn call(
        &mut self,
        (organisation, admin, certificate): (usize, &'static str, usize),
        function: &str,
        args: &[&str],
    ) -> Result<Bytes, Rejection> {
        let user = &self.people[&(organisation, admin)][certificate];
        let answer = self.network.call(user, function, args);
        self.model.forget(self.network.time);
        answer
    }

    fn agree(&mut self, at: usize, (organisation, admin, certificate): (usize, &'static str, usize)) -> bool {
        self.model.proposals[at].agreed.insert((organisation, admin), certificate);
        let before = self.model.proposals.len();
        if self.model.missing(&self.model.proposals[at]) > 0 {
            return false;
        }
        let wish = self.model.proposals[at].wish.clone();
        if self.model.is_possible(&wish) {
            // This one first, whatever else is due.
            let this = self.model.proposals.remove(at);
            self.model.proposals.insert(0, this);
            self.model.settle_all();
            self.model.proposals.sort_by_key(|proposal| proposal.until);
        } else {
            self.model.proposals[at].failed = true;
        }
        self.model.proposals.len() < before
    }

    fn propose(&mut self) {
        let by = self.somebody();
        let function = self.random.pick(&["agree", "agree-as-one"]);
        let wish = match self.random.below(10) {
            0 | 1 => Wish::Rule(function, self.random.pick(&RULES)),
            2 => Wish::Remove(1 + self.random.below(4)),
            _ => Wish::Call(function, self.random.pick(&["yes", "no", "refuse"])),
        };
        let (function, argument) = argument(&wish);
        let answer = self.call(by, function, &[&argument]);
        let same = |proposal: &Proposal| !proposal.failed && proposal.wish == wish;
        let known = self.model.proposals.iter().position(same);
        let own = self.model.proposals.iter().filter(|proposal| proposal.by == by.0).count();
        // The functions of msp look first, also when the same proposal stands.
        let looks = known.is_none() || !matches!(wish, Wish::Call(..));
        let refused = (looks && !self.model.is_possible(&wish)) || (known.is_none() && own >= 16);
        if !self.counts(by) || refused {
            assert!(answer.is_err(), "{by:?} may not propose {wish:?}: {answer:?}");
            return;
        }
        let decision: Decision = serde_json::from_slice(&answer.unwrap()).unwrap();
        let id = decision.proposal.unwrap().id.to_string();
        let at = known.unwrap_or_else(|| {
            let until = self.network.time + WEEK;
            let agreed = BTreeMap::new();
            self.model.proposals.push(Proposal { id: id.clone(), wish, by: by.0, until, agreed, failed: false });
            self.model.proposals.len() - 1
        });
        assert_eq!(self.model.proposals[at].id, id);
        assert_eq!(self.agree(at, by), decision.executed);
    }

    fn approve(&mut self) {
        let by = self.somebody();
        let ids: Vec<_> = self.model.proposals.iter().map(|proposal| proposal.id.clone()).collect();
        let id = if ids.is_empty() { "0".repeat(64) } else { self.random.pick(&ids) };
        let answer = self.call(by, "approve", &[&id]);
        let stands = |proposal: &Proposal| !proposal.failed && proposal.id == id;
        match self.model.proposals.iter().position(stands).filter(|_| self.counts(by)) {
            None => assert!(answer.is_err(), "{answer:?}"),
            Some(at) => {
                let decision: Decision = serde_json::from_slice(&answer.unwrap()).unwrap();
                assert_eq!(self.agree(at, by), decision.executed);
            }
        }
    }

    fn withdraw(&mut self) {
        let by = self.somebody();
        let ids: Vec<_> = self.model.proposals.iter().map(|proposal| proposal.id.clone()).collect();
        let id = if ids.is_empty() { "0".repeat(64) } else { self.random.pick(&ids) };
        let answer = self.call(by, "withdraw", &[&id]);
        let at = self.model.proposals.iter().position(|proposal| proposal.id == id).filter(|_| self.counts(by));
        let has_agreed = |at: &usize| self.model.proposals[*at].agreed.keys().any(|(of, _)| *of == by.0);
        match at {
            Some(at) if self.model.proposals[at].by == by.0 => drop((answer.unwrap(), self.model.proposals.remove(at))),
            Some(at) if has_agreed(&at) => {
                answer.unwrap();
                self.model.proposals[at].agreed.retain(|(of, _), _| *of != by.0);
            }
            _ => assert!(answer.is_err(), "{answer:?}"),
        }
    }

    /// An admin's certificate is revoked; they have another one from then on.
    fn revoke(&mut self) {
        let (organisation, admin) = (1 + self.random.below(4), self.random.pick(&["Boss", "Chief"]));
        let certificate = self.people[&(organisation, admin)].len() - 1;
        if !self.model.members.contains(&organisation) {
            return;
        }
        let user = &self.people[&(organisation, admin)][certificate];
        let identity = self.network.ledger.msps().verify(&user.certificate, &[], self.network.time).unwrap();
        let (issuer, serial) = (hex::encode(identity.issuer), hex::encode(&identity.serial));
        self.call((organisation, "Admin", 0), "revoke", &[&issuer, &serial]).unwrap();
        self.model.revoked.insert((organisation, admin, certificate));
        for proposal in &mut self.model.proposals {
            proposal.agreed.retain(|(of, name), with| (*of, *name, *with) != (organisation, admin, certificate));
        }
        let renewed = self.network.cas[organisation - 1].user(admin, "admin", KeyKind::Ed25519);
        self.people.get_mut(&(organisation, admin)).unwrap().push(renewed);
    }

    /// An organisation that left is invited again, and comes.
    fn comes_back(&mut self) {
        let Some(organisation) = (1..=4).find(|organisation| !self.model.members.contains(organisation)) else {
            return;
        };
        let key = SigningKey::from_seed(&[7; 32]).unwrap();
        let public = hex::encode(key.public_key().bytes());
        let invite = json!({"name": name(organisation), "key": public, "expires": self.network.time + DAY}).to_string();
        for other in self.model.members.clone() {
            let Ok(answer) = self.call((other, "Admin", 0), "invite_organisation", &[&invite]) else { return };
            let decision: Decision = serde_json::from_slice(&answer).unwrap();
            if decision.executed {
                break;
            }
        }
        let founding = FoundingOrganisation::below(&name(organisation), self.network.cas[organisation - 1].root());
        let network = self.network.ledger.network();
        let join = JoinOrganisation::sign(&network, founding, "back", "back:7450", &key);
        self.network.node(1, "join_organisation", &[&serde_json::to_string(&join).unwrap()]).unwrap();
        self.model.members.insert(organisation);
        self.model.forget(self.network.time);
    }

    fn step(&mut self) {
        match self.random.below(20) {
            0 => self.network.time += self.random.below(3) as u64 * DAY,
            1 => self.revoke(),
            2 => self.comes_back(),
            3 | 4 => self.withdraw(),
            5..=10 => self.propose(),
            11 => {
                let user = &self.people[&(1, "Admin")][0];
                let arm = self.network.sign_for("listener", user, if self.model.armed { "disarm" } else { "arm" }, &[]);
                self.network.block(&[&arm]).remove(0).unwrap();
                self.model.armed = !self.model.armed;
            }
            _ => self.approve(),
        }
        self.model.forget(self.network.time);
        self.compare();
    }

    fn compare(&self) {
        assert_eq!(self.network.agreed(), self.model.done);
        let standing: Vec<Decision> = self.network.query("proposals", &[]);
        let standing = standing.into_iter().map(|decision| {
            let proposal = decision.proposal.unwrap();
            let agreed: BTreeSet<_> = proposal
                .approved_by
                .iter()
                .map(|approval| format!("{}/{}", approval.organisation, approval.admin))
                .collect();
            (proposal.id.to_string(), proposal.failed.is_some(), decision.missing, agreed)
        });
        let standing: Vec<_> = standing.collect();
        let wanted = self.model.proposals.iter().map(|proposal| {
            let missing = if proposal.failed { 0 } else { self.model.missing(proposal) };
            let agreed =
                proposal.agreed.keys().map(|(organisation, admin)| format!("Org{organisation}/{admin}")).collect();
            (proposal.id.clone(), proposal.failed, missing, agreed)
        });
        assert_eq!(standing, wanted.collect::<Vec<_>>());
    }
}

#[test]
fn a_call_is_executed_exactly_when_a_small_model_says() {
    let (mut done, mut failed, mut left) = (0, 0, 0);
    for seed in 0..SEEDS {
        let mut run = Run::new(seed);
        assert_eq!(run.network.time, START);
        for _ in 0..STEPS {
            run.step();
            failed += usize::from(run.network.event_names().contains(&"failed"));
            left += usize::from(run.network.event_names().contains(&"organisation_removed"));
        }
        done += run.model.done.lines().count();
    }
    let covered = (done > 50, failed > 3, left > 8);
    assert_eq!(covered, (true, true, true), "{done} calls, {failed} failures, {left} organisations that left");
}
