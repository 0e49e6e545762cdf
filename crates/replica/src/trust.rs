//! Whether a snapshot is believed: who attests it.
//!
//! Organisations are counted by the network that this node knew: by its own ledger, which is the genesis for a newcomer.
//! A snapshot is believed if nodes of two of these organisations attest its content, or of one, if the node knows only
//! one. If the snapshot itself has two organisations, two of those must attest it, too. So what a snapshot says about the network makes nothing easier: an
//! organisation that declares itself alone, or declares others that nobody knows, deceives nobody who knew more.
//!
//! A newcomer with a join token trusts the organisation whose CA the token names. For a snapshot from there it needs that
//! organisation, or another that it knows, and two by the snapshot itself. So it is deceived only if two organisations
//! lie together, one of which it trusts. An attestation is a transaction that the node signed, so whoever hands it over
//! cannot change it.

use crate::REJOIN;
use bytes::Bytes;
use ledger::msp::{Attestation, NodeRole};
use ledger::network::FoundingOrganisation;
use ledger::transaction::Transaction;
use ledger::{Ledger, msp};
use ledger_base::hash::Hash;
use ledger_base::mutation::Mutation;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::{Msp, Msps};
use ledger_identity::{Identity, Role};
use ledger_storage::snapshot::{Installer, Manifest, Snapshot, Snapshots};
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

/// The organisations that a node knows.
#[derive(Clone, Copy, Debug)]
pub enum Known<'a> {
    /// The members of the network by its own ledger.
    Members(&'a Msps),
    /// The same, and the one that vouches for the node which offers the snapshot, by the join token.
    Vouched(&'a Msps),
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
                tracing::debug!(code = reason.code.name(), %reason, "signed state rejected");
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
            _ => return Err(other("not a call of msp attest")),
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

    /// Decides about a snapshot by the organisations that this node knows, and those of the network by the snapshot itself.
    ///
    /// # Errors
    /// [`Code::Untrusted`] with who attests it and who would have to.
    pub fn accept(
        &self,
        attested: &[Attested],
        (known, declared): (Known<'_>, &Msps),
        revoked: &dyn Fn(&Identity) -> bool,
    ) -> Result<(), Rejection> {
        let (trusted, least) = match known {
            Known::Members(msps) => (msps, msps.iter().count()),
            Known::Vouched(msps) => (msps, 1),
        };
        let by = self.attested_by(attested, declared, revoked);
        let known = self.attested_by(attested, trusted, revoked);
        let (wanted, least) = (declared.iter().count().min(enough()), least.clamp(1, enough()));
        if by.len() >= wanted && known.len() >= least {
            return Ok(());
        }
        let found = format!("signed by {}; this node trusts {} of them", joined(by), joined(known));
        Err(Rejection::new(
            Code::Untrusted,
            format!("too few trusted nodes have signed the snapshot of height {}", self.height),
        )
        .found(found)
        .wanted(format!("nodes of {} organisations, {least} of which this node trusts", wanted.max(least)))
        .next(format!(
            "wait some seconds, until the nodes have signed it; if the organisations that this node trusted have \
                 left the network: {REJOIN}"
        )))
    }
}

/// Organisations that must attest, if there are so many.
fn enough() -> usize {
    if ledger_base::mutation::active(Mutation::BelieveOneOrganisation) { 1 } else { ORGANISATIONS_MIN }
}

fn joined(names: BTreeSet<String>) -> String {
    if names.is_empty() { "none".to_owned() } else { names.into_iter().collect::<Vec<_>>().join(" and ") }
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
            return Err(Rejection::new(Code::WrongNetwork, "the snapshot is not usable here")
                .found(format!("height {} of network {}", manifest.height, manifest.network))
                .wanted(format!("above height {} of network {network}", tip.height)));
        }
        let claim = Claim { network, height: manifest.height, time: manifest.tip.time, content: manifest.content() };
        let trial = Self { ledger: Arc::clone(ledger), claim, attested, vouched };
        let members = ledger.msps();
        let known = trial.claim.attested_by(&trial.attested, &members, &|identity| trial.is_revoked(identity));
        let least = members.iter().count().clamp(1, enough());
        if vouched.is_none() && known.len() < least {
            return Err(Rejection::new(Code::Untrusted, "too few known organisations have signed the snapshot")
                .found(format!("height {}, signed by {}", claim.height, joined(known)))
                .wanted(format!("nodes of {least} organisations known to this node"))
                .next("wait some seconds, until the nodes have signed it"));
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
        let members = self.ledger.msps();
        let revoked = |identity: &Identity| self.is_revoked(identity);
        match self.vouched {
            None => self.claim.accept(&self.attested, (Known::Members(&members), &declared), &revoked),
            Some(ca) => {
                let trusted = with_ca(&members, &declared, ca)?;
                self.claim.accept(&self.attested, (Known::Vouched(&trusted), &declared), &revoked)
            }
        }
    }

    fn is_revoked(&self, identity: &Identity) -> bool {
        self.ledger.check_revoked(identity).is_err()
    }
}

/// The organisations of the network, by the snapshot itself.
fn declared(snapshot: &Snapshot) -> Result<Msps, Rejection> {
    let mut msps = Msps::new();
    for (_, value) in snapshot.pairs(ORGANISATION_KEYS, ORGANISATIONS_MAX)? {
        let organisation: FoundingOrganisation = serde_json::from_slice(&value).map_err(|error| {
            Rejection::new(Code::Malformed, format!("an organisation in the snapshot cannot be read: {error}"))
        })?;
        msps.insert(organisation.msp()?).map_err(Rejection::from)?;
    }
    Ok(msps)
}

/// The organisations that this node trusts: those it knows, and the one behind the CA that its join token names.
fn with_ca(known: &Msps, declared: &Msps, ca: Hash) -> Result<Msps, Rejection> {
    let mut trusted = known.clone();
    let is_named = |msp: &&Msp| msp.roots().any(|root| Hash::of(&[root]) == ca);
    if let Some(named) = declared.iter().find(is_named).filter(|named| trusted.get(named.organisation()).is_none()) {
        trusted.insert(named.clone()).map_err(Rejection::from)?;
    }
    Ok(trusted)
}

/// The height up to which this node may drop its blocks: its own oldest snapshot, and the newest one that two organisations
/// attest, hold what follows from them. So a node that comes back finds either the blocks or a snapshot that it believes. The
/// second one is kept from now on. With little space left on the disk (`is_scarce`), the own snapshot is enough.
///
/// # Errors
/// A fault of the store.
pub fn needless(ledger: &Ledger, snapshots: &Snapshots, is_scarce: bool) -> Result<Option<u64>, Rejection> {
    let shared = shared(ledger)?.map_or(0, |(height, _)| height);
    snapshots.pin(shared);
    let oldest = snapshots.oldest().map(|snapshot| snapshot.manifest().height);
    Ok(if is_scarce { oldest } else { oldest.map(|oldest| oldest.min(shared)) })
}

/// The snapshot that this node gives to others: the newest one that two organisations attest. While it has none, its newest.
///
/// # Errors
/// A fault of the store.
pub fn given(ledger: &Ledger, snapshots: &Snapshots) -> Result<Option<Arc<Snapshot>>, Rejection> {
    let shared = shared(ledger)?;
    let shared =
        shared.and_then(|(height, content)| snapshots.get(height).filter(|snapshot| snapshot.content() == content));
    Ok(shared.or_else(|| snapshots.newest()))
}

/// Height and content of the newest snapshot that nodes of two organisations attest, or of one if only one has nodes. A node
/// that was away longer than blocks are kept can believe this one.
fn shared(ledger: &Ledger) -> Result<Option<(u64, Hash)>, Rejection> {
    let nodes = msp::nodes(&**ledger.state())?;
    let present = nodes.iter().filter(|node| node.role != NodeRole::Removed);
    let organisations: BTreeSet<_> = present.map(|node| node.organisation.as_str()).collect();
    let records = msp::attestations(&**ledger.state())?;
    Ok(msp::shared_snapshot(&records, organisations.len().min(ORGANISATIONS_MIN)))
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
        let same = |said: &&Attestation| said.attest.height == height && said.attest.content == Some(content);
        let Some(said) = record.snapshots().find(same) else { continue };
        let Some(place) = ledger.transaction(&said.transaction)? else { continue };
        let Some(transactions) = block(place.height)? else { continue };
        let Some(transaction) = transactions.get(place.index as usize) else { continue };
        let creator = Transaction::decode(transaction.clone())?.creator();
        let Some(certificate) = ledger.certificate(&creator)? else { continue };
        attested.push(Attested { transaction: transaction.clone(), certificate });
    }
    Ok(attested)
}
