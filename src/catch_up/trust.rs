//! Whether a snapshot is believed: who attests it.
//!
//! A snapshot is believed if nodes of two organisations that belong to the network by the snapshot itself attest its
//! content (of one, if there is only one), and if this node trusts one of the attesting organisations already: one that
//! stands on its own ledger, or in its genesis. So a newcomer is deceived only if two organisations lie together, one of
//! which it knows. An attestation is a transaction that the node signed, so whoever hands it over cannot change it.

use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_api::v1::Attested;
use ledger_hash::Hash;
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::Msps;
use ledger_identity::{Identity, Role};
use ledger_rejection::{Code, Rejection};
use serde::Deserialize;
use std::collections::BTreeSet;

/// Attestations that are looked at: one of each node that a network may have.
pub(super) const ATTESTED_MAX: usize = ledger::members::NODES_MAX;
/// Organisations that must attest, if there are so many.
const ORGANISATIONS_MIN: usize = 2;

/// What is to be attested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Claim {
    /// Name of the network.
    pub network: Hash,
    /// Height of the snapshot.
    pub height: u64,
    /// Block time there, microseconds since the UNIX epoch.
    pub time: u64,
    /// What the manifest's hash is.
    pub content: Hash,
}

/// The argument of `msp attest`, as far as it matters here.
#[derive(Deserialize)]
struct Statement {
    height: u64,
    content: Option<Hash>,
}

impl Claim {
    /// The organisations whose nodes attest this, by these authorities.
    pub(super) fn attested_by(
        &self,
        attested: &[Attested],
        msps: &Msps,
        revoked: &dyn Fn(&Identity) -> bool,
    ) -> BTreeSet<String> {
        let identities = attested.iter().take(ATTESTED_MAX).filter_map(|one| match self.check(one, msps) {
            Ok(identity) => (!revoked(&identity)).then_some(identity.organisation),
            Err(reason) => {
                tracing::debug!(%reason, "an attestation does not count");
                None
            }
        });
        identities.collect()
    }

    fn check(&self, Attested { transaction, certificate }: &Attested, msps: &Msps) -> Result<Identity, Rejection> {
        let other = |what: &str| Rejection::new(Code::Untrusted, format!("it is {what}"));
        let transaction = Transaction::decode(transaction.clone())?;
        let body = transaction.body();
        if body.network != self.network.as_ref() {
            return Err(other("of another network"));
        }
        let statement = match (&*body.chaincode, &*body.function, &*body.args) {
            (ledger::governance::NAME, "attest", [statement]) => read(statement)?,
            _ => return Err(other("no call of msp attest")),
        };
        if statement.height != self.height || statement.content != Some(self.content) {
            return Err(other("of another snapshot"));
        }
        if transaction.creator() != Hash::of(&[certificate]) {
            return Err(other("not signed with this certificate"));
        }
        // It was ordered after the snapshot's block, and the certificate was valid then.
        let at = Certificate::parse(certificate)?.not_before.max(self.time);
        let identity = msps.verify(certificate, &[], at)?;
        if identity.role != Role::Node {
            return Err(other("not of a node"));
        }
        transaction.verify(&identity.public_key)?;
        Ok(identity)
    }

    /// Decides about a snapshot: `trusted` is whom this node trusts, `declared` the network's organisations by the
    /// snapshot itself.
    ///
    /// # Errors
    /// [`Code::Untrusted`] with who attests it and who would have to.
    pub(super) fn accept(
        &self,
        attested: &[Attested],
        trusted: &Msps,
        declared: &Msps,
        revoked: &dyn Fn(&Identity) -> bool,
    ) -> Result<(), Rejection> {
        let by = self.attested_by(attested, declared, revoked);
        let known = self.attested_by(attested, trusted, revoked);
        let wanted = declared.iter().count().min(ORGANISATIONS_MIN);
        if by.len() >= wanted && !known.is_empty() {
            return Ok(());
        }
        let names = |names: BTreeSet<String>| names.into_iter().collect::<Vec<_>>().join(" and ");
        let found = match by.is_empty() {
            true => "no attestation".into(),
            false => format!("attestations of {}, of which this node trusts {:?}", names(by), names(known)),
        };
        Err(Rejection::new(Code::Untrusted, format!("the snapshot of height {} is not attested enough", self.height))
            .found(found)
            .wanted(format!("nodes of {wanted} organisations, one of which this node trusts"))
            .next("wait until the nodes have attested it, which takes some seconds"))
    }
}

fn read(statement: &Bytes) -> Result<Statement, Rejection> {
    serde_json::from_slice(statement)
        .map_err(|error| Rejection::new(Code::Malformed, format!("its argument cannot be read: {error}")))
}

#[cfg(test)]
mod tests;
