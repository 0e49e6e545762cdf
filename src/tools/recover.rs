//! `ledgerd recover --force-single`: the last resort when most voters are lost for good. One node goes on as the only voter.
//!
//! It gives up a promise: what the lost voters had acknowledged and this node never received is gone. So it is refused while
//! a majority can be seen, names the possible loss, and wants the name of the network as a confirmation. It stays on the ledger
//! for ever ([`ledger::msp::Recovery`]). The lost voters must never start again as they were: `ledgerd rejoin` brings each in.

mod checkpoint;
mod survey;

pub(crate) use checkpoint::{CheckpointOptions, checkpoint};

use crate::node::NodeBuilder;
use crate::ordering::directory::{Directory, Member};
use crate::peers::chain_monitor::confirmed_heights;
use crate::process::clock::wall;
use crate::process::config::Config;
use crate::process::failure::advised;
use crate::storage::files::RESTORED_FILE;
use crate::storage::files::{refuse_contradicted, refuse_rejoining};
use crate::storage::stores::Stores;
use crate::trust::credentials::NodeCredentials;
use crate::trust::membership::{Joined, own_membership};
use crate::trust::membership::{check_member, nothing_here};
use bytes::Bytes;
use ledger::members::Membership;
use ledger::msp::Recovery;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use ledger_storage::entry::{Entry, EntryKind, HardState};
use ledger_storage::layout::GENESIS_FILE;
use std::collections::BTreeSet;
use std::fs;
use std::io::ErrorKind;
use std::path::PathBuf;
use survey::{Answer, survey};

/// Bytes of blocks that are read at once.
const READ_BYTES: usize = 8 * 1024 * 1024;

/// The arguments of `ledgerd recover`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ledgerd recover --force-single --config ledgerd.toml --confirm fleet --reason \"fire in hall 2\""
)]
pub(crate) struct RecoverOptions {
    /// This node becomes the only voter. Blocks that only the lost voters stored are lost.
    #[arg(long, required = true)]
    force_single: bool,
    /// Label of the network, as confirmation. Without it, the command only shows what would be done and lost.
    #[arg(long, value_name = "LABEL")]
    confirm: Option<String>,
    /// Reason; recorded on the ledger.
    #[arg(long, value_name = "TEXT", default_value = "")]
    reason: String,
    /// The node's configuration.
    #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
    pub(crate) config: PathBuf,
}

/// A stopped node, and what its log says.
struct Survivor {
    stores: Stores,
    papers: NodeCredentials,
    me: Member,
    members: Vec<Member>,
    /// The members at the end of its log.
    ordering: Membership,
    /// The newest block in its log.
    last: u64,
}

/// Recovers; answers with what to tell the operator.
///
/// # Errors
/// [`Code::BadFile`] if the node runs or its directory cannot be used; [`Code::AlreadyExists`] if no voter is lost, a majority
/// lives, or another node that answers has more blocks; [`Code::BadArgument`] without the confirmation, with what would be lost.
pub(crate) async fn recover(
    builder: &NodeBuilder,
    options: &RecoverOptions,
    config: &Config,
) -> Result<String, Rejection> {
    let survivor = Survivor::open(builder, config)?;
    let answers = survey(&survivor.papers, &survivor.stores.ledger, &survivor.me, &survivor.members).await?;
    survivor.check_lost(config)?;
    survivor.check_majority(&answers, config)?;
    survivor.check_newest(&answers)?;
    survivor.check_confirmed(options, config)?;
    survivor.force(options, config)
}

impl Survivor {
    fn open(builder: &NodeBuilder, config: &Config) -> Result<Self, Rejection> {
        let genesis = fs::read(config.data.join(GENESIS_FILE)).map_err(|error| nothing_here(config, &error))?;
        refuse_rejoining(config)?;
        refuse_contradicted(config).map_err(|reason| advised(reason, config))?;
        let stores = Stores::open(config, &genesis, builder.registry()?)?;
        let (ledger, papers) = (&stores.ledger, NodeCredentials::read(config)?);
        let members = Directory::read(ledger).members().to_vec();
        let joined = Joined::load(&config.data)?;
        let me = own_membership(&papers.identity, ledger, &stores.genesis, &members, joined.as_ref())?;
        check_member(config, ledger.network(), &me)?;
        let last = stores.store.last_index();
        let mut ordering = ledger.members()?;
        let mut next = ledger.tip().height + 1;
        while next <= last {
            let entries = stores.store.entries(next..last + 1, READ_BYTES)?;
            next += entries.len() as u64;
            ordering = ordering.fold(&entries);
        }
        Ok(Self { me, members, ordering, last, papers, stores })
    }

    /// All whose votes count.
    fn voters(&self) -> BTreeSet<u64> {
        self.ordering.voters.union(&self.ordering.outgoing).copied().collect()
    }

    fn name(&self, id: u64) -> String {
        let known = self.members.iter().find(|member| member.id == id);
        known.map_or_else(|| format!("node {id}"), Member::full_name)
    }

    /// A node that votes alone has lost nobody; but what a backup has restored waits for this.
    fn check_lost(&self, config: &Config) -> Result<(), Rejection> {
        if self.voters() != BTreeSet::from([self.me.id]) || config.data.join(RESTORED_FILE).exists() {
            return Ok(());
        }
        Err(Rejection::new(Code::AlreadyExists, "no voter is lost")
            .found(format!("{}, the only voter", self.me.full_name()))
            .wanted("a network in which other nodes also vote, and most of them are permanently lost")
            .next(format!("ledgerd run --config {}", shell::path(&config.file))))
    }

    /// Those that answer and this one could order: then nothing is lost, and nothing is forced.
    fn check_majority(&self, answers: &[Answer], config: &Config) -> Result<(), Rejection> {
        let voters = self.voters();
        let alive = answers.iter().filter(|answer| voters.contains(&answer.id)).count();
        let own = usize::from(voters.contains(&self.me.id));
        if alive + own <= voters.len() / 2 || alive == 0 {
            return Ok(());
        }
        let names: Vec<_> = answers.iter().map(|answer| self.name(answer.id)).collect();
        let file = shell::path(&config.file);
        Err(Rejection::new(Code::AlreadyExists, "a majority of the voters is not lost")
            .found(format!("{} of {} voters, with this one: {} answer", alive + own, voters.len(), names.join(", ")))
            .wanted("most voters unreachable, because they are permanently lost")
            .next(format!(
                "ledgerd run --config {file}, or ledgerd rejoin --config {file} if this node cannot start as it is"
            )))
    }

    /// The node with the newest blocks is the one to go on with.
    fn check_newest(&self, answers: &[Answer]) -> Result<(), Rejection> {
        let Some(newer) = answers.iter().filter(|answer| answer.last > self.last).max_by_key(|answer| answer.last)
        else {
            return Ok(());
        };
        let name = self.name(newer.id);
        Err(Rejection::new(Code::AlreadyExists, "another node that answers has more blocks")
            .found(format!("{name} with blocks up to {}, this node up to {}", newer.last, self.last))
            .wanted("the node with the newest blocks")
            .next(format!("stop {name}, and run ledgerd recover --force-single there")))
    }

    fn check_confirmed(&self, options: &RecoverOptions, config: &Config) -> Result<(), Rejection> {
        let label = &self.stores.genesis.label;
        if options.confirm.as_ref() == Some(label) {
            return Ok(());
        }
        let found = options.confirm.as_ref().map_or_else(|| "no confirmation".into(), |label| format!("{label:?}"));
        Err(Rejection::new(Code::BadArgument, format!("nothing was done: {}", self.consequences(config, false)))
            .found(found)
            .wanted(format!("--confirm {label:?}, the label of the network"))
            .next(format!(
                "look for another node, a disk or a newer backup first; then ledgerd recover --force-single --config {} \
                 --confirm {label:?} --reason TEXT",
                shell::path(&config.file)
            )))
    }

    /// The consequences in words: as a threat, or as done.
    fn consequences(&self, config: &Config, done: bool) -> String {
        let (is, vote) = if done { ("is", "vote") } else { ("would be", "would vote") };
        let me =
            format!("{} {is} the only voter of the network, with the blocks up to {}", self.me.full_name(), self.last);
        let others = self.voters().into_iter().filter(|id| *id != self.me.id).map(|id| self.name(id));
        let others: Vec<_> = others.collect();
        if others.is_empty() {
            return format!("{me}; blocks without another copy are lost");
        }
        let heights = confirmed_heights(&config.data);
        let lost = match heights.values().max().filter(|height| **height > self.last) {
            Some(height) => format!("blocks {} to {height}, which other voters had confirmed, are lost", self.last + 1),
            None => "blocks that only the others stored are lost".to_owned(),
        };
        format!("{me}; {} {vote} no longer; {lost}", others.join(", "))
    }

    /// Writes the change of members behind the log, as committed, in a new term.
    fn force(&self, options: &RecoverOptions, config: &Config) -> Result<String, Rejection> {
        let consequences = self.consequences(config, true);
        let recovery = Recovery {
            id: self.me.id,
            node: self.me.full_name(),
            voters: self.voters(),
            at: wall(),
            reason: options.reason.clone(),
        };
        let store = &self.stores.store;
        let before = store.hard_state();
        let term = before.term + 1;
        let mut changes = Vec::new();
        if self.ordering.is_joint() {
            changes.push(Bytes::new());
        }
        let others: Vec<_> = self.ordering.nodes().union(&self.ordering.learners_next).copied().collect();
        let change = recovery.change(others)?;
        changes.push(change.to_bytes());
        if change.changes.len() > 1 {
            changes.push(Bytes::new());
        }
        let entry = |(index, data)| Entry { index, term, kind: EntryKind::ConfChangeV2, data };
        let entries: Vec<_> = (self.last + 1..).zip(changes).map(entry).collect();
        let after = self.ordering.clone().fold(&entries);
        if !after.is_alone(self.me.id) {
            return Err(Rejection::new(Code::Internal, "the members cannot be changed so").found(format!("{after:?}")));
        }
        let commit = self.last + entries.len() as u64;
        store.append(&entries, Some(&HardState { term, vote: self.me.id, commit }))?;
        store.flush()?;
        unmark(config)?;
        let recorded = self.last + 1 + u64::from(self.ordering.is_joint());
        let file = shell::path(&config.file);
        Ok(format!(
            "FORCED RECOVERY: {consequences}.\nThis is recorded on the ledger from block {recorded} on: event \
             members_forced.\n\nnext:\n  ledgerd run --config {file}\nNever start one of the others unchanged. On \
             each that returns: ledgerd rejoin --config FILE --node {}\nFor each that is lost: ledgerctl network \
             remove NODE. Gates and earlier checkpoints reject blocks that this node alone signs; docs/operations.md \
             describes how they start again.",
            self.me.address
        ))
    }
}

/// The directory is no copy any more: it is the beginning of what follows.
fn unmark(config: &Config) -> Result<(), Rejection> {
    let mark = config.data.join(RESTORED_FILE);
    match fs::remove_file(&mark) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(ledger_base::durable::failed("remove", &mark, &error)),
        _ => ledger_base::durable::sync_directory(&config.data),
    }
}
