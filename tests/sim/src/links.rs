//! The network between the nodes: every directed link delays, loses, repeats, holds back or is cut.

use crate::coverage::{Coverage, Fault};
use crate::plan::NetworkPlan;
use std::collections::{BTreeMap, BTreeSet};
use testkit::Random;

/// Links between nodes.
pub struct Links {
    plan: NetworkPlan,
    /// Links that lose everything, by the fault that cut them.
    cuts: BTreeMap<u64, BTreeSet<(u64, u64)>>,
    /// Links that hold everything back until a time.
    clogged: BTreeMap<(u64, u64), u64>,
    /// When the last message that keeps its place arrives.
    latest: BTreeMap<(u64, u64), u64>,
}

impl Links {
    /// The network of a plan.
    pub fn new(plan: NetworkPlan) -> Self {
        Self { plan, cuts: BTreeMap::new(), clogged: BTreeMap::new(), latest: BTreeMap::new() }
    }

    /// Cuts links, until [`Links::join`] with the same name.
    pub fn cut(&mut self, name: u64, links: BTreeSet<(u64, u64)>) {
        self.cuts.insert(name, links);
    }

    /// Ends a cut.
    pub fn join(&mut self, name: u64) {
        self.cuts.remove(&name);
    }

    /// Does this link lose everything now?
    pub fn is_cut(&self, link: (u64, u64)) -> bool {
        self.cuts.values().any(|cut| cut.contains(&link))
    }

    /// Holds everything on a link back until a time.
    pub fn clog(&mut self, link: (u64, u64), until: u64) {
        self.clogged.insert(link, until);
    }

    /// From now on everything arrives, soon and in order.
    pub fn heal(&mut self) {
        self.cuts.clear();
        self.clogged.clear();
        let NetworkPlan { delay_min, delay_max, .. } = self.plan;
        self.plan = NetworkPlan {
            delay_min,
            delay_max,
            lose_per_mille: 0,
            duplicate_per_mille: 0,
            reorder_per_mille: 0,
            delay_per_mille: 0,
        };
    }

    /// When a message that is sent now arrives: not at all, once, or several times.
    pub fn send(&mut self, now: u64, link: (u64, u64), random: &mut Random, coverage: &mut Coverage) -> Vec<u64> {
        if self.is_cut(link) {
            return Vec::new();
        }
        if random.per_mille(self.plan.lose_per_mille) {
            coverage.fault(Fault::Loss);
            return Vec::new();
        }
        let mut arrivals = vec![self.arrival(now, link, random, coverage)];
        if random.per_mille(self.plan.duplicate_per_mille) {
            coverage.fault(Fault::Duplication);
            arrivals.push(self.arrival(now, link, random, coverage));
        }
        arrivals
    }

    /// When a statement about a block arrives, if it does: it may be lost, and overtake others.
    pub fn statement(&self, now: u64, link: (u64, u64), random: &mut Random) -> Option<u64> {
        let lost = random.per_mille(self.plan.lose_per_mille);
        let at = now + random.between(self.plan.delay_min, self.plan.delay_max);
        let free_from = self.clogged.get(&link).copied().unwrap_or(0);
        (!lost && !self.is_cut(link)).then(|| at.max(free_from))
    }

    /// A request or an answer between a client and a node: delayed or lost, never repeated, as on a connection.
    pub fn client(&mut self, now: u64, random: &mut Random, coverage: &mut Coverage) -> Option<u64> {
        if random.per_mille(self.plan.lose_per_mille / 2) {
            coverage.fault(Fault::Loss);
            return None;
        }
        Some(now + random.between(self.plan.delay_min, self.plan.delay_max))
    }

    fn arrival(&mut self, now: u64, link: (u64, u64), random: &mut Random, coverage: &mut Coverage) -> u64 {
        let mut delay = random.between(self.plan.delay_min, self.plan.delay_max);
        if random.per_mille(self.plan.delay_per_mille) {
            coverage.fault(Fault::Delay);
            delay *= random.between(10, 100);
        }
        let free_from = self.clogged.get(&link).copied().unwrap_or(0);
        let at = (now + delay).max(free_from);
        let latest = self.latest.entry(link).or_default();
        if at <= *latest && random.per_mille(self.plan.reorder_per_mille) {
            coverage.fault(Fault::Reordering);
            return at;
        }
        *latest = at.max(*latest + 1);
        *latest
    }
}
