//! Members whose authority has not published its revocation list in time, where their organisation refuses them then.

use super::super::store::{LISTS, list_state, read_state, stale_key};
use super::super::{NAME, RECORD_LIST};
use super::{LISTS_MAX, Stale, current};
use crate::transaction::Transaction;
use ledger_base::moment::rfc3339;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};
use ledger_storage::state::StateRead;
use std::collections::HashMap;

/// Until when the lists of authorities hold (microseconds since the UNIX epoch), by SHA-256 of the authority's name. Only of
/// organisations that refuse their members afterwards.
#[derive(Debug, Default)]
pub(crate) struct Due(HashMap<[u8; 32], u64>);

impl Due {
    /// Refuses a person whose authority's list has ended before this time, microseconds of block time.
    pub(crate) fn check(&self, identity: &Identity, at: u64) -> Result<(), Rejection> {
        match self.0.get(&identity.issuer) {
            Some(end) if *end < at && identity.role != Role::Node => {
                let organisation = &identity.organisation;
                Err(Rejection::new(
                    Code::ListStale,
                    format!(
                        "{organisation} rejects its own members, such as {}, until a new revocation list is recorded",
                        identity.id()
                    ),
                )
                .found(format!("the revocation list of its CA, which expired at {}", rfc3339(*end)))
                .wanted("a revocation list that has not expired")
                .next(format!("ask an admin of {organisation}: ledgerctl identity crl FILE records the new list")))
            }
            _ => Ok(()),
        }
    }
}

/// Reads it from a state.
pub(crate) fn due(state: &dyn StateRead) -> Result<Due, Rejection> {
    let mut due = HashMap::new();
    for list in current(list_state(state, LISTS, LISTS_MAX)?).into_iter().filter(|list| !list.partial) {
        let stale: Stale = read_state(state, &stale_key(&list.organisation))?.unwrap_or_default();
        if let Some(end) = list.next_update.filter(|_| stale == Stale::Refuse) {
            due.insert(list.issuer.0, end);
        }
    }
    Ok(Due(due))
}

/// Does this transaction bring a new list? It is the way back for those who are refused.
pub(crate) fn publishes_list(transaction: &Transaction) -> bool {
    let body = transaction.body();
    body.chaincode == NAME && body.function == RECORD_LIST
}
