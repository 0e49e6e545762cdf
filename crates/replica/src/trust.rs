//! Whether a snapshot is believed: who attests it.
//!
//! A snapshot is believed if nodes of two organisations that belong to the network by the snapshot itself attest its
//! content (of one, if there is only one). This node must also trust one of the attesting organisations already: one
//! that stands on its own ledger, or in its genesis. So a newcomer is deceived only if two organisations lie together,
//! one of which it knows. An attestation is a transaction that the node signed, so whoever hands it over cannot change
//! it.

use bytes::Bytes;
use ledger::network::FoundingOrganisation;
use ledger::transaction::Transaction;
use ledger::{Ledger, msp};
use ledger_hash::Hash;
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::{Msp, Msps};
use ledger_identity::{Identity, Role};
use ledger_mutation::Mutation;
use ledger_rejection::{Code, Rejection};
use ledger_storage::snapshot::{Installer, Manifest, Snapshot};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Attestations that are looked at: one of each node that a network may have.
pub const ATTESTED_MAX: usize = ledger::members::NODES_MAX;
/// Organisations that must attest, if there are so many.
const ORGANISATIONS_MIN: usize = 2;
/// Where the organisations stand in the world state.
const ORGANISATION_KEYS: &[u8] = b"msp\0organisation/";
/// Organisations that are looked at.
const ORGANISATIONS_MAX: usize = 1000;

/// A transaction `msp attest`, and the certificate of the node that signed it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Attested {
    /// The signed bytes.
    pub transaction: Bytes,
    /// In DER.
    pub certificate: Bytes,
}

/// The content that is to be attested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Claim {
    /// Name of the network.
    pub network: Hash,
    /// Height of the snapshot.
    pub height: u64,
    /// Block time there, microseconds since the UNIX epoch.
    pub time: u64,
    /// The hash of the manifest.
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
    pub fn attested_by(
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
            (msp::NAME, "attest", [statement]) => read(statement)?,
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
    pub fn accept(
        &self,
        attested: &[Attested],
        trusted: &Msps,
        declared: &Msps,
        revoked: &dyn Fn(&Identity) -> bool,
    ) -> Result<(), Rejection> {
        let by = self.attested_by(attested, declared, revoked);
        let known = self.attested_by(attested, trusted, revoked);
        let enough = if ledger_mutation::active(Mutation::BelieveOneOrganisation) { 1 } else { ORGANISATIONS_MIN };
        let wanted = declared.iter().count().min(enough);
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

/// A snapshot that somebody offers, before it is believed.
#[derive(Clone)]
pub struct Trial {
    ledger: Arc<Ledger>,
    claim: Claim,
    attested: Vec<Attested>,
    /// The CA that the join token of this node names, if the token vouches for the node that offers the snapshot.
    vouched: Option<Hash>,
}

impl Trial {
    /// Looks at a manifest and the attestations of it: is it worth fetching?
    ///
    /// # Errors
    /// [`Code::WrongNetwork`] if it is of no use for this ledger; [`Code::Untrusted`] if no organisation that this node
    /// trusts attests it.
    pub fn begin(
        ledger: &Arc<Ledger>,
        manifest: &Manifest,
        attested: Vec<Attested>,
        vouched: Option<Hash>,
    ) -> Result<Self, Rejection> {
        let (network, tip) = (ledger.network(), ledger.tip());
        if manifest.network != network || manifest.height <= tip.height {
            return Err(Rejection::new(Code::WrongNetwork, "the snapshot is of no use here")
                .found(format!("height {} of network {}", manifest.height, manifest.network))
                .wanted(format!("above height {} of network {network}", tip.height)));
        }
        let claim = Claim { network, height: manifest.height, time: manifest.tip.time, content: manifest.content() };
        let trial = Self { ledger: Arc::clone(ledger), claim, attested, vouched };
        let known = trial.claim.attested_by(&trial.attested, &ledger.msps(), &|identity| trial.is_revoked(identity));
        if vouched.is_none() && known.is_empty() {
            return Err(Rejection::new(Code::Untrusted, "no organisation that this node trusts attests the snapshot")
                .found(format!("height {}, {} attestations", claim.height, trial.attested.len()))
                .wanted("a node of an organisation that this node knows")
                .next("wait until the nodes have attested it, which takes some seconds"));
        }
        Ok(trial)
    }

    /// Concludes when all chunks are there: keeps the snapshot if it is believed, and throws it away if not.
    ///
    /// # Errors
    /// As [`Claim::accept`]; a fault of the disk.
    pub fn conclude(&self, installer: Installer<'_>) -> Result<Arc<Snapshot>, Rejection> {
        match installer.complete().and_then(|snapshot| self.accept(&snapshot)) {
            Ok(()) => installer.accept(),
            Err(refused) => {
                installer.discard()?;
                Err(refused)
            }
        }
    }

    fn accept(&self, snapshot: &Snapshot) -> Result<(), Rejection> {
        let declared = declared(snapshot)?;
        let trusted = with_ca(&self.ledger.msps(), &declared, self.vouched)?;
        self.claim.accept(&self.attested, &trusted, &declared, &|identity| self.is_revoked(identity))
    }

    fn is_revoked(&self, identity: &Identity) -> bool {
        self.ledger.check_revoked(identity).is_err()
    }
}

/// The organisations of the network, by the snapshot itself.
fn declared(snapshot: &Snapshot) -> Result<Msps, Rejection> {
    let mut msps = Msps::new();
    for (_, value) in snapshot.pairs(ORGANISATION_KEYS, ORGANISATIONS_MAX)? {
        let read = serde_json::from_slice(&value);
        let FoundingOrganisation { name, roots, intermediates } = read.map_err(|error| {
            Rejection::new(Code::Malformed, format!("an organisation in the snapshot cannot be read: {error}"))
        })?;
        let msp = Msp::new(&name, &roots, &intermediates).map_err(Rejection::from)?;
        msps.insert(msp).map_err(Rejection::from)?;
    }
    Ok(msps)
}

/// The organisations that this node trusts: those it knows, and the one behind the CA that its join token names.
fn with_ca(known: &Msps, declared: &Msps, ca: Option<Hash>) -> Result<Msps, Rejection> {
    let mut trusted = known.clone();
    let is_named = |msp: &&Msp| msp.roots().any(|root| Some(Hash::of(&[root])) == ca);
    if let Some(named) = declared.iter().find(is_named).filter(|named| trusted.get(named.organisation()).is_none()) {
        trusted.insert(named.clone()).map_err(Rejection::from)?;
    }
    Ok(trusted)
}

/// The transactions on the ledger that attest a snapshot; a node gives them to others with its manifest. `block` reads
/// the transactions of a block, if it is still kept.
///
/// # Errors
/// A fault of the store.
pub fn attestations(
    ledger: &Ledger,
    snapshot: &Snapshot,
    mut block: impl FnMut(u64) -> Result<Option<Vec<Bytes>>, Rejection>,
) -> Result<Vec<Attested>, Rejection> {
    let (height, content) = (snapshot.manifest().height, snapshot.content());
    let mut attested = Vec::new();
    for record in msp::attestations(&**ledger.state())? {
        let said = record.snapshot.filter(|said| said.attest.height == height && said.attest.content == Some(content));
        let Some(said) = said else { continue };
        let Some(place) = ledger.transaction(&said.transaction)? else { continue };
        let Some(transactions) = block(place.height)? else { continue };
        let Some(transaction) = transactions.get(place.index as usize) else { continue };
        let creator = Transaction::decode(transaction.clone())?.creator();
        let Some(certificate) = ledger.certificate(&creator)? else { continue };
        attested.push(Attested { transaction: transaction.clone(), certificate });
    }
    Ok(attested)
}
