//! Transactions of the node itself.

use crate::ordering::orderer_slot::OrdererSlot;
use crate::process::clock::Clock;
use crate::storage::Storage;
use bytes::Bytes;
use ledger::Admission;
use ledger::msp;
use ledger::transaction::{Body, NONCE_BYTES, Transaction};
use ledger_api::tls::TlsIdentity;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Input, Lane};
use ring::rand::{SecureRandom, SystemRandom};
use serde::Serialize;
use std::sync::Arc;
use std::time::Duration;

/// How long after now a transaction of the node may still be executed.
const TTL: Duration = Duration::from_secs(30);

/// The node's identity, ready to sign; follows the renewal of its certificate.
pub(crate) struct Signer {
    identity: TlsIdentity,
    network: Hash,
    clock: Clock,
    random: SystemRandom,
}

impl Signer {
    /// Signs as this identity on a network.
    pub(crate) fn new(identity: TlsIdentity, network: Hash, clock: Clock) -> Self {
        Self { identity, network, clock, random: SystemRandom::new() }
    }

    /// A call of a chaincode function, with the certificate, so that every ledger accepts it.
    ///
    /// # Errors
    /// The reason why it is no transaction.
    fn sign(&self, chaincode: &str, function: &str, args: Vec<Bytes>) -> Result<Transaction, Rejection> {
        let mut nonce = [0; NONCE_BYTES];
        self.random
            .fill(&mut nonce)
            .map_err(|_| Rejection::new(Code::Internal, "the operating system provides no randomness"))?;
        let own = self.identity.own();
        let certificate = own.chain.first().map(|der| Bytes::copy_from_slice(der)).unwrap_or_default();
        let ttl = u64::try_from(TTL.as_micros()).unwrap_or(u64::MAX);
        let body = Body {
            network: Bytes::copy_from_slice(&self.network.0),
            creator: Bytes::copy_from_slice(&own.creator.0),
            nonce: Bytes::copy_from_slice(&nonce),
            not_after: self.clock.now().saturating_add(ttl),
            chaincode: chaincode.into(),
            function: function.into(),
            args,
            known_block: None,
        };
        Transaction::sign(&body, &own.key)?.with_certificate(certificate)
    }
}

/// Calls functions of the chaincode `msp` as the node itself.
pub(crate) struct Author {
    /// Signs the calls.
    pub signer: Signer,
    /// Says whether a call would be executed.
    pub storage: Arc<Storage>,
    /// Has them ordered.
    pub slot: Arc<OrdererSlot>,
}

impl Author {
    /// Submits a call with this argument, unless the ledger has it already. Its verdict is not waited for.
    ///
    /// # Errors
    /// The reason why the state refuses it, or why nothing can be ordered now.
    pub(crate) fn submit(&self, function: &str, argument: &impl Serialize) -> Result<(), Rejection> {
        self.order(&self.sign(function, argument)?)
    }

    /// A signed call with this argument.
    ///
    /// # Errors
    /// The reason why it is no transaction.
    pub(crate) fn sign(&self, function: &str, argument: &impl Serialize) -> Result<Transaction, Rejection> {
        let argument =
            serde_json::to_vec(argument).map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
        self.signer.sign(msp::NAME, function, vec![Bytes::from(argument)])
    }

    /// Submits a signed call, unless the ledger has it already.
    ///
    /// # Errors
    /// As [`Author::submit`].
    pub(crate) fn order(&self, signed: &Transaction) -> Result<(), Rejection> {
        let admission = self.storage.ledger.admit(signed.encoded().clone(), self.signer.clock.now());
        match admission.map_err(|refusal| refusal.rejection)? {
            Admission::New(transaction) => {
                self.slot.input(Input::Submit { lane: Lane::Data, transaction: transaction.encoded().clone() })
            }
            Admission::Known(..) => Ok(()),
        }
    }
}
