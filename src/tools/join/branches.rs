//! The two branches of a node that a strict certificate contradicts.
//!
//! The other branch is fetched and verified *before* anything of the own one is moved. Its blocks are executed in a directory of
//! their own, and must give the certified block. The certificate counts by the voters of the last certified block that both
//! branches have, and by all since. Blocks that a strict certificate of this node covers are never left: then people decide.
//!
//! | in the data directory | what it is |
//! |---|---|
//! | `certified-branch/` | the other branch while it is fetched and verified; another try begins again with the own blocks |
//! | `dead-branch-N/` | the own branch, which `ledgerd verify` reads, with the list `lost-transactions.json` |

use crate::node::NodeBuilder;
use crate::ordering::directory::{Directory, Member};
use crate::peers::connections::Dialer;
use crate::peers::question::{Contact, certified};
use crate::peers::quorum_certificates::{certified_up_to, newest_proof};
use crate::peers::sync::blocks;
use crate::process::clock::wall;
use crate::process::config::Config;
use crate::storage::blocks::Blocks;
use crate::storage::stores::{Stores, open_blocks};
use ledger::Ledger;
use ledger::branch::CertifiedBranch;
use ledger::network::Genesis;
use ledger::transaction::Transaction;
use ledger_api::tls::{TlsIdentity, TrustSource};
use ledger_base::durable::{PUBLIC_MODE, create_directory, failed, rename, replace};
use ledger_base::hash::Hash;
use ledger_base::progress::{Progress, Step};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use ledger_light::{Certificate, Governance, Statement};
use ledger_replica::catch_up::begin_as;
use ledger_storage::archive::{oldest_snapshot, snapshot_name};
use ledger_storage::block_store::BlockStore;
use ledger_storage::entry::{Entry, HardState};
use ledger_storage::layout::{BLOCKS_DIRECTORY, GENESIS_FILE, RESULTS_DIRECTORY, SNAPSHOTS_DIRECTORY, STATE_DIRECTORY};
use serde::Serialize;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

/// The directory of the other branch, below the data directory.
pub(super) const CERTIFIED_DIRECTORY: &str = "certified-branch";
/// Beginning of the name of the directory that keeps the own branch.
pub(super) const DEAD_PREFIX: &str = "dead-branch";
/// The list of lost transactions in it.
const LOST_FILE: &str = "lost-transactions.json";
/// The parts of the other branch that become those of the node, in the order in which they are moved.
const MOVED: [&str; 4] = [BLOCKS_DIRECTORY, RESULTS_DIRECTORY, SNAPSHOTS_DIRECTORY, STATE_DIRECTORY];
/// Bytes of blocks that are read at once.
const READ_BYTES: usize = 8 * 1024 * 1024;
/// How far below the tip of another node a certificate is looked for, in blocks: the nearest first.
const BELOW_TIP: [u64; 3] = [16, 256, 4096];
/// Ids that are printed; the list in the file has all of them.
const PRINTED_MAX: usize = 20;

/// The result of verifying the other branch, before anything is moved.
#[derive(Debug, Serialize)]
pub(super) struct Lost {
    /// Version of this list.
    version: u32,
    network: Hash,
    /// The last block that both branches have.
    common_height: u64,
    /// The newest block of the own branch.
    dead_height: u64,
    /// Its hash.
    dead_block: Hash,
    /// The certified block of the other branch up to which it was verified.
    certified_height: u64,
    /// Its hash.
    certified_block: Hash,
    /// In the order of the own branch.
    transactions: Vec<LostTransaction>,
}

/// A transaction that was executed on the own branch, and that the other one does not have.
#[derive(Debug, Serialize)]
struct LostTransaction {
    id: Hash,
    height: u64,
    index: u32,
    /// Block time, microseconds since the UNIX epoch.
    time: u64,
    /// `ORGANISATION/NAME`; empty if its certificate is unknown.
    creator: String,
    chaincode: String,
    function: String,
    /// The verdict that its client was answered with: the name of a code.
    verdict: &'static str,
}

/// The organisations that a stopped node knows, for TLS. It holds no store, because connections end later than what they are used for.
struct Known {
    msps: Arc<Msps>,
    governance: Governance,
}

impl TrustSource for Known {
    fn msps(&self) -> Arc<Msps> {
        Arc::clone(&self.msps)
    }

    fn now(&self) -> u64 {
        wall()
    }

    fn revoked(&self, identity: &Identity) -> bool {
        self.governance.is_revoked(identity)
    }
}

/// The own branch of a stopped node.
struct Own {
    stores: Stores,
    genesis: Vec<u8>,
    dialer: Dialer,
    members: Vec<Member>,
}

/// Fetches the branch of this certificate into a directory of its own, and verifies it. The own branch stays as it is.
///
/// # Errors
/// [`Code::Contradicted`] if a strict certificate of this node covers blocks that the other branch does not have;
/// [`Code::Unreachable`] if no other node has that branch; a fault of the own blocks or of the disk.
pub(super) async fn verify(
    builder: &NodeBuilder,
    config: &Config,
    branch: &CertifiedBranch,
    tls: &TlsIdentity,
    named: &[String],
) -> Result<Lost, Rejection> {
    let own = Own::open(builder, config, tls)?;
    let mut refused = Vec::new();
    let addresses = named.iter().cloned().map(Place::At);
    let members = own.members.iter().cloned().map(Place::Member);
    for place in addresses.chain(members) {
        let name = place.name();
        match own.verify_at(builder, config, branch, place).await {
            Ok(lost) => return Ok(lost),
            // This node's own affair: another node gives the same.
            Err(fault) if matches!(fault.code, Code::Contradicted | Code::DiskFull | Code::DiskFailed) => {
                return Err(fault);
            }
            Err(reason) => refused.push(format!("{name}: {reason}")),
        }
    }
    let found = if refused.is_empty() { "no other node".to_owned() } else { refused.join("; ") };
    Err(Rejection::new(Code::Unreachable, "no other node serves the certified branch; nothing was changed")
        .found(found)
        .wanted(format!("a node with block {} at height {}", branch.block(), branch.height()))
        .next(format!("name one: ledgerd rejoin --config {} --node HOST:PORT", shell::path(&config.file))))
}

/// Another node.
enum Place {
    At(String),
    Member(Member),
}

impl Place {
    fn name(&self) -> String {
        match self {
            Self::At(address) => address.clone(),
            Self::Member(member) => member.full_name(),
        }
    }
}

impl Own {
    fn open(builder: &NodeBuilder, config: &Config, tls: &TlsIdentity) -> Result<Self, Rejection> {
        let path = config.data.join(GENESIS_FILE);
        let genesis = fs::read(&path).map_err(|error| failed("read", &path, &error))?;
        let stores = Stores::open(config, &genesis, builder.registry()?)?;
        let ledger = &stores.ledger;
        let members = Directory::read(ledger).members().to_vec();
        let own = tls.own();
        let presented = own.chain.get(1..).unwrap_or_default();
        let me = ledger.msps().verify(own.certificate(), presented, wall())?;
        let own = |member: &Member| member.organisation == me.organisation && member.name == me.name;
        let dialer = Dialer {
            me: members.iter().find(|member| own(member)).map_or(0, |member| member.id),
            network: ledger.network(),
            organisation: me.organisation.clone(),
            identity: tls.clone(),
            trust: Arc::new(Known {
                msps: ledger.msps(),
                governance: governance(&genesis, ledger, ledger.tip().height)?,
            }),
            rules: Arc::new(config.dial_rules()),
            paces: Arc::default(),
        };
        let members = members.into_iter().filter(|member| !own(member)).collect();
        Ok(Self { stores, genesis, dialer, members })
    }

    async fn verify_at(
        &self,
        builder: &NodeBuilder,
        config: &Config,
        branch: &CertifiedBranch,
        place: Place,
    ) -> Result<Lost, Rejection> {
        let peer = self.contact(&place).await?;
        let common = self.common(&peer, branch).await?;
        let newer = newer(&peer, branch.certificate().statement.height).await;
        let certificate = newer.as_ref().unwrap_or(branch.certificate());
        let there = Config { data: config.data.join(CERTIFIED_DIRECTORY), ..config.clone() };
        clear(&there.data)?;
        create_directory(&there.data)?;
        replace(&there.data.join(GENESIS_FILE), &self.genesis, PUBLIC_MODE)?;
        let store = self.begin(config, &there, common)?;
        fetch(&peer, &store, (common + 1, certificate.statement.height)).await?;
        drop(store);
        let other = Stores::open(&there, &self.genesis, builder.registry()?)?;
        for certificate in [branch.certificate(), certificate] {
            gives(&other.ledger, &certificate.statement)?;
        }
        self.check(config, (&other.ledger, common), [branch.certificate(), certificate])?;
        self.lost(&other.ledger, common, certificate)
    }

    async fn contact(&self, place: &Place) -> Result<Contact, Rejection> {
        let unreachable = |reason: String| Rejection::new(Code::Unreachable, reason);
        let (address, channel) = match place {
            Place::At(address) => (address.clone(), self.dialer.at(address).await),
            Place::Member(member) => (member.address.clone(), self.dialer.channel(member).await),
        };
        Ok(Contact { address, channel: channel.map_err(unreachable)? })
    }

    /// The last block that the other node has as well, as it says: what is fetched from there on shows whether that is true.
    async fn common(&self, peer: &Contact, branch: &CertifiedBranch) -> Result<u64, Rejection> {
        let (ledger, first) = (&self.stores.ledger, self.stores.store.first_index());
        let (mut common, mut other) = (first.saturating_sub(1), branch.height().min(ledger.tip().height + 1));
        while other - common > 1 {
            let height = common + (other - common) / 2;
            let theirs = blocks::block_hash(peer, height).await?;
            let own = ledger.block_hashes(height)?.map(|own| own.hash);
            // What one of them has dropped is old.
            match theirs.is_none() || own.is_none() || theirs == own {
                true => common = height,
                false => other = height,
            }
        }
        Ok(common)
    }

    /// A log with the own blocks up to a height, and a snapshot below it if the log does not begin with block 1.
    fn begin(&self, config: &Config, there: &Config, common: u64) -> Result<BlockStore, Rejection> {
        let (own, first) = (&self.stores.store, self.stores.store.first_index());
        if first > 1 {
            let from = config.data.join(SNAPSHOTS_DIRECTORY);
            let height = oldest_snapshot(&from, first)?.filter(|height| *height <= common).ok_or_else(|| {
                Rejection::new(Code::Pruned, "the common blocks cannot be executed again: older ones were dropped")
                    .found(format!("blocks from {first} on, and no snapshot of a height up to {common}"))
                    .wanted("a snapshot below the first block in which the branches differ")
                    .next(format!(
                        "keep a copy of {}, remove the file `contradicted` in it, and run ledgerd rejoin again: the \
                         branch is set aside without a list",
                        config.data.display()
                    ))
            })?;
            let to = there.data.join(SNAPSHOTS_DIRECTORY);
            create_directory(&to)?;
            let (from, to) = (from.join(snapshot_name(height)), to.join(snapshot_name(height)));
            fs::copy(&from, &to).map_err(|error| failed("copy", &from, &error))?;
        }
        let store = open_blocks(there, self.stores.ledger.network())?;
        begin_as(&store, own)?;
        let mut next = first;
        while next <= common {
            let entries = own.entries(next..common + 1, READ_BYTES)?;
            next += entries.len() as u64;
            take(&store, &entries)?;
        }
        Ok(store)
    }

    /// Are these strict certificates of a branch that begins at the last certified block that both have? And does none of this node's
    /// own cover what would be left?
    fn check(
        &self,
        config: &Config,
        (other, common): (&Ledger, u64),
        certificates: [&Certificate; 2],
    ) -> Result<(), Rejection> {
        let own = &self.stores.ledger;
        let certified = certified_up_to(&config.data, common)?;
        let known = governance(&self.genesis, own, certified)?;
        let (theirs, ours) = (other.changes(0, usize::MAX)?, own.changes(0, usize::MAX)?);
        for certificate in certificates {
            known.check_branch(&theirs, certificate)?;
        }
        let Some(newest) = newest_proof(&config.data)? else { return Ok(()) };
        let statement = &newest.certificate.statement;
        let is_own = own.block_hashes(statement.height)?.is_some_and(|own| own.hash == statement.block);
        if statement.height <= common || !is_own || known.check_branch(&ours, &newest.certificate).is_err() {
            return Ok(());
        }
        Err(Rejection::new(Code::Contradicted, "two strict certificates contradict each other; nothing was changed")
            .found(format!("block {} at height {}, certified for this node", statement.block, statement.height))
            .wanted("one certified branch: no program drops blocks that a strict certificate covers")
            .next("people must choose the branch to keep: \"Two certified branches\" in docs/operations.md"))
    }

    /// The transactions that were executed here, and are not on the other branch.
    fn lost(&self, other: &Ledger, common: u64, certificate: &Certificate) -> Result<Lost, Rejection> {
        let (ledger, tip) = (&self.stores.ledger, self.stores.ledger.tip());
        let blocks = Blocks::new(Arc::clone(ledger), Arc::clone(&self.stores.store));
        let mut transactions = Vec::new();
        for height in common + 1..=tip.height {
            let Some(block) = blocks.get(height)? else { continue };
            let executed = block.transactions.iter().zip(&block.ids).zip(&block.results);
            for (index, ((encoded, id), result)) in (0..).zip(executed) {
                let Ok(transaction) = Transaction::decode(encoded.clone()) else { continue };
                if other.transaction(id)?.is_some() {
                    continue;
                }
                let body = transaction.body();
                transactions.push(LostTransaction {
                    id: *id,
                    height,
                    index,
                    time: block.header.time,
                    creator: ledger.creator_name(&transaction.creator()).unwrap_or_default(),
                    chaincode: body.chaincode.clone(),
                    function: body.function.clone(),
                    verdict: result.code().name(),
                });
            }
        }
        let Statement { height: certified_height, block: certified_block, .. } = certificate.statement;
        Ok(Lost {
            version: 1,
            network: ledger.network(),
            common_height: common,
            dead_height: tip.height,
            dead_block: tip.hash,
            certified_height,
            certified_block,
            transactions,
        })
    }
}

/// The governance after a block of a ledger.
fn governance(genesis: &[u8], ledger: &Ledger, height: u64) -> Result<Governance, Rejection> {
    Genesis::governance(genesis)?.as_of(height, &ledger.changes(0, usize::MAX)?)
}

/// A newer certificate of that node than one of this height; none if it shows none.
async fn newer(peer: &Contact, height: u64) -> Option<Certificate> {
    let tip = blocks::tip(peer).await.ok()?;
    for below in BELOW_TIP {
        let from = tip.saturating_sub(below);
        if from <= height {
            return None;
        }
        if let Ok(branch) = certified(&peer.channel, from).await {
            return Some(branch.certificate().clone());
        }
    }
    None
}

/// Stores committed blocks.
fn take(store: &BlockStore, entries: &[Entry]) -> Result<(), Rejection> {
    let Some(last) = entries.last() else {
        return Err(Rejection::new(Code::Pruned, "blocks were dropped while they were read"));
    };
    store.append(entries, Some(&HardState { term: last.term, vote: 0, commit: last.index }))?;
    store.flush()?;
    Ok(())
}

/// Fetches the blocks of these heights. They are executed later, and must give the certified block then.
async fn fetch(peer: &Contact, store: &BlockStore, (mut next, last): (u64, u64)) -> Result<(), Rejection> {
    let mut progress = Progress::new(true);
    let mut stream = Some((blocks::open(peer, next).await?, peer.address.clone()));
    while next <= last {
        let entries = blocks::next(&mut stream).await?.unwrap_or_default();
        let entries: Vec<_> = entries.into_iter().take_while(|entry| entry.index <= last).collect();
        let follows = (next..).zip(&entries).all(|(index, entry)| entry.index == index);
        if entries.is_empty() || !follows {
            return Err(Rejection::new(Code::ChainInvalid, "the node does not serve all blocks of its branch")
                .found(format!("blocks up to {}", next.saturating_sub(1)))
                .wanted(format!("blocks up to {last}")));
        }
        next += entries.len() as u64;
        take(store, &entries)?;
        progress.tell(Step { count: next, at: next, of: Some(last) }, |_| {
            format!("fetching the certified branch: block {next} of {last}")
        });
    }
    progress.clear();
    Ok(())
}

/// Does this ledger give the block and the results that voters have signed?
fn gives(ledger: &Ledger, statement: &Statement) -> Result<(), Rejection> {
    let found = ledger.block_hashes(statement.height)?;
    let results = found.and_then(|found| Some(found.roots?.results));
    if found.is_some_and(|found| found.hash == statement.block) && results == Some(statement.results) {
        return Ok(());
    }
    Err(Rejection::new(Code::ChainInvalid, "the node serves another branch than the certified one")
        .found(format!("block {} at height {}", found.map_or(Hash::ZERO, |found| found.hash), statement.height))
        .wanted(format!("block {}, with results root {}", statement.block, statement.results)))
}

/// Removes what an earlier try has left.
fn clear(directory: &Path) -> Result<(), Rejection> {
    match fs::remove_dir_all(directory) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(failed("remove", directory, &error)),
        _ => Ok(()),
    }
}

/// Copies the genesis beside blocks that are set aside, so that `ledgerd verify` reads them.
pub(super) fn keep_genesis(data: &Path, aside: &Path) -> Result<(), Rejection> {
    let genesis = data.join(GENESIS_FILE);
    let bytes = fs::read(&genesis).map_err(|error| failed("read", &genesis, &error))?;
    replace(&aside.join(GENESIS_FILE), &bytes, PUBLIC_MODE)
}

/// Writes the list into the directory that keeps the own branch.
pub(super) fn write_list(aside: &Path, lost: &Lost) -> Result<(), Rejection> {
    let list = serde_json::to_vec_pretty(lost).map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
    replace(&aside.join(LOST_FILE), &list, PUBLIC_MODE)
}

/// Is this the part of the other branch already, of which an earlier try has moved some?
pub(super) fn is_put(data: &Path, name: &str) -> bool {
    MOVED.contains(&name) && !data.join(CERTIFIED_DIRECTORY).join(name).exists()
}

/// Moves the other branch to its place. Interrupted, it goes on where it was.
pub(super) fn put(data: &Path) -> Result<(), Rejection> {
    let from = data.join(CERTIFIED_DIRECTORY);
    for name in MOVED.into_iter().filter(|name| !is_put(data, name)) {
        // Nothing is there but what opening has made.
        clear(&data.join(name))?;
        rename(&from.join(name), &data.join(name))?;
    }
    clear(&from)
}

/// The lost transactions in words, for the operator; with where all of them are.
pub(super) fn told(lost: Option<&Lost>, aside: &Path) -> String {
    let list = aside.join(LOST_FILE);
    let kept = format!("kept       {}, for auditors: ledgerd verify {0}\n", aside.display());
    let Some(lost) = lost else { return format!("{kept}lost       see {}\n", list.display()) };
    let Lost { common_height, dead_height, certified_height, transactions, .. } = lost;
    let count = transactions.len();
    let mut text = format!(
        "branches   both have block {common_height}; the dead one ends with {dead_height}, the other is certified up \
         to {certified_height}\n{kept}lost       {count} transactions that were answered here and are not on the \
         certified branch: {}\n",
        list.display()
    );
    for LostTransaction { id, creator, chaincode, function, verdict, .. } in transactions.iter().take(PRINTED_MAX) {
        text += &format!("  {id} {creator} {chaincode} {function} {verdict}\n");
    }
    if count > PRINTED_MAX {
        text += &format!("  and {} more\n", count - PRINTED_MAX);
    }
    text
}
