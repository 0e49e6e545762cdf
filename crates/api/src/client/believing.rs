//! Answers that need no trust in the node that gives them.
//!
//! The client begins at the genesis, which the name of the network covers, or at a checkpoint. It follows who governs by
//! certificates, and believes an answer only if enough voters have signed what executing the call gave.

use super::session::Up;
use super::{Call, Client};
use crate::connect::unreachable;
use crate::report::from_status;
use crate::v1;
use bytes::Bytes;
use ledger::network::Genesis;
use ledger_hash::Hash;
use ledger_light::checkpoint::CHECKPOINT_BYTES_MAX;
use ledger_light::fact::Fact;
use ledger_light::{Change, Checkpoint, Governance, Proof};
use ledger_rejection::{Code, Rejection};
use std::path::Path;
use std::time::Duration;
use tokio::time::timeout;
use tonic::Streaming;

/// How long one step of the way may take.
const STEP_MAX: Duration = Duration::from_secs(10);
/// Most bytes of changes that are kept before a proof shows that they are true.
const UNPROVED_BYTES_MAX: usize = 64 * 1024 * 1024;

/// The answer to a call, and why it is to be believed.
#[derive(Clone, Debug)]
pub struct Certified {
    /// The answer of the function.
    pub response: Bytes,
    /// The proof of its block, and who governs after it.
    pub checkpoint: Checkpoint,
}

impl Client {
    /// Calls a function in a transaction, and believes its answer only with a proof. As the transaction is new, the proof
    /// shows that the answer is, too. The function must write control state, or its block need not be certified. `known`
    /// is where the reader was before; without it it begins at the genesis.
    ///
    /// # Errors
    /// As [`Client::invoke`]; [`Code::Untrusted`] and others if what the node shows does not prove it; [`Code::NotFound`]
    /// if the node has no proof.
    pub async fn invoke_certified(&self, known: Option<&Governance>, call: Call) -> Result<Certified, Rejection> {
        let transaction = self.prepare(call)?;
        let id = transaction.id();
        let committed = self.submit(transaction).await?;
        let proof = self.prove(committed.height, committed.index).await?;
        let shown = proof.others()?;
        let response = Hash::of(&[&committed.response]);
        let is_proved = shown.iter().any(|fact| match fact {
            Fact::Verdict { id: of, code, response: answer, .. } => *of == id && *code == 0 && *answer == response,
            _ => false,
        });
        if !is_proved {
            return Err(Rejection::new(Code::Untrusted, "the proof does not show this answer to this transaction")
                .found(format!("{} facts of block {}", shown.len(), proof.certificate.statement.height))
                .wanted(format!("the verdict on transaction {id}"))
                .next("ask another node"));
        }
        // Where nothing has changed, which is nearly always, nobody has to be asked.
        let governance = match known.map(|known| known.follow(&[], &proof)) {
            Some(Ok(governance)) => governance,
            _ => self.follow(known, Some(&proof)).await?.governance,
        };
        Ok(Certified { response: committed.response, checkpoint: Checkpoint { governance, proof } })
    }

    /// The beginning that the network's name covers. None if the network was founded with rules that certify nothing: then a
    /// reader begins at a checkpoint.
    ///
    /// # Errors
    /// [`Code::WrongNetwork`] if the node shows another genesis; [`Code::Malformed`].
    pub async fn beginning(&self) -> Result<Option<Governance>, Rejection> {
        let network = &self.credentials.network;
        let ask = |up: Up| async move { up.gateway().governance(v1::GovernanceRequest { after: 0 }).await };
        let mut steps = self.ask(ask, |_| Ok(())).await?;
        let first = self.next_step(&mut steps).await?.unwrap_or_default();
        begin(network, &first.genesis)
    }

    /// Follows who governs the network, up to the newest proof that the node has.
    ///
    /// # Errors
    /// [`Code::Untrusted`] and others if what the node shows is not proved; [`Code::NotFound`] if it has no proof.
    pub async fn governance(&self, known: Option<&Governance>) -> Result<Checkpoint, Rejection> {
        self.follow(known, None).await
    }

    async fn prove(&self, height: u64, verdict: u32) -> Result<Proof, Rejection> {
        let ask =
            |up: Up| async move { up.gateway().prove(v1::ProveRequest { height, verdicts: vec![verdict] }).await };
        Proof::from_bytes(&self.ask(ask, |_| Ok(())).await?.proof)
    }

    /// Follows the node's steps to the newest proof, or to that of the caller.
    async fn follow(&self, known: Option<&Governance>, to: Option<&Proof>) -> Result<Checkpoint, Rejection> {
        let after = known.map_or(0, Governance::height);
        let ask = |up: Up| async move { up.gateway().governance(v1::GovernanceRequest { after }).await };
        let mut steps = self.ask(ask, |_| Ok(())).await?;
        let mut way = Way { governance: known.cloned(), ..Way::default() };
        while let Some(step) = self.next_step(&mut steps).await? {
            way.step(&self.credentials.network, step, to)?;
        }
        way.end(to)
    }

    async fn next_step(
        &self,
        steps: &mut Streaming<v1::GovernanceStep>,
    ) -> Result<Option<v1::GovernanceStep>, Rejection> {
        let step = timeout(STEP_MAX, steps.message()).await;
        let step = step.map_err(|_| unreachable(&self.node(), "no answer to a question"))?;
        step.map_err(|status| from_status(&self.node(), &status))
    }
}

/// Reads the file of a checkpoint of that network.
///
/// # Errors
/// [`Code::BadFile`]; as [`Checkpoint::from_bytes`].
pub fn read_checkpoint(network: &Hash, path: &Path) -> Result<Checkpoint, Rejection> {
    let found = ledger_durable::read(path, CHECKPOINT_BYTES_MAX)?;
    Checkpoint::from_bytes(network, &found).map_err(|refused| {
        let message = format!("{} is not usable: {}", path.display(), refused.message);
        Rejection { message, ..refused }.next("name another file, or none: then the way begins at the genesis")
    })
}

/// The way of a reader.
#[derive(Default)]
struct Way {
    governance: Option<Governance>,
    /// Changes that no proof covers yet.
    changes: Vec<Change>,
    bytes: usize,
    /// The proof that was followed last, or why the last one was not.
    reached: Option<Result<Proof, Rejection>>,
}

impl Way {
    fn step(&mut self, network: &Hash, step: v1::GovernanceStep, to: Option<&Proof>) -> Result<(), Rejection> {
        if self.governance.is_none() {
            let begun = begin(network, &step.genesis)?;
            self.governance = Some(begun.ok_or_else(|| {
                Rejection::new(Code::UnknownRules, "the genesis of this network is certified by nobody")
                    .found("rules older than 3")
                    .wanted("a network that was founded with rules 3 or newer")
                    .next("begin at a checkpoint that somebody made whom you trust")
            })?);
        }
        for v1::GovernanceChange { height, writes } in step.changes {
            self.bytes += writes.len();
            if self.bytes > UNPROVED_BYTES_MAX {
                return Err(Rejection::new(Code::TooLarge, "a node shows too many changes that it does not prove")
                    .found(format!("{} bytes", self.bytes))
                    .wanted(format!("at most {UNPROVED_BYTES_MAX} bytes before a proof"))
                    .next("ask another node"));
            }
            self.changes.push(Change::from_bytes(height, &writes)?);
        }
        if !step.proof.is_empty() {
            let proof = Proof::from_bytes(&step.proof)?;
            if to.is_none_or(|to| proof.certificate.statement.height < to.certificate.statement.height) {
                self.follow(proof);
            }
        }
        Ok(())
    }

    /// A proof that cannot be followed is left out: a later one may be signed by more that are believed.
    fn follow(&mut self, proof: Proof) {
        let Some(governance) = &self.governance else { return };
        self.reached = Some(governance.follow(&self.changes, &proof).map(|after| {
            self.changes.retain(|change| change.height > after.height());
            self.bytes = 0;
            self.governance = Some(after);
            proof
        }));
    }

    fn end(mut self, to: Option<&Proof>) -> Result<Checkpoint, Rejection> {
        if let Some(to) = to {
            self.follow(to.clone());
        }
        match (self.governance, self.reached) {
            (Some(governance), Some(Ok(proof))) => Ok(Checkpoint { governance, proof }),
            (_, Some(Err(refused))) => Err(refused),
            _ => Err(Rejection::new(Code::NotFound, "the node has no proof of any block")
                .wanted("a block that a majority of the voters has signed, of two organisations at least")
                .next("look at ledgerctl status: do voters of two organisations run?")),
        }
    }
}

/// The beginning, if this is the genesis of the network; none if nobody certifies it. The name comes first: a node that shows the
/// genesis of another network says nothing about this one.
fn begin(network: &Hash, genesis: &[u8]) -> Result<Option<Governance>, Rejection> {
    let named = Genesis::network_of(genesis)?;
    if named != *network {
        return Err(Rejection::new(Code::WrongNetwork, "a node shows the genesis of another network")
            .found(named.to_string())
            .wanted(network.to_string())
            .next("ask another node"));
    }
    Genesis::governance(genesis)
}
