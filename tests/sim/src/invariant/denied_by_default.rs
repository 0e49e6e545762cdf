//! Denied by default (design.md §7.3): who has no right by any policy that the simulated admins use never succeeds in
//! taking, using or changing anything.
//!
//! Judged by nothing but the certificate: an organisation that no robot trusts, or neither admin nor any attribute
//! while only attributes count. The oracle judges the further decisions of policies.

use super::{Check, Executed, Violation};
use crate::people::{People, Person};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use std::sync::Arc;

const NAME: &str = "denied by default";

/// Knows who has no rights.
pub struct DeniedByDefault {
    people: Arc<People>,
}

impl DeniedByDefault {
    /// For these people.
    pub fn new(people: Arc<People>) -> Self {
        Self { people }
    }

    /// A block was executed for the first time.
    ///
    /// # Errors
    /// Somebody succeeded who must not.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        for (transaction, result) in executed.transactions.iter().zip(&executed.outcome.results) {
            let Some(transaction) = transaction else { continue };
            if result.code() != Code::Ok {
                continue;
            }
            let body = transaction.body();
            let Some(person) = self.people.by_fingerprint(&transaction.creator()) else {
                return Err(Violation::new(NAME, format!("an unknown certificate called {}", body.function)));
            };
            let uses = body.chaincode == "abac"
                && matches!(
                    &*body.function,
                    "acquire"
                        | "acquire_all"
                        | "submit"
                        | "progress"
                        | "fail"
                        | "delegate"
                        | "handover"
                        | "recall"
                        | "renew"
                        | "reader"
                        | "share"
                        | "set"
                        | "take"
                        | "stop"
                        | "resume"
                );
            let rules = matches!(
                (&*body.chaincode, &*body.function),
                ("abac", "setup" | "replace" | "configure" | "remove" | "policy")
                    | ("msp", "revoke" | "record_revocation_list" | "propose")
            );
            if (uses && has_no_right(person)) || (rules && person.identity.role != Role::Admin) {
                return Err(Violation::new(
                    NAME,
                    format!(
                        "{} succeeded with {} in block {}",
                        person.id(),
                        body.function,
                        executed.outcome.header.height
                    ),
                ));
            }
        }
        Ok(())
    }
}

/// Of an organisation that no robot trusts.
fn has_no_right(person: &Person) -> bool {
    person.identity.organisation == "Org3"
}
