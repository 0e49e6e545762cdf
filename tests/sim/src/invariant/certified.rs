//! A certificate says what executing its block gave, and enough of the voters as of the block before have signed it. An honest
//! node signs one statement for a height, of a block that its own disk holds.
//!
//! Source: docs/format.md, Certified blocks.

use super::{Check, Violation};
use ledger::Outcome;
use ledger::members::Membership;
use ledger_identity::Identity;
use ledger_light::{Certificate, CertificateRule, Signed, Statement, Voter, Voters};
use std::collections::BTreeMap;

const NAME: &str = "certificates are true";

/// See the module.
#[derive(Default)]
pub struct CertificatesAreTrue {
    /// The statements of each node, by height.
    signed: BTreeMap<(u64, u64), Statement>,
    /// The certificate of each height, as the first node made it.
    certified: BTreeMap<u64, Statement>,
    /// The newest height for which each node has made a certificate.
    newest: BTreeMap<u64, u64>,
}

impl CertificatesAreTrue {
    /// A node signs a statement; its log is on its disk up to `durable`.
    ///
    /// # Errors
    /// If it signed another one for that height, or its disk may lose the block.
    pub fn signed(&mut self, id: u64, signed: &Signed, durable: u64) -> Check {
        let (statement, height) = (signed.statement, signed.statement.height);
        let before = *self.signed.entry((id, height)).or_insert(statement);
        if before != statement {
            return Err(Violation::new(NAME, format!("node {id} signs {statement:?} after {before:?}")));
        }
        if durable < height {
            let what = format!("node {id} signs block {height}, and its disk holds {durable} blocks");
            return Err(Violation::new(NAME, what));
        }
        Ok(())
    }

    /// A node has made a certificate. `block` is what honest nodes executed, `members` are those as of the block before, by
    /// which certificates are `strict` or not. `identity` is that of each node.
    ///
    /// # Errors
    /// If the certificate is not true, or too few have signed it.
    pub fn made(
        &mut self,
        id: u64,
        certificate: &Certificate,
        block: Option<&Outcome>,
        (members, strict): (&Membership, bool),
        identity: &dyn Fn(u64) -> Identity,
    ) -> Check {
        let (statement, height) = (certificate.statement, certificate.statement.height);
        let first = *self.certified.entry(height).or_insert(statement);
        if first != statement {
            return Err(Violation::new(NAME, format!("two certificates for block {height}: {statement:?}, {first:?}")));
        }
        let executed = block.and_then(|block| Some((block.hash, block.certifiable?.results)));
        if executed != Some((statement.block, statement.results)) {
            return Err(Violation::new(NAME, format!("a certificate of {statement:?}, executed was {executed:?}")));
        }
        let known = |node: u64| {
            let Identity { organisation, name, .. } = identity(node);
            (node, Voter { organisation, name })
        };
        let (voters, outgoing) = (members.voters.clone(), members.outgoing.clone());
        let nodes = members.nodes().into_iter().map(known).collect();
        let by = |der: &[u8]| {
            let signer = certificate.signatures.iter().find(|signature| signature.certificate == der);
            identity(signer.map_or(1, |signature| signature.node))
        };
        let rule = CertificateRule { strict_since: strict.then_some(0), ..CertificateRule::default() };
        let voters = Voters { nodes, voters, outgoing, rule, recoveries: 0 };
        let verified = certificate.verify(&statement.network, &voters, |der, _| Ok(by(der)));
        if let Err(refused) = verified {
            return Err(Violation::new(NAME, format!("a certificate of node {id} for block {height}: {refused}")));
        }
        let newest = self.newest.entry(id).or_default();
        *newest = height.max(*newest);
        Ok(())
    }

    /// A node is proved to have lied.
    ///
    /// # Errors
    /// If it is none that does.
    pub fn lied(&self, id: u64, liar: Option<u64>) -> Check {
        match liar == Some(id) {
            true => Ok(()),
            false => Err(Violation::new(NAME, format!("node {id} is honest, and there is a proof that it lied"))),
        }
    }

    /// The newest height for which a node has made a certificate.
    pub fn newest(&self, id: u64) -> u64 {
        self.newest.get(&id).copied().unwrap_or_default()
    }
}
