//! The record of a recovery by force: an operator made one node the only voter, because most voters were lost.
//!
//! Nobody signs a change of members. So the node itself says in the context of the change what was done. Executing the change
//! writes it down: as a record for ever, and as an event.

use super::nodes::{self, NodeRole};
use super::store::{self, json, recovery_key};
use super::{certificate_rule, node_roles};
use crate::chaincode::Context;
use crate::members::{Change, MembershipChange};
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::entry::{Entry, EntryKind};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// In front of the record in the context of a change of members.
const DOMAIN: &[u8] = b"ledgerd recovery v1\0";
/// Longest reason, in bytes.
pub const REASON_BYTES_MAX: usize = 256;
/// Longest context of a change, in bytes: [`MembershipChange::context`].
const CONTEXT_BYTES_MAX: usize = 1024;

/// A recovery by force.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recovery {
    /// Number of the node that is the only voter since.
    pub id: u64,
    /// The node, `ORGANISATION/NAME`.
    pub node: String,
    /// The voters before it.
    pub voters: BTreeSet<u64>,
    /// When the operator did it, by that machine's clock, microseconds since the UNIX epoch.
    pub at: u64,
    /// The operator's words.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

impl Recovery {
    /// The change that makes the node the only voter, and this record stay. All others leave the ordering.
    ///
    /// # Errors
    /// [`Code::TooLarge`] if reason or name are too long.
    pub fn change(&self, others: impl IntoIterator<Item = u64>) -> Result<MembershipChange, Rejection> {
        let too_large = |what: &str, found: usize, max: usize| {
            Rejection::new(Code::TooLarge, format!("{what} is too long"))
                .found(format!("{found} bytes"))
                .wanted(format!("at most {max}"))
        };
        if self.reason.len() > REASON_BYTES_MAX {
            return Err(too_large("the reason", self.reason.len(), REASON_BYTES_MAX));
        }
        let context = [DOMAIN, &json(self)?].concat();
        if context.len() > CONTEXT_BYTES_MAX {
            return Err(too_large("the record of a recovery", context.len(), CONTEXT_BYTES_MAX));
        }
        let others = others.into_iter().filter(|node| *node != self.id).map(Change::Remove);
        let change = MembershipChange::new(std::iter::once(Change::AddVoter(self.id)).chain(others));
        Ok(MembershipChange { context: context.into(), ..change })
    }

    /// The record in a change of members, if it is a recovery.
    pub fn of(entry: &Entry) -> Option<Self> {
        if entry.kind != EntryKind::ConfChangeV2 {
            return None;
        }
        let context = MembershipChange::from_bytes(&entry.data).ok()?.context;
        let record = context.strip_prefix(DOMAIN).filter(|_| context.len() <= CONTEXT_BYTES_MAX)?;
        serde_json::from_slice(record).ok()
    }
}

/// Writes down that the members were changed by force.
///
/// # Errors
/// A fault of the store.
pub(crate) fn note(ctx: &mut Context<'_>, recovery: &Recovery) -> Result<(), Rejection> {
    store::write(ctx, &recovery_key(ctx.height()), recovery)?;
    ctx.emit("members_forced", &recovery.node, json(recovery)?);
    // From here on the ledger wants what was done. Otherwise a lost voter that starts as it was would vote again by itself,
    // and a survivor that had no vote before would lose its vote to the first node that gets one.
    for node in nodes::all(ctx)? {
        let role = match node.role {
            NodeRole::Removed => continue,
            _ if node.id == recovery.id => NodeRole::Voter,
            _ => NodeRole::Learner,
        };
        node_roles::put_role(ctx, &node, role)?;
    }
    certificate_rule::end(ctx)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::members::Membership;
    use bytes::Bytes;

    fn recovery(reason: &str) -> Recovery {
        Recovery { id: 2, node: "Org1/node2".into(), voters: [1, 2, 3].into(), at: 7, reason: reason.into() }
    }

    fn entry(data: Bytes) -> Entry {
        Entry { index: 1, term: 1, kind: EntryKind::ConfChangeV2, data }
    }

    #[test]
    fn a_recovery_leaves_one_voter_and_nobody_else_and_its_record_is_read_again() {
        let change = recovery("a fire").change([1, 2, 3, 4]).unwrap();
        let forced = entry(change.to_bytes());
        assert_eq!(Recovery::of(&forced), Some(recovery("a fire")));
        let members = Membership::new([1, 2, 3], [4]);
        let left = members.fold([&forced, &entry(Bytes::new())]);
        assert!(left.is_alone(2) && left.nodes() == [2].into(), "{left:?}");
    }

    #[test]
    fn a_learner_that_is_left_and_an_only_voter_can_be_recovered_too() {
        for (members, others) in [(Membership::new([1], [2]), vec![1]), (Membership::new([2], []), vec![])] {
            let change = recovery("").change(others).unwrap();
            let rest = [entry(change.to_bytes()), entry(Bytes::new())];
            let left = members.fold(rest.iter().take(if change.changes.len() > 1 { 2 } else { 1 }));
            assert!(left.is_alone(2), "{left:?}");
        }
    }

    #[test]
    fn other_contexts_are_no_recovery_and_long_reasons_are_refused() {
        let plain = MembershipChange::new([Change::AddVoter(2)]);
        assert_eq!(Recovery::of(&entry(plain.to_bytes())), None);
        for context in [b"ledgerd recovery v1\0{".to_vec(), b"ledgerd recovery v2\0{}".to_vec()] {
            let change = MembershipChange { context: context.into(), ..plain.clone() };
            assert_eq!(Recovery::of(&entry(change.to_bytes())), None);
        }
        assert_eq!(recovery(&"x".repeat(257)).change([1]).unwrap_err().code, Code::TooLarge);
    }
}
