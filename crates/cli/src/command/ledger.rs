//! `status`, `block`, `tx`: the node and its chain.

use crate::answer::Answer;
use crate::cli::Global;
use crate::failure::Failure;
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use crate::time;
use ledger::transaction::Transaction;
use ledger::{Bytes, Code, Hash, Rejection};
use ledger_api::v1;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};

/// Show how the node and the network are.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl status")]
pub(crate) struct Status {}

/// Show a block with its transactions and verdicts.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl block 17")]
pub(crate) struct Block {
    /// Height of the block; 0 is the genesis
    height: u64,
}

/// Show where a transaction is and what became of it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl tx 9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08")]
pub(crate) struct Tx {
    /// Id of the transaction, 64 hexadecimal digits
    id: String,
}

impl Status {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let status = Session::open(global).await?.client.status().await?;
        output.show(&Node::from(status))
    }
}

impl Block {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let block = Session::open(global).await?.client.block(self.height).await?;
        output.show(&BlockFacts::from(block))
    }
}

impl Tx {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let id = Hash::from_hex(&self.id).ok_or_else(|| {
            Rejection::new(Code::BadArgument, "the id of the transaction cannot be read")
                .found(format!("{:?}", self.id))
                .wanted("64 hexadecimal digits")
                .next("copy the id from `ledgerctl block N`, or from the answer to `ledgerctl invoke -o json`")
        })?;
        let record = Session::open(global).await?.client.transaction(id).await?;
        output.show(&TransactionFacts::from(record))
    }
}

/// How a node is. Counts are keyed by the printed form of their code.
#[derive(Serialize)]
struct Node {
    version: String,
    network: String,
    network_label: String,
    node_id: u64,
    node_name: String,
    organisation: String,
    role: String,
    leader_id: u64,
    term: u64,
    height: u64,
    block_hash: String,
    block_time: u64,
    state_digest: String,
    committed: u64,
    last_index: u64,
    clock: u64,
    uptime_ms: u64,
    chaincodes: Vec<String>,
    refused: BTreeMap<String, u64>,
    executed: BTreeMap<String, u64>,
    peers: Vec<Peer>,
    subscribers: u64,
    payload_bytes_max: u64,
    resident_bytes: u64,
}

#[derive(Serialize)]
struct Peer {
    node_id: u64,
    name: String,
    organisation: String,
    address: String,
    voter: bool,
    matched: u64,
    connected: bool,
}

/// The printed form of a code that may be unknown to this version.
fn code_text(number: u32) -> String {
    if number == 0 { "OK".to_owned() } else { format!("LGR-{number:04}") }
}

fn counts(counts: impl IntoIterator<Item = (u32, u64)>) -> BTreeMap<String, u64> {
    counts.into_iter().map(|(code, count)| (code_text(code), count)).collect()
}

impl From<v1::StatusResponse> for Node {
    fn from(status: v1::StatusResponse) -> Self {
        Self {
            version: status.version,
            network: hex::encode(status.network),
            network_label: status.network_label,
            node_id: status.node_id,
            node_name: status.node_name,
            organisation: status.organisation,
            role: status.role,
            leader_id: status.leader_id,
            term: status.term,
            height: status.height,
            block_hash: hex::encode(status.block_hash),
            block_time: status.block_time,
            state_digest: hex::encode(status.state_digest),
            committed: status.committed,
            last_index: status.last_index,
            clock: status.clock,
            uptime_ms: status.uptime_ms,
            chaincodes: status.chaincodes,
            refused: counts(status.refused),
            executed: counts(status.executed),
            peers: status.peers.into_iter().map(Peer::from).collect(),
            subscribers: status.subscribers,
            payload_bytes_max: status.payload_bytes_max,
            resident_bytes: status.resident_bytes,
        }
    }
}

impl From<v1::PeerStatus> for Peer {
    fn from(peer: v1::PeerStatus) -> Self {
        Self {
            node_id: peer.node_id,
            name: peer.name,
            organisation: peer.organisation,
            address: peer.address,
            voter: peer.voter,
            matched: peer.matched,
            connected: peer.connected,
        }
    }
}

fn count_list(counts: &BTreeMap<String, u64>) -> String {
    counts.iter().map(|(code, count)| format!("{code} {count}")).collect::<Vec<_>>().join(", ")
}

impl Facts for Node {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let leader = if self.leader_id == 0 { "none known".to_owned() } else { format!("node {}", self.leader_id) };
        let mut table = Table::pairs();
        table.pair("node", format!("{}/{} (id {}), {}", self.organisation, self.node_name, self.node_id, self.role));
        table.pair("version", &self.version);
        table.pair("network", format!("{} {}", self.network_label, self.network).trim_start());
        table.pair("leader", format!("{leader}, term {}", self.term));
        table.pair("height", format!("{} of {} committed", self.height, self.committed));
        table.pair("block hash", &self.block_hash);
        table.pair("block time", time::moment(self.block_time));
        table.pair("state digest", &self.state_digest);
        table.pair("chaincodes", self.chaincodes.join(", "));
        table.pair("executed", count_list(&self.executed));
        table.pair("refused", count_list(&self.refused));
        table.pair("subscribers", self.subscribers);
        table.pair("largest payload", format!("{} bytes", self.payload_bytes_max));
        table.pair("memory", format!("{} MiB", self.resident_bytes / (1024 * 1024)));
        table.pair("clock", time::moment(self.clock));
        table.pair("running for", time::span(self.uptime_ms.saturating_mul(1000)));
        table.write(out, 0)?;
        if self.peers.is_empty() {
            return Ok(());
        }
        writeln!(out)?;
        let mut peers = Table::new(["PEER", "ID", "ADDRESS", "VOTES", "CONNECTED", "MATCHED"]);
        for peer in &self.peers {
            peers.row([
                format!("{}/{}", peer.organisation, peer.name),
                peer.node_id.to_string(),
                peer.address.clone(),
                yes_no(peer.voter),
                yes_no(peer.connected),
                if peer.matched == 0 { "-".to_owned() } else { peer.matched.to_string() },
            ]);
        }
        peers.write(out, 0)
    }
}

fn yes_no(value: bool) -> String {
    if value { "yes" } else { "no" }.to_owned()
}

#[derive(Serialize)]
struct BlockFacts {
    height: u64,
    term: u64,
    time: u64,
    kind: String,
    hash: String,
    previous_hash: String,
    root: String,
    state_digest: String,
    transactions: Vec<TransactionFacts>,
    events: Vec<EventFacts>,
}

#[derive(Serialize)]
struct EventFacts {
    chaincode: String,
    name: String,
    subject: String,
    payload: Answer,
}

/// A transaction: who called what, where it stands, and its verdict.
#[derive(Serialize)]
struct TransactionFacts {
    id: String,
    height: u64,
    index: u32,
    time: u64,
    creator: String,
    chaincode: String,
    function: String,
    args: Vec<Answer>,
    code: String,
    message: String,
    #[serde(flatten)]
    response: Answer,
}

impl From<v1::Block> for BlockFacts {
    fn from(block: v1::Block) -> Self {
        let event = |event: v1::EventRecord| EventFacts {
            chaincode: event.chaincode,
            name: event.name,
            subject: event.subject,
            payload: Answer::read(&event.payload),
        };
        Self {
            height: block.height,
            term: block.term,
            time: block.time,
            kind: block.kind,
            hash: hex::encode(block.hash),
            previous_hash: hex::encode(block.previous_hash),
            root: hex::encode(block.root),
            state_digest: hex::encode(block.state_digest),
            transactions: block.transactions.into_iter().map(TransactionFacts::from).collect(),
            events: block.events.into_iter().map(event).collect(),
        }
    }
}

impl From<v1::TransactionRecord> for TransactionFacts {
    fn from(record: v1::TransactionRecord) -> Self {
        // A transaction that a node sends and we cannot read still has its place and its verdict.
        let body = Transaction::decode(Bytes::from(record.transaction)).map(|t| t.body().clone()).unwrap_or_default();
        let verdict = record.verdict.unwrap_or_default();
        Self {
            id: hex::encode(record.id),
            height: record.height,
            index: record.index,
            time: record.time,
            creator: record.creator,
            chaincode: body.chaincode,
            function: body.function,
            args: body.args.iter().map(|arg| Answer::read(arg)).collect(),
            code: code_text(verdict.code),
            message: verdict.message,
            response: Answer::read(&record.response),
        }
    }
}

impl TransactionFacts {
    /// `abac acquire Turtlebot4/cmd_vel`; long arguments are cut.
    fn call(&self) -> String {
        let mut words = vec![self.chaincode.clone(), self.function.clone()];
        words.extend(self.args.iter().map(|arg| brief(arg)));
        words.join(" ")
    }
}

/// An argument in at most [`BRIEF_CHARS_MAX`] characters.
fn brief(answer: &Answer) -> String {
    const BRIEF_CHARS_MAX: usize = 40;
    let text = match answer {
        Answer::Json(value) => value.get().to_owned(),
        Answer::Text(text) => text.clone(),
        Answer::Hex(digits) => format!("hex:{digits}"),
    };
    if text.chars().count() <= BRIEF_CHARS_MAX {
        return text;
    }
    text.chars().take(BRIEF_CHARS_MAX - 1).chain(['…']).collect()
}

impl Facts for BlockFacts {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("block", format!("{} ({})", self.height, self.kind));
        table.pair("hash", &self.hash);
        table.pair("previous", &self.previous_hash);
        table.pair("root", &self.root);
        table.pair("state digest", &self.state_digest);
        table.pair("term", self.term);
        table.pair("time", time::moment(self.time));
        table.write(out, 0)?;
        if !self.transactions.is_empty() {
            writeln!(out)?;
            let mut table = Table::new(["INDEX", "TRANSACTION", "CREATOR", "VERDICT", "CALL"]);
            for transaction in &self.transactions {
                table.row([
                    transaction.index.to_string(),
                    transaction.id.clone(),
                    transaction.creator.clone(),
                    transaction.code.clone(),
                    transaction.call(),
                ]);
            }
            table.write(out, 0)?;
        }
        if !self.events.is_empty() {
            writeln!(out)?;
            let mut table = Table::new(["EVENT", "SUBJECT", "DETAILS"]);
            for event in &self.events {
                let name = format!("{} {}", event.chaincode, event.name);
                table.row([name, event.subject.clone(), event.payload.to_text().replace('\n', " ")]);
            }
            table.write(out, 0)?;
        }
        Ok(())
    }
}

impl Facts for TransactionFacts {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("transaction", &self.id);
        table.pair("block", format!("{}, index {}", self.height, self.index));
        table.pair("time", time::moment(self.time));
        table.pair("creator", &self.creator);
        table.pair("call", self.call());
        table.pair("verdict", format!("{} {}", self.code, self.message).trim_end());
        table.write(out, 0)?;
        let response = self.response.to_text();
        if response.is_empty() { Ok(()) } else { writeln!(out, "response\n{response}") }
    }
}
