//! The wishes of admins about whole sets of policies: to apply one, to bring an older one back, and to have others agree to one.

use super::{Call, Client};
use crate::clock::{EPOCH, SECOND};
use crate::people::People;
use crate::policy::Policy;
use crate::world::{Event, World};
use bytes::Bytes;
use ledger::Outcome;
use ledger::transaction::Transaction;
use ledger_base::rejection::Code;
use ledger_storage::state::StateRead;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use testkit::Random;

/// The admins who wish this, the first one of an organisation with one admin.
pub(super) const ADMINS: [&str; 3] = ["Org1/admin", "Org2/admin", CHIEF];
/// The second admin of the owner of the robots.
const CHIEF: &str = "Org2/chief";
/// The owner of the robots.
const OWNER: &str = "Org2";
/// The rules that an organisation gives itself. Org2 has two admins.
const OWN_RULES: [&str; 5] = ["none", "admins = 1", "admins = 2", "organisations = 2", "admins of Org1 = 1"];
/// The rules of the network, without one twice.
const NETWORK_RULES: [&str; 4] = ["none", "none", "organisations = 2", "admins = 1"];
/// An id that no proposal has.
const NO_ID: &str = "00000000000000000000000000000000";

/// A set of policies that an admin wants.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Draft {
    /// Its policies; none: an older set comes back.
    pub policies: Option<Vec<Policy>>,
    /// The number of the older set.
    pub restores: Option<u64>,
    /// The number of the set that the admin has seen.
    pub base: Option<u64>,
    /// The rule of the organisation from then on.
    pub approvals: Option<&'static str>,
    /// Even if nobody may publish then.
    pub means_it: bool,
}

/// A proposed set, as admins read it on the ledger.
#[derive(Clone, Debug, Deserialize)]
struct Standing {
    id: String,
    organisation: String,
    base: u64,
}

/// The sets in force and the proposals, as admins read them on the ledger.
#[derive(Clone, Debug, Default)]
pub(crate) struct Book {
    /// The number of the newest set of each organisation.
    versions: BTreeMap<String, u64>,
    /// By id.
    proposals: BTreeMap<String, Standing>,
}

/// The answer to whatever changes the policies in force.
#[derive(Deserialize)]
struct Changed {
    organisation: String,
    version: u64,
}

impl Draft {
    /// The argument of `apply` and `propose`.
    pub(super) fn json(&self) -> String {
        let mut draft = json!({});
        let mut set = |key: &str, value: Option<Value>| value.into_iter().for_each(|value| draft[key] = value);
        let text = |policy: &Policy| json!({"id": policy.id(), "text": policy.text()});
        set("policies", self.policies.as_ref().map(|policies| policies.iter().map(text).collect()));
        set("restores", self.restores.map(Into::into));
        set("base", self.base.map(Into::into));
        set("approvals", self.approvals.map(Into::into));
        set("means_it", self.means_it.then_some(true.into()));
        draft.to_string()
    }
}

impl Book {
    /// A block was executed.
    pub(crate) fn follow(&mut self, people: &People, transactions: &[Option<Transaction>], outcome: &Outcome) {
        for (transaction, result) in transactions.iter().zip(&outcome.results) {
            let Some(transaction) = transaction.as_ref().filter(|_| result.code() == Code::Ok) else { continue };
            let body = transaction.body();
            if (&*body.chaincode, &*body.function) != ("abac", "policy") {
                continue;
            }
            if let Ok(Changed { organisation, version }) = serde_json::from_slice(&result.response) {
                self.versions.insert(organisation, version);
            }
            let argument = |at: usize| body.args.get(at).map(|text| String::from_utf8_lossy(text));
            let id = argument(1).unwrap_or_default();
            match argument(0).as_deref() {
                Some("propose") => {
                    let proposed: Standing = serde_json::from_slice(&result.response).unwrap();
                    self.proposals.insert(proposed.id.clone(), proposed);
                }
                Some("enact") => drop(self.proposals.remove(&*id)),
                Some("withdraw") => {
                    // An admin of another organisation takes back no more than the own approval.
                    let by = people.by_fingerprint(&transaction.creator());
                    let by = by.map_or("", |person| &person.identity.organisation);
                    self.proposals.retain(|known, proposed| *known != *id || proposed.organisation != by);
                }
                _ => {}
            }
        }
    }

    fn version(&self, organisation: &str) -> u64 {
        self.versions.get(organisation).copied().unwrap_or(0)
    }

    /// The proposals of an organisation.
    fn of(&self, organisation: &str) -> impl Iterator<Item = String> {
        let own = self.proposals.values().filter(move |proposed| proposed.organisation == organisation);
        own.map(|proposed| proposed.id.clone())
    }

    /// A proposal: mostly one that can still be enacted.
    fn any(&self, random: &mut Random) -> String {
        let current = |proposed: &&Standing| proposed.base == self.version(&proposed.organisation);
        let good: Vec<&Standing> = self.proposals.values().filter(current).collect();
        let all: Vec<&Standing> = self.proposals.values().collect();
        let chosen = if random.percent(85) && !good.is_empty() { good } else { all };
        random.pick(&chosen).map_or_else(|| NO_ID.to_owned(), |proposed| proposed.id.clone())
    }
}

impl World {
    /// The set in force with one policy changed, if somebody wants that: `ledgerctl policy put` and `policy remove` apply it.
    pub(super) fn whole_set(&self, person: usize, call: &Call) -> Option<Call> {
        let (Call::Put(changed) | Call::Remove(changed)) = call else { return None };
        let organisation = &self.people.all[person].identity.organisation;
        let running = self.nodes.values().filter_map(|node| node.up.as_ref());
        let newest = running.max_by_key(|node| node.ledger.tip().height)?;
        let prefix = format!("abac\0policy/{organisation}/");
        let pairs = newest.ledger.state().range(prefix.as_bytes(), None, usize::MAX).unwrap();
        let read = |(key, text): &(Bytes, Bytes)| {
            let id = std::str::from_utf8(&key[prefix.len()..]).unwrap();
            Policy::read(id, std::str::from_utf8(text).unwrap()).unwrap()
        };
        let mut policies: Vec<Policy> = pairs.iter().map(read).collect();
        policies.retain(|policy| policy.id() != changed.id());
        policies.extend(matches!(call, Call::Put(_)).then_some(*changed));
        let version = newest.ledger.state().get(format!("abac\0version/{organisation}").as_bytes()).unwrap();
        let base = version.and_then(|version| version.last_chunk::<8>().copied()).map_or(0, u64::from_be_bytes);
        Some(Call::Apply(Draft { policies: Some(policies), base: Some(base), ..Draft::default() }))
    }

    /// The second admin of the owner is hired, where admins do more than put single policies.
    pub(super) fn employ_a_chief(&mut self) {
        if self.plan.governs {
            let gateway = self.random.governance.between(1, self.plan.voters + self.plan.learners);
            let number = self.clients.len();
            self.clients.push(Client::new(CHIEF, gateway));
            self.schedule(SECOND, Event::Client { client: number, attempt: 0 });
        }
    }

    /// The wish of an admin of this kind, if there is one now.
    pub(super) fn govern(&mut self, number: usize) -> Option<Call> {
        let percent = if self.clients[number].person == CHIEF { 100 } else { 40 };
        if !self.plan.governs || !self.random.governance.percent(percent) {
            return None;
        }
        let organisation = self.clients[number].person.split('/').next().unwrap_or_default().to_owned();
        let (version, now) = (self.book.version(&organisation), (EPOCH + self.now) / 1000);
        let random = &mut self.random.governance;
        Some(match random.below(100) {
            0..=19 => Call::Apply(draft(random, &organisation, version, now)),
            20..=41 => Call::Propose(draft(random, &organisation, version, now)),
            42..=61 => Call::Approve { id: self.book.any(random) },
            62..=76 => Call::Enact { id: self.book.any(random), breaks: random.percent(15) },
            77..=80 => Call::Withdraw { id: self.book.any(random) },
            81..=84 => Call::ProposeRule { quorum: random.pick(&NETWORK_RULES).copied().unwrap_or("none") },
            _ => return Some(self.publish(&organisation)),
        })
    }

    /// In the end an admin of the owner wants one policy that permits everybody who is trusted, and no rule of its own.
    pub(crate) fn last_proposal(&self) -> Vec<Call> {
        let policies = Some(vec![Policy::Trusted]);
        let draft = Draft { policies, approvals: Some("none"), means_it: true, ..Draft::default() };
        let withdrawn = self.book.of(OWNER).map(|id| Call::Withdraw { id });
        withdrawn.chain([Call::Propose(draft)]).collect()
    }

    /// The others agree to the proposals that stand, and they come in force.
    pub(crate) fn last_approvals(&self) -> Vec<(&'static str, Vec<Call>)> {
        let approve = || self.book.of(OWNER).map(|id| Call::Approve { id }).collect();
        let enact = self.book.of(OWNER).map(|id| Call::Enact { id, breaks: false }).collect();
        vec![(CHIEF, approve()), ("Org1/admin", approve()), ("Org2/admin", enact)]
    }
}

/// A set that some admin wants now.
fn draft(random: &mut Random, organisation: &str, version: u64, now: u64) -> Draft {
    let back = match random.below(10) {
        0 => 0,
        1..=7 => 1 + random.below(4),
        _ => random.below(40),
    };
    let base = match random.below(10) {
        0..=1 => None,
        2..=3 => Some(version.saturating_sub(1 + random.below(2))),
        _ => Some(version),
    };
    let restores = random.percent(25).then(|| version.saturating_sub(back));
    let policies = restores.is_none().then(|| policies(random, now));
    let rule = random.pick(&OWN_RULES).copied().filter(|_| organisation == OWNER && random.percent(40));
    Draft { policies, restores, base, approvals: rule, means_it: random.percent(20) }
}

/// Mostly somebody may do something.
fn policies(random: &mut Random, now: u64) -> Vec<Policy> {
    let until = now + random.between(1_000, 20_000);
    let offered = [
        (Policy::Attribute, 45),
        (Policy::Trusted, 45),
        (Policy::Until(until), 20),
        (Policy::ForbidFarhad, 15),
        (Policy::ErringForbid, 3),
        (Policy::Viewers, 15),
        (Policy::Blind, 15),
    ];
    offered.into_iter().filter(|(_, percent)| random.percent(*percent)).map(|(policy, _)| policy).collect()
}
