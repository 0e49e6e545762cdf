//! The right to read: checked at each subscription, and again for every event.

use super::{Context, Ledger, Meter, check_organisation, check_revoked};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_identity::Identity;
use ledger_storage::result::Event;

impl Ledger {
    /// May this identity see this event? Decided on the committed state.
    ///
    /// # Errors
    /// The reason why not.
    pub fn may_read(&self, reader: &Identity, event: &Event) -> Result<(), Rejection> {
        check_organisation(reader, &self.msps())?;
        let mut overlay = self.overlay();
        check_revoked(reader, &overlay)?;
        self.identities.check_current(reader, self.tip().time)?;
        let chaincode = self.registry.find(&event.chaincode)?;
        let tip = self.tip();
        let meter = Meter::of_query();
        let executed = |id: &Hash, not_after| self.was_executed(id, not_after);
        let environment = self.environment(Some(reader), (&tip, tip.time), &executed, &meter);
        chaincode.may_read(&Context::new(environment, chaincode.name(), &mut overlay, &mut Vec::new()), event)
    }

    /// May this identity follow events of these names about these subjects, of one chaincode or, if it is empty, of
    /// any? Decided on the committed state.
    ///
    /// # Errors
    /// The reason why not; [`Code::UnknownChaincode`], [`Code::BadArgument`] for a name that no event has.
    pub fn may_follow(
        &self,
        reader: &Identity,
        chaincode: &str,
        subjects: &[String],
        names: &[String],
    ) -> Result<(), Rejection> {
        check_organisation(reader, &self.msps())?;
        let mut overlay = self.overlay();
        check_revoked(reader, &overlay)?;
        self.identities.check_current(reader, self.tip().time)?;
        let emitting = self.registry.emitting(chaincode, names)?;
        let tip = self.tip();
        let (mut refused, meter) = (Ok(()), Meter::of_query());
        for chaincode in emitting {
            let executed = |id: &Hash, not_after| self.was_executed(id, not_after);
            let environment = self.environment(Some(reader), (&tip, tip.time), &executed, &meter);
            let mut none = Vec::new();
            let ctx = Context::new(environment, chaincode.name(), &mut overlay, &mut none);
            match chaincode.may_follow(&ctx, subjects, names) {
                Ok(()) => return Ok(()),
                reason => refused = refused.and(reason),
            }
        }
        refused
    }
}
