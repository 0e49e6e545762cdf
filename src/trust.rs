//! Identity of this node, and certificates of organisations and nodes.
//!
//! | module | content |
//! |---|---|
//! | `credentials` | the node's certificate and key, and the CAs whose keys it holds |
//! | `membership` | which of the network's nodes this is |
//! | `organisations` | the organisations on the ledger, for TLS |
//! | `ca` | the certificate authority of an organisation |
//! | `enrolment` | its API: enrolment secrets, certificates, moving a CA |
//! | `renewal` | replacing the node's certificate before it expires |

pub mod ca;
pub(crate) mod credentials;
pub(crate) mod enrolment;
pub(crate) mod membership;
pub(crate) mod organisations;
pub(crate) mod renewal;

use crate::ordering::Ordering;
use crate::ordering::directory::Member;
use crate::process::clock::wall;
use crate::process::config::Config;
use credentials::NodeCredentials;
use enrolment::{Authorities, EnrolmentService, LedgerClient, OwnNode};
use ledger_api::tls::{TlsIdentity, TrustSource};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_raft::Secret;
use membership::{Joined, check_member, own_membership};
use organisations::Organisations;
use renewal::Renewer;
use std::path::PathBuf;
use std::sync::Arc;

/// Identity of this node, and the organisations that it trusts.
pub(crate) struct Trust {
    data: PathBuf,
    /// This node, as it was known when it started.
    pub me: Member,
    /// Its certificate and key, shared with all that show them.
    pub identity: TlsIdentity,
    /// The CAs whose keys it holds.
    authorities: Arc<Authorities>,
    /// The organisations of the network.
    pub organisations: Arc<dyn TrustSource>,
    /// Set on a node that has joined.
    pub joined: Option<Joined>,
}

impl Trust {
    /// Finds out by the node's certificate, and what joining left here, which node of the network this is.
    ///
    /// # Errors
    /// If this is no node of the network, or its certificate or CA is not usable.
    pub(crate) fn new(
        config: &Config,
        credentials: NodeCredentials,
        ordering: &Ordering,
    ) -> Result<Arc<Self>, Rejection> {
        let NodeCredentials { identity, authorities } = credentials;
        let (storage, data) = (&ordering.storage, config.data.clone());
        let ledger = &storage.ledger;
        renewal::revive(&data, &identity, &authorities, &ledger.msps())?;
        let joined = Joined::load(&data)?;
        let members = ordering.directory.members();
        let me = own_membership(&identity, ledger, &storage.genesis, &members, joined.as_ref())?;
        check_member(config, ledger.network(), &me)?;
        authorities.check_carried(ledger, &me)?;
        let organisations = Arc::new(Organisations::new(ledger, ordering.clock.clone()));
        Ok(Arc::new(Self { data, me, identity, authorities, organisations, joined }))
    }

    /// The secret behind this node's receipts on a network.
    pub(crate) fn receipt_secret(&self, network: Hash) -> Secret {
        let purpose = [&b"ledgerd receipts v1\0"[..], &network.0].concat();
        Secret(self.identity.own().key.secret_for(&purpose))
    }

    /// The API of the CAs, which calls the ledger through the gateway at this address. `cut_off`: can nothing be ordered
    /// through this node now? `clock_off`: how far most voters' clocks are ahead of this machine's, microseconds.
    pub(crate) fn enrolment(
        &self,
        ordering: &Ordering,
        gateway: &str,
        cut_off: impl Fn() -> bool + Send + Sync + 'static,
        clock_off: impl Fn() -> i64 + Send + Sync + 'static,
    ) -> EnrolmentService {
        let storage = &ordering.storage;
        let client = LedgerClient::through(gateway, storage.ledger.network(), &self.identity, &self.organisations);
        let own = OwnNode {
            me: self.me.clone(),
            identity: self.identity.clone(),
            directory: Arc::clone(&ordering.directory),
            cut_off: Box::new(cut_off),
            clock_off: Box::new(clock_off),
        };
        let genesis = (storage.genesis.clone(), storage.document.clone());
        let (authorities, ledger) = (Arc::clone(&self.authorities), Arc::clone(&storage.ledger));
        EnrolmentService::new(authorities, ledger, own, genesis, client, wall)
    }

    /// Replaces the node's certificate before it expires: by a CA of this node, or of another one of its organisation.
    pub(crate) fn renewer(&self, ordering: &Ordering, enrolment: &EnrolmentService) -> Renewer {
        let (me, directory) = (self.me.clone(), Arc::clone(&ordering.directory));
        Renewer {
            data: self.data.clone(),
            identity: self.identity.clone(),
            ledger: Arc::clone(&ordering.storage.ledger),
            trust: Arc::clone(&self.organisations),
            enrolment: enrolment.clone(),
            others: Box::new(move || {
                let others = |member: &&Member| member.organisation == me.organisation && member.id != me.id;
                directory.members().iter().filter(others).map(|member| member.address.clone()).collect()
            }),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
