//! `ledgerd rejoin`: a node whose blocks are damaged or lost, but whose certificate is there, comes back as a new node.
//!
//! Its number must not vote again: others count on what it has promised, and it has forgotten that. So it asks the
//! ledger for a new one, as itself, and fetches everything from the others. It needs no token and no CA: a node that
//! carries the CA of its organisation comes back in the same way, and the CA stays where it is.
//!
//! A node that a strict certificate contradicts fetches and verifies the certified branch first, and keeps its own one for
//! auditors ([`super::branches`]).
//!
//! Interrupted, it is finished by the same command, which asks for another number: numbers cost nothing. Until then a mark
//! keeps the node from starting: without its blocks, a founder would begin the network again, alone. The mark names the directory
//! into which things are moved, so that another try moves the rest there.

use super::branches::{self, DEAD_PREFIX, Lost};
use super::{REMOVED, Record, answers, enter, records};
use crate::node::NodeBuilder;
use crate::peers::quorum_certificates::set_proofs_aside;
use crate::process::config::Config;
use crate::process::terminal::asked;
use crate::storage::files::JOINED_FILE;
use crate::storage::files::REJOINING_FILE;
use crate::storage::files::RESTORED_FILE;
use crate::storage::files::{CERTIFICATE_FILE, KEY_FILE};
use crate::storage::files::{CONFIRMED_FILE, CONTRADICTED_FILE, DIVERGED_FILE, contradicted_by};
use crate::tools::backup::CopiedBlocks;
use crate::tools::setup::public_address;
use crate::trust::membership::Joined;
use crate::trust::membership::unreadable_file;
use ledger::network::{FoundingOrganisation, GENESIS_BYTES_MAX, Genesis};
use ledger_api::tls::{ServerTrust, TlsIdentity};
use ledger_api::{Client, Credentials, Options};
use ledger_base::durable::PUBLIC_MODE;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use ledger_identity::msp::{Msp, Msps, Usage};
use ledger_identity::{Identity, Role};
use ledger_storage::disk::RealDisk;
use ledger_storage::layout::{
    AUDIT_DIRECTORY, BLOCKS_DIRECTORY, GENESIS_FILE, RESULTS_DIRECTORY, SNAPSHOTS_DIRECTORY, STATE_DIRECTORY,
};
use ledger_storage::state::{SledStore, State};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Files that follow from the blocks, hold them, or say what others had. The state goes last: another try needs the
/// organisations in it.
const SET_ASIDE: [&str; 9] = [
    CONTRADICTED_FILE,
    BLOCKS_DIRECTORY,
    RESULTS_DIRECTORY,
    SNAPSHOTS_DIRECTORY,
    AUDIT_DIRECTORY,
    DIVERGED_FILE,
    CONFIRMED_FILE,
    RESTORED_FILE,
    STATE_DIRECTORY,
];

/// Beginning of the name of the directory that keeps damaged files.
const DAMAGED_PREFIX: &str = "damaged";
/// The line of the mark that names the directory into which things are moved.
const MARK_ASIDE: &str = "set aside: ";
/// Longest mark, in bytes.
const MARK_BYTES_MAX: usize = 4096;

/// The arguments of `ledgerd rejoin`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RejoinOptions {
    /// The node's configuration.
    #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
    pub(crate) config: PathBuf,
    /// Another node of the network; may be given several times. The nodes through which this one joined are asked in
    /// any case.
    #[arg(long, value_name = "HOST:PORT")]
    node: Vec<String>,
    /// A backup of any node of the network, whose blocks are used and trusted. For a node whose organisation has no
    /// other node left, if no majority serves them.
    #[arg(long, value_name = "DIR")]
    blocks: Option<PathBuf>,
    /// The node from which the restored backup was made is permanently lost: do not ask.
    #[arg(long)]
    original_is_gone: bool,
}

/// Rejoins; answers with what to tell the user.
///
/// # Errors
/// [`Code::BadFile`] if the directory is in use, or its certificate cannot be used; [`Code::Unreachable`] if no other
/// node answers; [`Code::AlreadyExists`] if this is the backup of a node that runs, [`Code::LastOne`] if it was not agreed that it is
/// gone; the ledger's own refusal, for example that this is the last voter.
pub(crate) async fn rejoin(
    builder: &NodeBuilder,
    options: &RejoinOptions,
    config: &Config,
) -> Result<String, Rejection> {
    let data = &config.data;
    let begun = begun(data)?;
    let lost = match &begun {
        // The other branch was verified before the mark was made.
        Some(_) => None,
        None => other_branch(builder, options, config).await?,
    };
    let blocks = data.join(BLOCKS_DIRECTORY);
    // Held until the end, so that no node starts meanwhile.
    let _stopped = RealDisk::open(&blocks).map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot use {}", blocks.display()))
            .found(error.to_string())
            .wanted("the data directory of a node that is stopped")
            .next("stop the node, and check the permissions of the directory")
    })?;
    let (genesis, network) = Genesis::from_bytes(
        &ledger_base::durable::read(&data.join(GENESIS_FILE), GENESIS_BYTES_MAX)
            .map_err(|refused| unreadable_file(config, refused))?,
    )?;
    let copied = options.blocks.as_deref().map(|from| CopiedBlocks::verify(builder, from, data)).transpose()?;
    let joined = Joined::load(data)?;
    let tls = TlsIdentity::from_pem_files(&data.join(CERTIFICATE_FILE), &data.join(KEY_FILE))
        .map_err(|error| unreadable_file(config, Rejection::new(Code::BadFile, error.to_string())))?;
    let msps = Arc::new(organisations(&genesis, &tls, joined.as_ref(), data)?);
    let me = own(&tls, &msps)?;
    let founder = genesis.node(&me.organisation, &me.name);
    let before = [
        joined.as_ref().map(|joined| joined.address.clone()),
        Some(config.member.address.clone()).filter(|address| !address.is_empty()),
        founder.map(|founder| founder.address.clone()),
    ];
    let address = before.into_iter().flatten().next();
    let address = public_address(address.as_deref(), &config.listen, "ledgerd join TOKEN")?;

    let named = options.node.iter().cloned();
    let let_in = joined.iter().flat_map(|joined| joined.bootstrap.iter().cloned());
    let founders = genesis.nodes.iter().map(|node| node.address.clone());
    let mut others: Vec<String> = named.chain(let_in).chain(founders).filter(|other| *other != address).collect();
    let mut known = std::collections::BTreeSet::new();
    others.retain(|other| known.insert(other.clone()));
    if others.is_empty() {
        return Err(Rejection::new(Code::Unreachable, "this node has no address of another node of the network")
            .wanted("a node that has the blocks")
            .next(format!(
                "ledgerd rejoin --config {} --node HOST:PORT; without another node, restore {} from a copy",
                shell::path(&config.file),
                data.display()
            )));
    }
    let credentials = Credentials::new(network, tls.clone(), ServerTrust::Roots(Arc::clone(&msps)))?;
    let client = Client::connect_with(others.clone(), credentials, Options::default()).await?;
    if fs::symlink_metadata(data.join(RESTORED_FILE)).is_ok() {
        check_original(&client, (&me.organisation, &me.name), options.original_is_gone).await?;
    }
    // Whatever number is there, perhaps from a try that was interrupted: nobody knows what was done with it.
    let id = enter(&client, (&me.organisation, &me.name), &address, Ok).await?;
    let reached = reachable(&client, &msps, &address).await?;
    let joined = Joined {
        network,
        id,
        organisation: me.organisation.clone(),
        name: me.name.clone(),
        address,
        bootstrap: reached.0,
        ca: reached.1,
    };
    let name = match begun {
        Some(name) => name,
        None => begin(data, lost.as_ref())?,
    };
    ledger_base::durable::replace(&data.join(JOINED_FILE), &joined.to_bytes()?, PUBLIC_MODE)?;
    let (aside, is_dead) = (data.join(&name), name.starts_with(DEAD_PREFIX));
    set_aside(data, &aside, is_dead)?;
    if is_dead {
        branches::put(data)?;
    }
    // The branch that was verified has its own blocks.
    copied.filter(|_| !is_dead).map(|copied| copied.put(data)).transpose()?;
    unmark(data)?;
    let kept = match is_dead {
        true => branches::told(lost.as_ref(), &aside),
        false => format!("set aside  {}, to investigate the damage; the node does not need it\n", aside.display()),
    };
    Ok(format!(
        "node {0} is node {id} of network {1:?} now, a learner\n{2}\nnext:\n  ledgerd run --config {3}\n  ledgerctl \
         network promote {0}\nThe last command makes the node a voter once its log is up to date. With several \
         organisations, it prints the command\nwith which an admin of another one approves.",
        me.id(),
        genesis.label,
        kept,
        shell::path(&config.file)
    ))
}

/// A restored backup takes the place of its original, which loses its vote by that. So the original must be gone.
async fn check_original(client: &Client, (organisation, name): (&str, &str), is_gone: bool) -> Result<(), Rejection> {
    let records = records(client).await?;
    let of_name =
        |record: &&Record| record.role != REMOVED && record.organisation == organisation && record.name == name;
    let Some(original) = records.nodes.iter().find(of_name) else { return Ok(()) };
    let (full_name, Record { id, address, role, .. }) = (original.full_name(), original);
    if answers(address).await {
        return Err(Rejection::new(
            Code::AlreadyExists,
            format!("node {full_name} is running: its backup cannot replace it"),
        )
        .found(format!("node {id}, a {role}, answers at {address}"))
        .wanted("a permanently lost node")
        .next("keep the original, or stop it first; to inspect a backup: ledgerd verify DIR"));
    }
    if is_gone {
        return Ok(());
    }
    let facts =
        format!("node {full_name} is number {id} of the network, a {role}; this backup replaces it permanently");
    let refused = |wanted: &str| {
        Rejection::new(Code::LastOne, format!("the loss of the original of node {full_name} was not confirmed"))
            .found(facts.clone())
            .wanted(wanted)
            .next("ledgerd rejoin --original-is-gone")
    };
    match asked(std::slice::from_ref(&facts), "is the original permanently lost? type yes: ") {
        Some(true) => Ok(()),
        Some(false) => Err(refused("yes")),
        None => Err(refused("a terminal for the confirmation, or --original-is-gone")),
    }
}

/// Verifies the branch that contradicts this node, if one does.
async fn other_branch(
    builder: &NodeBuilder,
    options: &RejoinOptions,
    config: &Config,
) -> Result<Option<Lost>, Rejection> {
    let data = &config.data;
    let Some(branch) = contradicted_by(data)? else { return Ok(None) };
    let tls = TlsIdentity::from_pem_files(&data.join(CERTIFICATE_FILE), &data.join(KEY_FILE))
        .map_err(|error| unreadable_file(config, Rejection::new(Code::BadFile, error.to_string())))?;
    branches::verify(builder, config, &branch, &tls, &options.node).await.map(Some)
}

/// The directory into which a rejoin that was interrupted has moved things; none if none was.
fn begun(data: &Path) -> Result<Option<String>, Rejection> {
    let mark = data.join(REJOINING_FILE);
    if fs::symlink_metadata(&mark).is_err() {
        return Ok(None);
    }
    let text = ledger_base::durable::read(&mark, MARK_BYTES_MAX)?;
    let text = String::from_utf8_lossy(&text);
    let name = text.lines().find_map(|line| line.strip_prefix(MARK_ASIDE));
    let is_ours = |name: &&str| [DAMAGED_PREFIX, DEAD_PREFIX].iter().any(|prefix| name.starts_with(prefix));
    match name.filter(is_ours).filter(|name| !name.contains('/')) {
        Some(name) => Ok(Some(name.to_owned())),
        None => Err(Rejection::new(Code::BadFile, format!("{} cannot be read", mark.display()))
            .found(text.trim().to_owned())
            .wanted(format!("a line {MARK_ASIDE}NAME, as ledgerd rejoin writes it"))
            .next("copy the directory, and inspect what was moved to damaged-N or dead-branch-N")),
    }
}

/// Chooses a directory for what is set aside, and makes the mark that names it: from now on the node does not start until all is done.
fn begin(data: &Path, lost: Option<&Lost>) -> Result<String, Rejection> {
    let prefix = if lost.is_some() { DEAD_PREFIX } else { DAMAGED_PREFIX };
    // One without blocks is left from a try that had not begun to move.
    let free = |name: &String| lost.is_some() && !data.join(name).join(BLOCKS_DIRECTORY).exists();
    let names = (1..u32::MAX).map(|number| format!("{prefix}-{number}"));
    let name = names.into_iter().find(|name| !data.join(name).exists() || free(name));
    let name =
        name.ok_or_else(|| Rejection::new(Code::BadFile, format!("{} contains too many entries", data.display())))?;
    ledger_base::durable::create_directory(&data.join(&name))?;
    branches::keep_genesis(data, &data.join(&name))?;
    if let Some(lost) = lost {
        branches::write_list(&data.join(&name), lost)?;
    }
    let mark = format!("ledgerd rejoin started here\n{MARK_ASIDE}{name}\n");
    ledger_base::durable::replace(&data.join(REJOINING_FILE), mark.as_bytes(), PUBLIC_MODE)?;
    Ok(name)
}

/// The organisations of the genesis, those that the node's own state knows since, and the own one.
pub(super) fn organisations(
    genesis: &Genesis,
    tls: &TlsIdentity,
    joined: Option<&Joined>,
    data: &Path,
) -> Result<Msps, Rejection> {
    let mut msps = Msps::new();
    for since in known_since(data) {
        msps.insert(since.msp()?)?;
    }
    let unknown: Vec<_> = genesis.organisations.iter().filter(|founder| msps.get(&founder.name).is_none()).collect();
    for founder in unknown {
        msps.insert(founder.msp()?)?;
    }
    if let Some(joined) = joined.filter(|joined| msps.get(&joined.organisation).is_none()) {
        let own = tls.own();
        let roots = own.chain.get(1..).unwrap_or_default();
        msps.insert(Msp::new(&joined.organisation, roots, &[] as &[&[u8]])?)?;
    }
    Ok(msps)
}

/// The organisations of the network as this node knew them last; none if its state cannot be read.
fn known_since(data: &Path) -> Vec<FoundingOrganisation> {
    let place = data.join(STATE_DIRECTORY);
    if !place.is_dir() {
        return Vec::new();
    }
    let state = SledStore::open(&place).and_then(|store| State::open(Box::new(store)));
    state.and_then(|state| ledger::msp::organisations(&state)).unwrap_or_default()
}

/// The identity of this node by its certificate.
pub(super) fn own(tls: &TlsIdentity, msps: &Msps) -> Result<Identity, Rejection> {
    let own = tls.own();
    let presented = own.chain.get(1..).unwrap_or_default();
    let me = msps.verify_for(Usage::Server, own.certificate(), presented, crate::process::clock::wall())?;
    if me.role == Role::Node {
        return Ok(me);
    }
    Err(Rejection::new(Code::WrongRole, "the certificate in the data directory is not a node's")
        .found(format!("{} with role {}", me.id(), me.role))
        .wanted("role node"))
}

/// The nodes that this one asks when it starts: the nodes of one organisation, and its CA. The own organisation first.
async fn reachable(client: &Client, msps: &Msps, own_address: &str) -> Result<(Vec<String>, Hash), Rejection> {
    let records = records(client).await?;
    let status = client.status().await?;
    let of = |record: &&Record| {
        record.organisation == status.organisation && record.role != REMOVED && record.address != own_address
    };
    let addresses = records.nodes.iter().filter(of).map(|record| record.address.clone()).collect();
    let root = msps.get(&status.organisation).and_then(|msp| msp.roots().next().map(|root| Hash::of(&[root])));
    let ca = root.ok_or_else(|| {
        Rejection::new(Code::Untrusted, format!("the CA of {} is unknown here", status.organisation))
            .next("name a node of your own organisation, or of a founding one, with --node HOST:PORT")
    })?;
    Ok((addresses, ca))
}

/// Moves what is damaged or dead, and what follows from it, into a directory of its own. Interrupted, it goes on where it was: what is
/// there already was moved whole.
fn set_aside(data: &Path, aside: &Path, is_dead: bool) -> Result<(), Rejection> {
    set_proofs_aside(data, aside)?;
    for name in SET_ASIDE.into_iter().filter(|name| !is_dead || !branches::is_put(data, name)) {
        let (from, to) = (data.join(name), aside.join(name));
        if fs::symlink_metadata(&from).is_ok() && fs::symlink_metadata(&to).is_err() {
            ledger_base::durable::rename(&from, &to)?;
        }
    }
    Ok(())
}

/// The rejoin has ended: the node may start.
fn unmark(data: &Path) -> Result<(), Rejection> {
    let mark = data.join(REJOINING_FILE);
    fs::remove_file(&mark).map_err(|error| ledger_base::durable::failed("remove", &mark, &error))?;
    ledger_base::durable::sync_directory(data)
}
