//! The signers of transactions.

use crate::context;
use crate::session::Session;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use std::collections::HashMap;

/// The names of signers: names that certificates carry, checked against the organisations of our context.
pub(crate) struct Senders<'a> {
    session: &'a Session,
    known: HashMap<Hash, Identity>,
}

impl<'a> Senders<'a> {
    /// Nobody is known yet.
    pub(crate) fn new(session: &'a Session) -> Self {
        Self { session, known: HashMap::new() }
    }

    /// The network whose transactions they are.
    pub(crate) fn network(&self) -> Hash {
        self.session.context().network
    }

    /// Checks the signature and names the signer. A stream shows each certificate once, with the first transaction of its owner.
    ///
    /// # Errors
    /// [`Code::UnknownCreator`] without a certificate; the fault of the certificate; [`Code::BadSignature`].
    pub(crate) fn check(&mut self, transaction: &Transaction, certificate: &[u8]) -> Result<&Identity, Rejection> {
        let creator = transaction.creator();
        if Hash::of(&[certificate]) == creator && !self.known.contains_key(&creator) {
            let identity = context::verified(self.session.context(), certificate)?;
            self.known.insert(creator, identity);
        }
        let signer = self.known.get(&creator).ok_or_else(|| {
            Rejection::new(Code::UnknownCreator, format!("the sender of transaction {} is unknown", transaction.id()))
                .found(format!("no certificate with fingerprint {creator}"))
                .wanted("the sender's certificate with its first message")
                .next("the node omitted it: query another node")
        })?;
        transaction.verify(&signer.public_key)?;
        Ok(signer)
    }
}
