//! Which of the network's nodes this is.
//!
//! Its certificate says organisation and name, its number stands on the ledger. A node that has just joined has a
//! ledger that knows neither it nor, perhaps, its organisation: until then it believes `node.json`, which `ledgerd
//! join` wrote.

mod data_directory;

pub(crate) use data_directory::{check_member, nothing_here, unreadable_file, way_back};

use crate::ordering::directory::{Member, Part};
use crate::process::clock::wall;
use crate::storage::files::JOINED_FILE;
use ledger::Ledger;
use ledger::msp::{self, NodeRole};
use ledger::network::Genesis;
use ledger_api::tls::TlsIdentity;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::msp::{Msp, Msps, Usage};
use ledger_replica::REJOIN;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Largest such file, in bytes.
const JOINED_BYTES_MAX: usize = 64 * 1024;
/// How long a node that was removed waits for the change of members to be complete.
const LEAVE_TIME_MAX: Duration = Duration::from_secs(5);

/// The knowledge of a node about itself and the network before its ledger has it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Joined {
    /// The network.
    pub network: Hash,
    /// The node's number in the ordering protocol.
    pub id: u64,
    /// Its organisation.
    pub organisation: String,
    /// Its name.
    pub name: String,
    /// `HOST:PORT` at which the others reach it.
    pub address: String,
    /// `HOST:PORT` of nodes that have let it in, for what its ledger does not know yet.
    pub bootstrap: Vec<String>,
    /// SHA-256 of the CA certificate behind those nodes.
    pub ca: Hash,
}

impl Joined {
    /// Reads the file, if this node has joined. A founding node has none.
    ///
    /// # Errors
    /// [`Code::BadFile`] if it cannot be read.
    pub(crate) fn load(data: &Path) -> Result<Option<Self>, Rejection> {
        let path = data.join(JOINED_FILE);
        if !path.exists() {
            return Ok(None);
        }
        serde_json::from_slice(&ledger_base::durable::read(&path, JOINED_BYTES_MAX)?).map(Some).map_err(|error| {
            Rejection::new(Code::BadFile, format!("{} cannot be read", path.display()))
                .found(error.to_string())
                .next("restore it from a copy, or join again with another data directory")
        })
    }

    /// The file's content.
    pub(crate) fn to_bytes(&self) -> Result<Vec<u8>, Rejection> {
        serde_json::to_vec_pretty(self).map_err(|error| Rejection::new(Code::Internal, error.to_string()))
    }
}

/// The node's place in the network.
///
/// # Errors
/// [`Code::BadFile`] if the certificate is of no node, or of one whose number went to another data directory;
/// [`Code::WrongRole`], and why the certificate is not accepted.
pub(crate) fn own_membership(
    tls: &TlsIdentity,
    ledger: &Ledger,
    genesis: &Genesis,
    members: &[Member],
    joined: Option<&Joined>,
) -> Result<Member, Rejection> {
    let (organisation, name) = verified(tls, ledger, joined)?;
    if let Some(joined) = joined.filter(|joined| joined.organisation != organisation || joined.name != name) {
        return Err(Rejection::new(Code::BadFile, "node.pem and node.json belong to different nodes")
            .found(format!("the certificate of {organisation}/{name} in node.pem"))
            .wanted(format!("the certificate of {}/{}, which node.json names", joined.organisation, joined.name))
            .next("put the files of one node together; each node has its own data directory"));
    }
    let own = joined;
    let expected = own.map(|own| own.id).or_else(|| genesis.node(&organisation, &name).map(|node| node.id));
    let records = msp::nodes(&**ledger.state())?;
    if records.iter().any(|record| Some(record.id) == expected && record.role == NodeRole::Removed) {
        return Err(no_member(&format!("{organisation}/{name}")));
    }
    match members.iter().find(|member| member.organisation == organisation && member.name == name) {
        Some(known) if expected == Some(known.id) => Ok(known.clone()),
        // Numbers only grow: this ledger stands before the block in which the node got its own.
        Some(known) if own.is_some_and(|own| own.id > known.id) => {
            own.map(Member::from).ok_or_else(|| no_member(&name))
        }
        Some(known) => Err(Rejection::new(Code::BadFile, "another data directory has replaced this one")
            .found(format!("node {} here, node {} on the ledger", expected.unwrap_or_default(), known.id))
            .wanted(format!("the data directory of node {}", known.id))
            .next("start the node with that directory, or join again under another name")),
        None => own.map(|own| own.into()).ok_or_else(|| {
            let known: Vec<_> =
                members.iter().map(|member| format!("{}/{}", member.organisation, member.name)).collect();
            Rejection::new(Code::BadFile, "the node's certificate belongs to no node of the network")
                .found(format!("{organisation}/{name}"))
                .wanted(format!("one of {}", known.join(", ")))
                .next("ledgerctl network invite --node NAME creates a token for ledgerd join")
        }),
    }
}

/// Waits until the ledger says that this node belongs to the network no more: it must not serve on from what it knew.
pub(crate) async fn removed(me: Member, mut members: watch::Receiver<Arc<[Member]>>) -> Rejection {
    let stays = |members: &Arc<[Member]>| members.iter().any(|member| member.id == me.id && member.wanted.is_some());
    let is_gone = |members: &Arc<[Member]>| !members.iter().any(|member| member.id == me.id);
    // A newcomer's ledger does not know it at first.
    if members.wait_for(stays).await.is_err() || members.wait_for(|members| !stays(members)).await.is_err() {
        return std::future::pending().await;
    }
    // The others need it for the change itself, and may not tell it that it is complete.
    let _gone_or_late = tokio::time::timeout(LEAVE_TIME_MAX, members.wait_for(is_gone)).await;
    no_member(&me.full_name())
}

fn no_member(name: &str) -> Rejection {
    Rejection::new(Code::NotAMember, format!("{name} was removed from the network"))
        .next(format!("to bring it back as a new node: {REJOIN}"))
}

impl From<&Joined> for Member {
    fn from(joined: &Joined) -> Self {
        let Joined { id, organisation, name, address, .. } = joined.clone();
        Self { id, name, organisation, address, wanted: Some(Part::Learner), actual: None }
    }
}

/// Organisation and name in the own certificate, checked as the others will check it. An organisation that the ledger
/// does not know yet is the own one: then the root beside the certificate must vouch for it.
fn verified(tls: &TlsIdentity, ledger: &Ledger, joined: Option<&Joined>) -> Result<(String, String), Rejection> {
    let own = tls.own();
    let (certificate, presented) =
        own.chain.split_first().ok_or_else(|| Rejection::new(Code::BadFile, "node.pem contains no certificate"))?;
    let stranger = |_: &&Joined| ledger.msps().verify_for(Usage::Server, certificate, presented, wall()).is_err();
    let newcomer = joined.filter(|joined| ledger.msps().get(&joined.organisation).is_none()).filter(stranger);
    let identity = match newcomer {
        Some(joined) => {
            let mut msps = Msps::new();
            msps.insert(Msp::new(&joined.organisation, presented, &[] as &[&[u8]])?)?;
            msps.verify_for(Usage::Server, certificate, &[], wall())?
        }
        None => ledger.msps().verify_for(Usage::Server, certificate, presented, wall())?,
    };
    if identity.role != Role::Node {
        return Err(Rejection::new(Code::WrongRole, "the node's certificate does not have the role of a node")
            .found(format!("{} with role {}", identity.id(), identity.role))
            .wanted("role node"));
    }
    Ok((identity.organisation, identity.name))
}
