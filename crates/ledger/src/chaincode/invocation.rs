//! Calls of installed chaincodes: transactions, queries, and hooks.

use super::approval::check_ordinary;
use super::context::{Context, Environment, run, run_hook};
use super::{Chaincode, Foretold, Registry};
use bytes::Bytes;
use ledger_base::rejection::Rejection;
use ledger_storage::result::Event;
use ledger_storage::state::Overlay;
use std::panic::{AssertUnwindSafe, catch_unwind};

impl Registry {
    /// Executes one call: its writes are in the overlay and its events in `events` only if it succeeds.
    ///
    /// # Errors
    /// The rejection of the chaincode, `Code::UnknownChaincode`, `Code::NeedsApproval`, `Code::QueryOnly` or
    /// `Code::OverBudget`.
    pub fn invoke(
        environment: Environment<'_>,
        overlay: &mut Overlay,
        events: &mut Vec<Event>,
        chaincode: &str,
        function: &str,
        args: &[Bytes],
    ) -> Result<Bytes, Rejection> {
        let callee = environment.registry.find(chaincode)?;
        check_ordinary(callee, function)?;
        environment.check_changes(callee, function)?;
        let meter = environment.meter;
        meter.begin(environment.submitter.map_or("", |submitter| submitter.organisation.as_str()));
        let answered = run((environment, None), callee.name(), 0, overlay, events, |ctx| {
            let answer =
                callee.invoke(ctx, function, args).map_err(|refused| environment.speaks_of_the_call(refused))?;
            meter.answer(answer.len())?;
            environment.check_kept(callee, function)?;
            Ok(answer)
        });
        meter.end().and(answered)
    }

    /// The answer and the events of a successful call, if the call alone determines them ([`Chaincode::foretell`]).
    pub(crate) fn foretell(&self, chaincode: &str, function: &str, args: &[Bytes]) -> Option<Foretold> {
        let callee = self.find(chaincode).ok()?;
        catch_unwind(AssertUnwindSafe(|| callee.foretell(function, args))).ok().flatten()
    }

    /// Runs a hook of one chaincode; a hook that panics leaves nothing behind.
    ///
    /// # Errors
    /// [`ledger_base::rejection::Code::ChaincodePanic`], [`ledger_base::rejection::Code::LimitExceeded`].
    pub fn hook(
        environment: Environment<'_>,
        chaincode: &dyn Chaincode,
        overlay: &mut Overlay,
        events: &mut Vec<Event>,
        body: impl FnOnce(&mut Context<'_>),
    ) -> Result<(), Rejection> {
        run_hook((environment, chaincode.name(), 0), overlay, events, body)
    }
}
