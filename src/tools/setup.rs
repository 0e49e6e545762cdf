//! Founding a network: its organisations' CAs, its genesis, and a data directory for each of its first nodes.
//!
//! | in a node's data directory | content |
//! |---|---|
//! | `genesis.json` | what all nodes agree on; its hash names the network |
//! | `node.pem` | the node's certificate and the root above it, so that clients can pin the root's fingerprint |
//! | `node.key` | its private key, PKCS #8, mode 0600 |
//! | `ca/<Org>/` | the CA of an organisation (see [`crate::trust::ca`]), on one node: the organisation's first, or the network's first if the organisation runs none |

mod init;
mod issue;
mod settings;

pub use init::{InitOptions, init};
pub use issue::issue;
pub(crate) use settings::{Settings, public_address};

use crate::storage::files::{CERTIFICATE_FILE, KEY_FILE};
use crate::trust::ca;
use crate::trust::ca::{CertificateAuthority, Issued};
use bytes::Bytes;
use ledger::Rules;
use ledger::network::{FoundingNode, FoundingOrganisation, Genesis};
use ledger_base::durable::{PUBLIC_MODE, SECRET_MODE};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::KeyKind;
use ledger_identity::{Role, check_name};
use ledger_storage::layout::GENESIS_FILE;
use ring::rand::{SecureRandom, SystemRandom};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The kind of nodes' keys. They are seen by every client's TLS, and BoringSSL (gRPC in C++, Python, Ruby and others)
/// accepts no server with an Ed25519 key.
pub(crate) const NODE_KEY: KeyKind = KeyKind::P256;

/// A network to be founded.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkPlan {
    /// A name for people.
    pub label: String,
    /// Its organisations.
    pub organisations: Vec<PlannedOrganisation>,
    /// Its first nodes; they are numbered in this order.
    pub nodes: Vec<PlannedNode>,
    /// Every node makes a snapshot of the world state at heights that this number divides.
    pub snapshot_every: u64,
}

/// An organisation of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedOrganisation {
    /// Name, e.g. `Org1`.
    pub name: String,
    /// The kind of its CA's key.
    pub key: KeyKind,
}

/// A node of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedNode {
    /// Name, e.g. `node1`.
    pub name: String,
    /// The organisation that runs it.
    pub organisation: String,
    /// Its data directory, which must not exist yet.
    pub data: PathBuf,
    /// `HOST:PORT` at which clients and other nodes reach it.
    pub address: String,
    /// Does it order (voter), or only follow (learner)?
    pub voter: bool,
}

/// A network that was founded.
#[derive(Clone, Debug)]
pub struct Founded {
    /// The founding data that all nodes agree on.
    pub genesis: Genesis,
    /// The same as its document, in every node's `genesis.json`.
    pub document: Bytes,
    /// The network's name: the hash of the document.
    pub network: Hash,
    /// The CA of each organisation, in the order of the plan.
    pub authorities: Vec<FoundedAuthority>,
}

/// Where an organisation's CA is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundedAuthority {
    /// The organisation.
    pub organisation: String,
    /// The CA's directory, for [`CertificateAuthority::open`].
    pub directory: PathBuf,
    /// SHA-256 of its root certificate, which clients pin at first contact.
    pub fingerprint: Hash,
}

/// Founds a network: all data directories, or none. `now` is in microseconds since the UNIX epoch.
///
/// # Errors
/// [`Code::BadConfiguration`] if the plan contradicts itself, [`Code::BadFile`] if a data directory exists, a failing
/// disk. The files made until then are removed.
pub fn found(plan: &NetworkPlan, now: u64) -> Result<Founded, Rejection> {
    found_for(plan, CertificateAuthority::CERTIFICATE_DAYS, now)
}

/// As [`found`], with certificates of nodes that are valid for this number of days.
///
/// # Errors
/// As [`found`].
pub(crate) fn found_for(plan: &NetworkPlan, certificate_days: u32, now: u64) -> Result<Founded, Rejection> {
    check(plan)?;
    let mut made = Made::default();
    let mut staged = plan.nodes.iter().map(|node| made.stage(node)).collect::<Result<Vec<_>, _>>()?;
    let founded = fill(plan, &staged, certificate_days, now)?;
    for (node, stage) in plan.nodes.iter().zip(staged.drain(..)) {
        made.publish(stage, &node.data)?;
    }
    made.keep();
    Ok(founded)
}

/// Checks a plan as far as nothing needs to be made for it.
fn check(plan: &NetworkPlan) -> Result<(), Rejection> {
    let wrong = |message: String| Rejection::new(Code::BadConfiguration, message);
    let organisations: BTreeSet<_> = plan.organisations.iter().map(|organisation| &organisation.name).collect();
    if organisations.len() < plan.organisations.len() {
        return Err(wrong("two organisations have the same name".into()).next("give each organisation its own name"));
    }
    let (mut names, mut directories, mut addresses) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
    for node in &plan.nodes {
        let named = &node.name;
        check_name(named)
            .map_err(|error| wrong(format!("the node name {named:?} is not usable")).found(error.to_string()))?;
        if !organisations.contains(&node.organisation) {
            return Err(wrong(format!("node {named:?} is of an unknown organisation"))
                .found(format!("organisation {:?}", node.organisation))
                .wanted(format!("one of {organisations:?}")));
        }
        if !names.insert((&node.organisation, named)) {
            return Err(wrong(format!("two nodes of {} are named {named:?}", node.organisation)));
        }
        if !directories.insert(&node.data) {
            return Err(wrong(format!("two nodes have the data directory {}", node.data.display())));
        }
        if !addresses.insert(&node.address) {
            return Err(wrong(format!("two nodes have the address {}", node.address)));
        }
        if fs::symlink_metadata(&node.data).is_ok() {
            return Err(Rejection::new(Code::BadFile, format!("{} exists already", node.data.display()))
                .wanted(format!("a data directory for node {named:?} that does not exist yet"))
                .next("choose another directory, or move this one away; existing data are never overwritten"));
        }
    }
    if !plan.nodes.iter().any(|node| node.voter) {
        return Err(wrong("the network would have no voter".into())
            .found(format!("{} nodes, none of them a voter", plan.nodes.len()))
            .wanted("at least one voter"));
    }
    Ok(())
}

/// Writes everything into the staged directories.
fn fill(plan: &NetworkPlan, staged: &[TempDir], certificate_days: u32, now: u64) -> Result<Founded, Rejection> {
    let mut authorities = BTreeMap::new();
    let mut founded = Vec::new();
    let mut organisations = Vec::new();
    for organisation in &plan.organisations {
        let name = &organisation.name;
        let carrier = plan.nodes.iter().position(|node| node.organisation == *name).unwrap_or(0);
        let (Some(stage), Some(node)) = (staged.get(carrier), plan.nodes.get(carrier)) else { continue };
        let inside = Path::new(ca::DIRECTORY).join(name);
        let mut authority = CertificateAuthority::create(&stage.path().join(&inside), name, organisation.key, now)?;
        authority.set_days(certificate_days, CertificateAuthority::SECRET_DAYS);
        founded.push(FoundedAuthority {
            organisation: name.clone(),
            directory: node.data.join(inside),
            fingerprint: authority.fingerprint(),
        });
        organisations.push(FoundingOrganisation::below(name, Bytes::copy_from_slice(authority.root())));
        authorities.insert(name, authority);
    }
    let mut salt = Hash::ZERO;
    SystemRandom::new()
        .fill(&mut salt.0)
        .map_err(|_| Rejection::new(Code::Internal, "the system's source of randomness failed: no salt"))?;
    let nodes = (1..).zip(&plan.nodes).map(|(id, node)| FoundingNode {
        id,
        name: node.name.clone(),
        organisation: node.organisation.clone(),
        address: node.address.clone(),
        voter: node.voter,
    });
    let label = plan.label.clone();
    let (nodes, snapshot_every) = (nodes.collect(), plan.snapshot_every);
    let genesis =
        Genesis { rules: Rules::NEWEST.number(), label, created: now, salt, organisations, nodes, snapshot_every };
    let document = genesis.to_bytes()?;
    let (genesis, network) = Genesis::from_bytes(&document)?;
    for (node, stage) in plan.nodes.iter().zip(staged) {
        let Some(authority) = authorities.get_mut(&node.organisation) else { continue };
        let issued = authority.issue(&node.name, Role::Node, BTreeMap::new(), NODE_KEY, now)?;
        write_node(stage.path(), &document, &issued)?;
    }
    Ok(Founded { genesis, document, network, authorities: founded })
}

fn write_node(directory: &Path, document: &[u8], issued: &Issued) -> Result<(), Rejection> {
    ledger_base::durable::create(&directory.join(GENESIS_FILE), document, PUBLIC_MODE)?;
    ledger_base::durable::create(&directory.join(CERTIFICATE_FILE), issued.chain_pem().as_bytes(), PUBLIC_MODE)?;
    ledger_base::durable::create(&directory.join(KEY_FILE), issued.key.to_pkcs8_pem().as_bytes(), SECRET_MODE)?;
    ledger_base::durable::sync_directory(directory)
}

/// The files made so far; dropped unless kept, they are removed again.
#[derive(Default)]
struct Made {
    /// Directories above the data directories that were missing, outermost first.
    parents: Vec<PathBuf>,
    /// Data directories in their place.
    published: Vec<PathBuf>,
}

impl Made {
    /// A directory beside the data directory, on the same file system, that only its owner may enter.
    fn stage(&mut self, node: &PlannedNode) -> Result<TempDir, Rejection> {
        let parent = parent(&node.data);
        let missing: Vec<_> =
            parent.ancestors().filter(|path| !path.as_os_str().is_empty() && !path.exists()).collect();
        self.parents.extend(missing.into_iter().rev().map(Path::to_owned));
        fs::create_dir_all(parent).map_err(|error| ledger_base::durable::failed("make directory", parent, &error))?;
        tempfile::Builder::new()
            .prefix(".founding-")
            .permissions(Permissions::from_mode(0o700))
            .tempdir_in(parent)
            .map_err(|error| ledger_base::durable::failed("make a directory in", parent, &error))
    }

    /// Puts a staged directory in its place.
    fn publish(&mut self, stage: TempDir, data: &Path) -> Result<(), Rejection> {
        // An empty directory that appeared meanwhile would be replaced silently.
        if fs::symlink_metadata(data).is_ok() {
            return Err(ledger_base::durable::failed(
                "make directory",
                data,
                &std::io::ErrorKind::AlreadyExists.into(),
            ));
        }
        fs::rename(stage.path(), data).map_err(|error| ledger_base::durable::failed("make directory", data, &error))?;
        let _ = stage.keep();
        self.published.push(data.to_owned());
        ledger_base::durable::sync_directory(parent(data))
    }

    fn keep(mut self) {
        self.parents.clear();
        self.published.clear();
    }
}

impl Drop for Made {
    fn drop(&mut self) {
        for directory in self.published.drain(..) {
            let _ = fs::remove_dir_all(directory);
        }
        for directory in self.parents.drain(..).rev() {
            // Fails if somebody else has put something there; then it stays.
            let _ = fs::remove_dir(directory);
        }
    }
}

/// The directory that holds a path; `.` for a bare name.
fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or_else(|| Path::new("."))
}

#[cfg(test)]
mod tests;
