//! The rules by which blocks are executed: which number holds at which height, and what if this release lacks it.

use super::Ledger;
use crate::msp::{self, NodeRecord};
use crate::rules::{Activation, Rules, Schedule};
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use std::sync::{PoisonError, RwLockReadGuard};

impl Ledger {
    /// The rules by which the next block is executed, and queries are answered. Where this release does not speak those of
    /// the next block, which it then refuses, the rules of the last one.
    pub fn rules(&self) -> Rules {
        let (height, schedule) = (self.tip().height, self.schedule());
        let spoken = |height| self.registry.speaks(schedule.number_at(height));
        spoken(height + 1).or_else(|| spoken(height)).unwrap_or(self.registry.newest())
    }

    /// The rules that are to be activated after the next block, if the organisations have decided so.
    pub fn pending_rules(&self) -> Option<Activation> {
        self.schedule().after(self.tip().height + 1)
    }

    /// The rules of the block at that height, which is executed next.
    ///
    /// # Errors
    /// [`Code::UnknownRules`].
    pub(super) fn rules_of(&self, height: u64) -> Result<Rules, Rejection> {
        let late = u64::from(active(Mutation::OlderRulesAtTheActivation));
        let number = self.schedule().number_at(height - late);
        self.registry.speaks(number).ok_or_else(|| self.unknown(Activation { number, height }))
    }

    /// Reads from the state which rules were activated, and warns of those that this release does not speak.
    pub(super) fn reload_rules(&self) -> Result<(), Rejection> {
        let schedule = Schedule::new(self.founded, msp::activations(&*self.state)?);
        *self.schedule.write().unwrap_or_else(PoisonError::into_inner) = schedule;
        if let Some(pending) = self.pending_rules().filter(|pending| self.registry.speaks(pending.number).is_none()) {
            let reason = self.unknown(pending);
            tracing::warn!(code = reason.code.name(), %reason, "this node is going to stop");
        }
        Ok(())
    }

    pub(super) fn schedule(&self) -> RwLockReadGuard<'_, Schedule> {
        self.schedule.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn unknown(&self, Activation { number, height }: Activation) -> Rejection {
        let message =
            format!("this release of ledgerd does not support rules {number}, with which block {height} is executed");
        let nodes = msp::nodes(&*self.state).unwrap_or_default();
        let speaks =
            |node: &NodeRecord| Some((node.speaks.clone().filter(|it| it.newest >= number)?, node.full_name()));
        let release = nodes.iter().find_map(speaks).map_or_else(
            || "a release of ledgerd that supports them".to_owned(),
            |(speaks, node)| format!("ledgerd {}, which {node} runs, or a later release", speaks.release),
        );
        Rejection::new(Code::UnknownRules, message)
            .found(format!("rules {number} from block {height} on"))
            .wanted(self.registry.newest().and_older())
            .next(format!("install {release}, and start the node again; its data stay as they are"))
    }
}
