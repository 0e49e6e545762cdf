//! For tests: a block in which records are changed.

use ledger::{Context, Environment, Meter, Registry};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_storage::state::{MemoryState, Overlay};
use std::sync::Arc;

/// The end of a block that does this.
pub(crate) fn block(body: impl FnOnce(&mut Context<'_>)) -> Result<(), Rejection> {
    let registry = Registry::new();
    let (submitter, network, transaction) = (None, Hash::ZERO, Hash::ZERO);
    let rules = ledger::Rules::NEWEST;
    let meter = Meter::of_query();
    let environment = Environment {
        registry: &registry,
        submitter,
        network,
        rules,
        height: 1,
        time: 0,
        transaction,
        executed: &|_, _| false,
        meter: &meter,
    };
    let (mut overlay, mut events) = (Overlay::new(Arc::new(MemoryState::default())), Vec::new());
    body(&mut Context::new(environment, "abac", &mut overlay, &mut events));
    overlay.finish().map(drop)
}
