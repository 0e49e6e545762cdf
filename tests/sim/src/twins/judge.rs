//! The promises, judged by an arithmetic of its own over everything that anybody has signed.
//!
//! Source: docs/security.md and docs/format.md, Certified blocks. One organisation with all its nodes lies. Where certificates are
//! strict, this must not matter: one truth for each height, evidence against liars only, nothing certified is left.

use super::plan::Plan;
use crate::invariant::{Check, Violation};
use bytes::Bytes;
use ledger::block::Payload;
use ledger_base::hash::Hash;
use ledger_light::{Certificate, Misbehaviour, Statement};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// The deeds of some seeds.
#[derive(Clone, Debug, Default)]
pub struct Counts {
    /// Seeds.
    pub seeds: u64,
    /// Seeds in which certificates were strict.
    pub strict: u64,
    /// Virtual time, microseconds.
    pub time: u64,
    /// The events, by name.
    pub happened: BTreeMap<&'static str, u64>,
}

/// Seeds in which every wanted event happens.
const SEEDS_ENOUGH: u64 = 200;
/// Everything that must happen in enough seeds.
const WANTED: [&str; 25] = [
    "a liar votes twice",
    "a liar leads with two logs",
    "a liar signs two blocks of one height",
    "a lie is proved",
    "a double vote is proved",
    "a double head is proved",
    "a strict certificate is made while the liars lie",
    "two strict certificates where two organisations lie",
    "a node is contradicted",
    "a contradicted node is back",
    "honest nodes have two histories that nobody certifies",
    "the network serves again",
    "the rest is too few to order",
    "an honest node crashes",
    "a voter complains about a withholding leader",
    "something forged is sent",
    "a control call is withheld",
    "a liar would end strict certificates",
    "a command passes a gate",
    "a command passes a gate at a lying node",
    "a command does not pass a gate",
    "a gate stops its robot",
    "a gate is notified of a stop before it is ordered",
    "a voter is removed by the proof of its lie",
    "the power of a voter fails after its vote",
];

impl Counts {
    /// Something happened.
    pub fn count(&mut self, what: &'static str) {
        *self.happened.entry(what).or_default() += 1;
    }

    /// Adds those of other seeds.
    pub fn add(&mut self, other: &Self) {
        self.seeds += other.seeds;
        self.strict += other.strict;
        self.time += other.time;
        for (what, count) in &other.happened {
            *self.happened.entry(what).or_default() += count;
        }
    }

    /// Were there enough seeds for every wanted event?
    pub fn is_enough(&self) -> bool {
        self.seeds >= SEEDS_ENOUGH
    }

    /// The wanted events that never happened.
    pub fn missing(&self) -> Vec<&'static str> {
        WANTED.into_iter().filter(|what| !self.happened.contains_key(what)).collect()
    }
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} seeds with liars, {} strict, {} virtual minutes",
            self.seeds,
            self.strict,
            self.time / 60_000_000
        )?;
        self.happened.iter().try_for_each(|(what, count)| writeln!(f, "  {count:>8}  {what}"))
    }
}

/// See the module.
pub(super) struct Judge {
    /// Signatures that a certificate needs, and whether that is more than any organisation can complete twice.
    quorum: usize,
    pub(super) strict: bool,
    /// The network serves after the lies.
    pub(super) serves: bool,
    /// Certificates are not judged any more.
    is_retired: bool,
    /// More than one organisation lies.
    beyond: bool,
    /// The founding number of each number, so that one that comes back counts as what it was.
    places: BTreeMap<u64, u64>,
    organisations: BTreeMap<u64, usize>,
    liars: BTreeSet<u64>,
    /// The signers of each block and its results, by height.
    signed: BTreeMap<u64, BTreeMap<(Hash, Hash), BTreeSet<u64>>>,
    /// The block that an honest node of this number has signed at this height.
    honest: BTreeMap<(u64, u64), (Hash, Hash)>,
    /// The certified block of each height.
    truth: BTreeMap<u64, Hash>,
    /// The chain that an entry became part of, by height, term and content.
    chains: BTreeMap<(u64, u64, Hash), Hash>,
    /// The candidates that a voter has voted for in a term.
    votes: BTreeMap<(u64, u64), BTreeSet<u64>>,
    /// The logs that a leader has signed in a term, by its copies.
    reigns: BTreeMap<(u64, u64), BTreeSet<usize>>,
    pub(super) counts: Counts,
}

impl Judge {
    /// Of a network of this plan.
    pub(super) fn new(plan: &Plan) -> Self {
        let voters = plan.voters() as usize;
        let largest = plan.shape.iter().copied().max().unwrap_or_default();
        // More than (N + m) / 2, and one voter can be missing.
        let wanted = (voters + largest) / 2 + 1;
        let strict = wanted < voters;
        let organisations: BTreeMap<u64, usize> =
            (1..=plan.voters()).map(|node| (node, plan.organisation_of(node))).collect();
        let liars = organisations.iter().filter(|(_, of)| plan.lies(**of)).map(|(node, _)| *node).collect();
        Self {
            quorum: if strict { wanted } else { voters / 2 + 1 },
            strict,
            serves: false,
            is_retired: false,
            beyond: plan.liars.len() > 1,
            places: organisations.keys().map(|node| (*node, *node)).collect(),
            organisations,
            liars,
            signed: BTreeMap::new(),
            honest: BTreeMap::new(),
            truth: BTreeMap::new(),
            chains: BTreeMap::new(),
            votes: BTreeMap::new(),
            reigns: BTreeMap::new(),
            counts: Counts { seeds: 1, strict: u64::from(strict), ..Counts::default() },
        }
    }

    /// A node comes back under another number.
    pub(super) fn comes_back(&mut self, before: u64, after: u64) {
        let place = self.places.get(&before).copied().unwrap_or(before);
        self.places.insert(after, place);
        if let Some(organisation) = self.organisations.get(&before).copied() {
            self.organisations.insert(after, organisation);
        }
    }

    /// People change who votes: from now on nothing is said about certificates.
    pub(super) fn retire(&mut self) {
        (self.strict, self.is_retired) = (false, true);
    }

    /// The signatures that a certificate needs.
    pub(super) fn quorum(&self) -> usize {
        self.quorum
    }

    fn is_liar(&self, node: u64) -> bool {
        self.places.get(&node).is_some_and(|place| self.liars.contains(place))
    }

    fn promises_one_truth(&self) -> bool {
        self.strict && !self.beyond
    }

    /// A node signs a statement.
    pub(super) fn signs(&mut self, node: u64, statement: &Statement) -> Check {
        let (height, said) = (statement.height, (statement.block, statement.results));
        if self.is_liar(node) {
            let before = self
                .signed
                .get(&height)
                .is_some_and(|all| all.iter().any(|(other, by)| other.0 != said.0 && by.contains(&node)));
            if before {
                self.counts.count("a liar signs two blocks of one height");
            }
        } else {
            let before = *self.honest.entry((node, height)).or_insert(said);
            if before != said {
                let what = format!("node {node} signs {said:?} at height {height}, after {before:?}");
                return Err(Violation::new("an honest node signs one block of a height", what));
            }
        }
        self.signed.entry(height).or_default().entry(said).or_default().insert(node);
        if !self.promises_one_truth() {
            return Ok(());
        }
        let places =
            |by: &BTreeSet<u64>| by.iter().filter_map(|node| self.places.get(node)).collect::<BTreeSet<_>>().len();
        let all = self.signed.get(&height).into_iter().flatten();
        let enough: Vec<_> = all.filter(|(_, by)| places(by) >= self.quorum).collect();
        if enough.len() > 1 {
            let what = format!("height {height}: {enough:?}");
            return Err(Violation::new("no two certificates for one height", what));
        }
        Ok(())
    }

    /// Has that much been signed, and by enough?
    fn is_true(&self, certificate: &Certificate) -> Result<(), String> {
        let statement = &certificate.statement;
        let by = self.signed.get(&statement.height).and_then(|all| all.get(&(statement.block, statement.results)));
        let signers: BTreeSet<u64> = certificate.signatures.iter().map(|signature| signature.node).collect();
        let really = signers.iter().filter(|node| by.is_some_and(|by| by.contains(node))).count();
        let organisations: BTreeSet<_> = signers.iter().filter_map(|node| self.organisations.get(node)).collect();
        if really < self.quorum || organisations.len() < 2 {
            return Err(format!("{really} of {signers:?} have signed it, {} are needed", self.quorum));
        }
        Ok(())
    }

    /// An honest node has made a certificate.
    pub(super) fn made(&mut self, node: u64, certificate: &Certificate, lying: bool) -> Check {
        let statement = certificate.statement;
        if self.is_retired {
            return Ok(());
        }
        if let Err(why) = self.is_true(certificate) {
            return Err(Violation::new("certificates are true", format!("node {node}, {statement:?}: {why}")));
        }
        if self.strict && lying {
            self.counts.count("a strict certificate is made while the liars lie");
        }
        let first = *self.truth.entry(statement.height).or_insert(statement.block);
        if first != statement.block {
            if self.promises_one_truth() {
                let what = format!("node {node}, height {}: {first} and {}", statement.height, statement.block);
                return Err(Violation::new("no two certificates for one height", what));
            }
            if self.strict {
                self.counts.count("two strict certificates where two organisations lie");
            }
        }
        Ok(())
    }

    /// An honest node keeps a proof.
    pub(super) fn proves(&mut self, by: u64, proof: &Misbehaviour) -> Check {
        let node = proof.node();
        if !self.is_liar(node) {
            return Err(Violation::new("evidence names only liars", format!("node {by} keeps {proof:?}")));
        }
        self.counts.count(match proof {
            Misbehaviour::Lie(_) => "a lie is proved",
            Misbehaviour::DoubleVote(_) => "a double vote is proved",
            Misbehaviour::DoubleHead(_) => "a double head is proved",
            Misbehaviour::Fault(_) => "a fault is proved",
        });
        Ok(())
    }

    /// An honest node stops because of a certificate. `own` are its own ones.
    pub(super) fn contradicted(
        &mut self,
        node: u64,
        certificate: &Certificate,
        height: u64,
        own: &BTreeMap<u64, Certificate>,
    ) -> Check {
        if self.is_retired {
            return Ok(());
        }
        let name = "a node stops only for a strict certificate";
        if !self.strict {
            return Err(Violation::new(name, format!("node {node}, height {height}: nothing is strict here")));
        }
        if let Err(why) = self.is_true(certificate) {
            return Err(Violation::new(name, format!("node {node}, {:?}: {why}", certificate.statement)));
        }
        if let Some(own) = own.range(height..).next() {
            let what = format!("node {node} leaves block {height}, and has the certificate of {own:?}");
            return Err(Violation::new("nothing certified is dropped", what));
        }
        self.counts.count("a node is contradicted");
        Ok(())
    }

    /// A node has executed an entry of its log: one entry is part of one chain.
    pub(super) fn executed(&mut self, node: u64, place: (u64, u64), content: &[u8], block: Hash) -> Check {
        // Two leaders may both order an empty block at the moment when a lease ends.
        let payload = Payload::from_bytes(Bytes::copy_from_slice(content));
        if payload.is_ok_and(|payload| payload.transactions.is_empty()) || content.is_empty() {
            return Ok(());
        }
        let (height, term) = place;
        let first = *self.chains.entry((height, term, Hash::of(&[content]))).or_insert(block);
        if first != block {
            let what = format!("node {node} has entry {height} of term {term} in block {block}, others in {first}");
            return Err(Violation::new("an entry follows the one that its leader has before it", what));
        }
        Ok(())
    }

    /// Certificates are strict as of a node's newest block, or not.
    pub(super) fn is_strict(&self, node: u64, height: u64, strict: bool) -> Check {
        if strict == self.strict || self.is_retired {
            return Ok(());
        }
        let what = format!("node {node}, block {height}: strict is {strict}, and nobody has proposed it");
        Err(Violation::new("strict never ends without its proposal", what))
    }

    /// A voter gives a vote, or a leader sends a log.
    pub(super) fn votes(&mut self, voter: u64, term: u64, candidate: u64) -> Check {
        let of = self.votes.entry((voter, term)).or_default();
        of.insert(candidate);
        if of.len() > 1 {
            if !self.is_liar(voter) {
                return Err(Violation::new("one vote a term", format!("node {voter}, term {term}: {:?}", self.votes)));
            }
            self.counts.count("a liar votes twice");
        }
        Ok(())
    }

    /// A copy of a node leads in a term.
    pub(super) fn leads(&mut self, node: u64, copy: usize, term: u64) {
        let copies = self.reigns.entry((node, term)).or_default();
        if copies.insert(copy) && copies.len() > 1 {
            self.counts.count("a liar leads with two logs");
        }
    }

    /// The certified block of each height, as far as honest nodes know.
    pub(super) fn truth(&self) -> &BTreeMap<u64, Hash> {
        &self.truth
    }

    /// Is one truth promised, so that every chain must have it?
    pub(super) fn is_binding(&self) -> bool {
        self.promises_one_truth()
    }
}
