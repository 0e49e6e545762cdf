//! Revoked stays revoked (design.md §7.5): after the block that revokes a certificate nothing that it signed has any
//! effect, and the grants that it held have ended in that block.

use super::{Check, Executed, Violation};
use crate::lists;
use crate::people::People;
use ledger_base::rejection::Code;
use std::collections::BTreeMap;
use std::sync::Arc;

const NAME: &str = "revoked stays revoked";

/// The certificates that were revoked, and where.
pub struct RevokedStaysRevoked {
    people: Arc<People>,
    /// By issuer and serial, in hexadecimal.
    revoked: BTreeMap<(String, String), u64>,
}

impl RevokedStaysRevoked {
    /// For these people.
    pub fn new(people: Arc<People>) -> Self {
        Self { people, revoked: BTreeMap::new() }
    }

    /// A block was executed for the first time.
    ///
    /// # Errors
    /// A revoked certificate succeeded.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        let height = executed.outcome.header.height;
        for (transaction, result) in executed.transactions.iter().zip(&executed.outcome.results) {
            let Some(transaction) = transaction else { continue };
            let body = transaction.body();
            if result.code() != Code::Ok {
                continue;
            }
            let creator = self.people.by_fingerprint(&transaction.creator());
            let key = creator.map(|person| (hex::encode(person.identity.issuer), hex::encode(&person.identity.serial)));
            if let Some(first) = key.and_then(|key| self.revoked.get(&key)) {
                let who = creator.map(crate::people::Person::id).unwrap_or_default();
                let what =
                    format!("{who} succeeded with {} in block {height}, revoked in block {first}", body.function);
                return Err(Violation::new(NAME, what));
            }
            if let ("msp", "revoke", [issuer, serial, ..]) = (&*body.chaincode, &*body.function, body.args.as_slice()) {
                let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).to_ascii_lowercase();
                self.revoked.entry((text(issuer), text(serial))).or_insert(height);
            }
            for certificate in lists::listed(body) {
                self.revoked.entry(certificate).or_insert(height);
            }
        }
        Ok(())
    }

    /// Is this certificate revoked?
    pub fn is_revoked(&self, issuer: &[u8], serial: &[u8]) -> bool {
        self.revoked.contains_key(&(hex::encode(issuer), hex::encode(serial)))
    }
}
