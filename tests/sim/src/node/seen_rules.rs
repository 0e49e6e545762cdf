//! A chaincode that writes nothing: it sees by which rules each block is executed, as every chaincode does.

use bytes::Bytes;
use ledger::{Chaincode, Context};
use ledger_base::rejection::Rejection;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// By height, the number of the rules of a block; forgotten once it was looked at.
#[derive(Clone, Default)]
pub struct SeenRules(Arc<Mutex<BTreeMap<u64, u32>>>);

impl SeenRules {
    /// The number of the rules by which the block at a height was executed.
    pub fn take(&self, height: u64) -> Option<u32> {
        self.0.lock().unwrap().remove(&height)
    }
}

impl Chaincode for SeenRules {
    fn name(&self) -> &'static str {
        "seen-rules"
    }

    fn invoke(&self, _: &mut Context<'_>, function: &str, _: &[Bytes]) -> Result<Bytes, Rejection> {
        Err(Rejection::unknown_function(self.name(), function, &[]))
    }

    fn begin_block(&self, ctx: &mut Context<'_>) {
        self.0.lock().unwrap().insert(ctx.height(), ctx.rules().number());
    }
}
