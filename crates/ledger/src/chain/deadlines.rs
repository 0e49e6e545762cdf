//! Questions to chaincodes that no client asks: when something is due, and which budget a service has.

use super::{Context, Ledger, Meter};
use crate::chaincode::ServiceBudget;
use ledger_base::hash::Hash;

impl Ledger {
    /// The earliest block time at which a chaincode has something to do without being called, microseconds.
    pub fn next_deadline(&self) -> Option<u64> {
        let mut overlay = self.overlay();
        let tip = self.tip();
        let deadlines = self.registry.iter().filter_map(|chaincode| {
            let meter = Meter::of_query();
            let executed = |id: &Hash, not_after| self.was_executed(id, not_after);
            let environment = self.environment(None, (&tip, tip.time), &executed, &meter);
            chaincode.next_deadline(&Context::new(environment, chaincode.name(), &mut overlay, &mut Vec::new()))
        });
        deadlines.min()
    }

    /// The time by which a question is judged that comes at `now` by the clock of the node. It is no earlier than block time, and
    /// before the next moment at which something ends by itself: a block ends a lease, never the clock of one node.
    pub fn judged_at(&self, now: u64) -> u64 {
        let block_time = self.tip().time;
        if now <= block_time {
            return block_time;
        }
        let before_the_next_end = self.next_deadline().map_or(u64::MAX, |due| due.saturating_sub(1));
        now.min(before_the_next_end).max(block_time)
    }

    /// The budget of a service of a chaincode by its owner, as of the state; none if there is no such service.
    pub fn service_budget(&self, chaincode: &str, service: &str) -> Option<ServiceBudget> {
        let (mut overlay, tip, meter) = (self.overlay(), self.tip(), Meter::of_query());
        let chaincode = self.registry.find(chaincode).ok()?;
        let executed = |id: &Hash, not_after| self.was_executed(id, not_after);
        let environment = self.environment(None, (&tip, tip.time), &executed, &meter);
        chaincode.service_budget(&Context::new(environment, chaincode.name(), &mut overlay, &mut Vec::new()), service)
    }
}
