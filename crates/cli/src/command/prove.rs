//! `prove`: a file that proves a transaction, and checking such a file without a network.

use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use crate::strictness::{beginning, strictness};
use crate::time;
use ledger::evidence::{EVIDENCE_BYTES_MAX, Evidence, Proved};
use ledger::network::{GENESIS_BYTES_MAX, Genesis};
use ledger_api::facts::DecodedBytes;
use ledger_api::read_checkpoint;
use ledger_base::durable::{PUBLIC_MODE, read, replace};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::Governance;
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;

/// Write evidence of who signed a transaction and its verdict to a file, or verify such a file offline.
///
/// The file contains the signed transaction, its path to the root of its block, headers, and a quorum certificate. It
/// also contains the chain of voter changes from the genesis, or from a checkpoint. The reader needs the genesis and
/// trusts no node. Position and verdict can be proved as long as blocks are stored.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl prove 9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08 --file salma.evidence --genesis genesis.json
  ledgerctl prove --check salma.evidence --genesis genesis.json")]
pub(crate) struct Prove {
    /// Id of the transaction, 64 hexadecimal digits
    #[arg(value_name = "TX", required_unless_present = "check", conflicts_with = "check")]
    id: Option<String>,
    /// Write to this file; by default the first 16 digits of the id and `.evidence`
    #[arg(long, value_name = "FILE", conflicts_with = "check")]
    file: Option<PathBuf>,
    /// Verify this file; needs no context and no network
    #[arg(long, value_name = "FILE", requires = "genesis")]
    check: Option<PathBuf>,
    /// Genesis of the network: read for verification, otherwise written
    #[arg(long, value_name = "GENESIS")]
    genesis: Option<PathBuf>,
    /// Start at this checkpoint instead of the genesis, as after a forced recovery; verification needs the same one
    #[arg(long, value_name = "CHECKPOINT")]
    checkpoint: Option<PathBuf>,
}

impl Prove {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        if let (Some(file), Some(genesis)) = (&self.check, &self.genesis) {
            let evidence = Evidence::from_bytes(&read(file, EVIDENCE_BYTES_MAX)?)?;
            let genesis = read(genesis, GENESIS_BYTES_MAX)?;
            let known = self.known(&Genesis::network_of(&genesis)?)?;
            let proved = evidence.check(&genesis, known.as_ref())?;
            return output.show(&Shown::new(&proved, None));
        }
        let text = self.id.clone().unwrap_or_default();
        let id = Hash::from_hex(&text).ok_or_else(|| {
            Rejection::new(Code::BadArgument, "the id of the transaction cannot be read")
                .found(format!("{text:?}"))
                .wanted("64 hexadecimal digits")
                .next("copy the id from `ledgerctl audit -o json` or `ledgerctl block N`")
        })?;
        let session = Session::open(global).await?;
        let known = self.known(&session.context().network)?;
        let proving = session.client.evidence(id, known.as_ref()).await;
        let (genesis, evidence, proved) = proving.map_err(|refused| match (refused.code, &self.checkpoint) {
            (Code::Untrusted, None) => refused.next(
                "query another node; after a forced recovery, start at a checkpoint: --checkpoint FILE \
                              (docs/operations.md)",
            ),
            _ => refused,
        })?;
        let name = || PathBuf::from(format!("{}.evidence", text.get(..16).unwrap_or(&text)));
        let file = self.file.unwrap_or_else(name);
        replace(&file, &evidence.to_bytes(), PUBLIC_MODE)?;
        if let Some(path) = &self.genesis {
            replace(path, &genesis, PUBLIC_MODE)?;
        }
        output.show(&Shown::new(&proved, Some(file)))
    }

    /// The governance of the checkpoint, if one is named.
    fn known(&self, network: &Hash) -> Result<Option<Governance>, Rejection> {
        let checkpoint = self.checkpoint.as_deref().map(|path| read_checkpoint(network, path)).transpose()?;
        Ok(checkpoint.map(|checkpoint| checkpoint.governance))
    }
}

/// The facts that are proved.
#[derive(Serialize)]
struct Shown {
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<PathBuf>,
    network: Hash,
    label: String,
    transaction: Hash,
    signer: String,
    role: String,
    height: u64,
    index: u32,
    time: u64,
    chaincode: String,
    function: String,
    args: Vec<DecodedBytes>,
    code: String,
    certified_height: u64,
    certified_time: u64,
    certified_block: Hash,
    signed_by: Vec<String>,
    voters: usize,
    /// Height of the block that made certificates strict; none if they are not.
    strict_since: Option<u64>,
    began_at: u64,
}

impl Shown {
    fn new(proved: &Proved, file: Option<PathBuf>) -> Self {
        let body = proved.transaction.body();
        let (certified_height, certified_time, certified_block) = proved.certified;
        Self {
            file,
            network: proved.network,
            label: proved.label.clone(),
            transaction: proved.transaction.id(),
            signer: proved.signer.id(),
            role: proved.signer.role.to_string(),
            height: proved.header.height,
            index: proved.index,
            time: proved.header.time,
            chaincode: body.chaincode.clone(),
            function: body.function.clone(),
            args: body.args.iter().map(|arg| DecodedBytes::read(arg)).collect(),
            code: format!("LGR-{:04}", proved.verdict.code),
            certified_height,
            certified_time,
            certified_block,
            signed_by: proved.signed_by.clone(),
            voters: proved.voters,
            strict_since: proved.strict_since,
            began_at: proved.began_at,
        }
    }
}

impl Facts for Shown {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("file", self.file.as_ref().map(|file| file.display().to_string()).unwrap_or_default());
        table.pair("network", format!("{} ({})", self.network, self.label));
        table.pair("transaction", self.transaction);
        table.pair("signed by", format!("{}, role {}", self.signer, self.role));
        let args: Vec<String> = self.args.iter().map(DecodedBytes::to_text).collect();
        table.pair("call", format!("{} {} {}", self.chaincode, self.function, args.join(" ")).trim_end());
        table.pair("block", format!("{}, index {}", self.height, self.index));
        table.pair("time", time::rfc3339(self.time));
        table.pair("verdict", if self.code == "LGR-0000" { "executed" } else { &self.code });
        let nodes = format!("{} ({} of {} voters)", self.signed_by.join(", "), self.signed_by.len(), self.voters);
        table.pair("certified", format!("block {}, {}", self.certified_height, time::rfc3339(self.certified_time)));
        table.pair("certified by", nodes);
        table.pair("strict", strictness(self.strict_since, self.began_at));
        table.pair("verified from", beginning(self.began_at));
        table.write(out, 0)
    }
}
