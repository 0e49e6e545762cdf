//! Answers that need no trust in the node that gives them.
//!
//! The client begins at the genesis, which the name of the network covers, or at a checkpoint. It follows who governs by
//! certificates, and believes an answer only if enough voters have signed what executing the call gave.

use super::uplink::Uplink;
use super::{Call, Client};
use crate::connect::unreachable;
use crate::pages::WayBound;
use crate::report::from_status;
use crate::v1;
use bytes::Bytes;
use ledger::evidence::{EVIDENCE_BYTES_MAX, Evidence, Link, Proved, Step};
use ledger::network::Genesis;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::checkpoint::CHECKPOINT_BYTES_MAX;
use ledger_light::{Change, Checkpoint, Governance, Proof, Way};
use std::path::Path;
use std::time::Duration;
use tokio::time::timeout;
use tonic::Streaming;

/// How long one step of the way may take.
const STEP_MAX: Duration = Duration::from_secs(10);
/// Most bytes of a way that is followed. It is not kept: its proofs replace what they cover.
const WAY_BYTES_MAX: usize = 1 << 30;
/// Most bytes of a way that is kept for evidence, which has as few of its proofs as there can be.
const KEPT_WAY_BYTES_MAX: usize = 4 * EVIDENCE_BYTES_MAX;

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
        proof.answers(&id, &committed.response)?;
        let checkpoint = self.checkpoint(known, proof).await?;
        Ok(Certified { response: committed.response, checkpoint })
    }

    /// The beginning that the network's name covers.
    ///
    /// # Errors
    /// [`Code::WrongNetwork`] if the node shows another genesis; [`Code::Malformed`].
    pub async fn beginning(&self) -> Result<Governance, Rejection> {
        begin(&self.credentials.network, &self.genesis().await?)
    }

    async fn genesis(&self) -> Result<Bytes, Rejection> {
        let ask = |up: Uplink| async move { up.gateway().governance(v1::GovernanceRequest { after: 0 }).await };
        let mut steps = self.ask(ask, |_| Ok(())).await?;
        Ok(self.next_step(&mut steps).await?.unwrap_or_default().genesis)
    }

    /// Follows who governs the network, up to the newest proof that the node has.
    ///
    /// # Errors
    /// [`Code::Untrusted`] and others if what the node shows is not proved; [`Code::NotFound`] if it has no proof.
    pub async fn governance(&self, known: Option<&Governance>) -> Result<Checkpoint, Rejection> {
        self.follow(known, None).await
    }

    /// Believes the events of a delivery only with its proof, which a subscription with `proofs` has. `known` is where the reader was
    /// before. None if the delivery has no proof: its block is not certified, or too few voters have signed it.
    ///
    /// # Errors
    /// [`Code::Untrusted`] and others if what the node shows does not prove it.
    pub async fn believe(
        &self,
        known: Option<&Governance>,
        delivery: &v1::Delivery,
    ) -> Result<Option<Checkpoint>, Rejection> {
        if delivery.proof.is_empty() {
            return Ok(None);
        }
        let proof = Proof::from_bytes(&delivery.proof)?;
        let statement = &proof.certificate.statement;
        let (height, time, block) = (statement.height, statement.time, statement.block);
        if (height, time) != (delivery.height, delivery.time) || block.0[..] != delivery.block_hash[..] {
            return Err(Rejection::new(Code::Untrusted, "the proof of a delivery is for another block")
                .found(format!("a proof of block {height}"))
                .wanted(format!("a proof of block {}", delivery.height))
                .next("ask another node"));
        }
        for event in &delivery.events {
            proof.gives(&event.chaincode, &event.name, &event.subject, &event.payload)?;
        }
        Ok(Some(self.checkpoint(known, proof).await?))
    }

    /// The members that govern after the block of a proof, if enough voters have signed it.
    async fn checkpoint(&self, known: Option<&Governance>, proof: Proof) -> Result<Checkpoint, Rejection> {
        // Where nothing has changed, which is nearly always, nobody has to be asked.
        let governance = match known.map(|known| known.follow(&[], &proof)) {
            Some(Ok(governance)) => governance,
            _ => self.follow(known, Some(&proof)).await?.governance,
        };
        Ok(Checkpoint { governance, proof })
    }

    /// The genesis, evidence of a transaction, checked, and what it proves. It can be checked again without a network, by whoever has the
    /// genesis. It begins there, or at `known`; then its reader needs that, too.
    ///
    /// # Errors
    /// [`Code::NotFound`] if the node has no such transaction or no certificate; as [`Evidence::check`].
    pub async fn evidence(&self, id: Hash, known: Option<&Governance>) -> Result<(Bytes, Evidence, Proved), Rejection> {
        let ask = |up: Uplink| async move {
            let id = Bytes::copy_from_slice(id.as_ref());
            up.gateway().prove_transaction(v1::ProveTransactionRequest { id }).await
        };
        let link = Link::from_bytes(&self.ask(ask, |_| Ok(())).await?.link)?;
        let to = link.proof.certificate.statement.height;
        let genesis = self.genesis().await?;
        let _named = begin(&self.credentials.network, &genesis)?;
        let after = known.map_or(0, Governance::height);
        let ask = |up: Uplink| async move { up.gateway().governance(v1::GovernanceRequest { after }).await };
        let mut steps = self.ask(ask, |_| Ok(())).await?;
        let (mut way, mut bound) = (Vec::new(), WayBound::new(KEPT_WAY_BYTES_MAX));
        while let Some(step) = self.next_step(&mut steps).await? {
            bound.count(&step)?;
            let changes = step.changes.into_iter().filter(|change| change.height <= to);
            let changes = changes.map(|change| Change::from_bytes(change.height, &change.writes));
            let proof = Some(step.proof).filter(|proof| !proof.is_empty());
            let proof = proof.map(|proof| Proof::from_bytes(&proof)).transpose()?;
            let proof = proof.filter(|proof| proof.certificate.statement.height < to);
            way.push(Step { changes: changes.collect::<Result<_, _>>()?, proof });
        }
        let (evidence, proved) = Evidence::of(way, link, (&genesis, known))?;
        Ok((genesis, evidence, proved))
    }

    async fn prove(&self, height: u64, verdict: u32) -> Result<Proof, Rejection> {
        let ask =
            |up: Uplink| async move { up.gateway().prove(v1::ProveRequest { height, verdicts: vec![verdict] }).await };
        Proof::from_bytes(&self.ask(ask, |_| Ok(())).await?.proof)
    }

    /// Follows the node's steps to the newest proof, or to that of the caller.
    async fn follow(&self, known: Option<&Governance>, to: Option<&Proof>) -> Result<Checkpoint, Rejection> {
        let after = known.map_or(0, Governance::height);
        let ask = |up: Uplink| async move { up.gateway().governance(v1::GovernanceRequest { after }).await };
        let mut steps = self.ask(ask, |_| Ok(())).await?;
        let (mut way, mut bound) = (known.cloned().map(Way::from), WayBound::new(WAY_BYTES_MAX));
        while let Some(step) = self.next_step(&mut steps).await? {
            bound.count(&step)?;
            take(&mut way, &self.credentials.network, step, to)?;
        }
        let mut way = way.ok_or_else(no_way)?;
        if let Some(to) = to {
            way.follow(to.clone());
        }
        way.end()
    }

    async fn next_step(
        &self,
        steps: &mut Streaming<v1::GovernanceStep>,
    ) -> Result<Option<v1::GovernanceStep>, Rejection> {
        let step = timeout(STEP_MAX, steps.message()).await;
        let step = step.map_err(|_| unreachable(&self.node(), "no answer to a query"))?;
        step.map_err(|status| from_status(&self.node(), &status))
    }
}

/// Reads the file of a checkpoint of that network.
///
/// # Errors
/// [`Code::BadFile`]; as [`Checkpoint::from_bytes`].
pub fn read_checkpoint(network: &Hash, path: &Path) -> Result<Checkpoint, Rejection> {
    let found = ledger_base::durable::read(path, CHECKPOINT_BYTES_MAX)?;
    Checkpoint::from_bytes(network, &found).map_err(|refused| {
        refused
            .prefix(format_args!("{} is not usable: ", path.display()))
            .next("name another file, or none to start at the genesis")
    })
}

fn no_way() -> Rejection {
    Rejection::new(Code::NotFound, "the node does not send the genesis of the network").next("ask another node")
}

/// Takes a step of a node on the way of a reader, which begins at the genesis if it has not begun. `to` is the proof to which the
/// way leads.
fn take(way: &mut Option<Way>, network: &Hash, step: v1::GovernanceStep, to: Option<&Proof>) -> Result<(), Rejection> {
    let way = match way {
        Some(way) => way,
        None => way.insert(Way::from(begin(network, &step.genesis)?)),
    };
    for v1::GovernanceChange { height, writes } in step.changes {
        way.change(height, &writes)?;
    }
    if !step.proof.is_empty() {
        let proof = Proof::from_bytes(&step.proof)?;
        if to.is_none_or(|to| proof.certificate.statement.height < to.certificate.statement.height) {
            way.follow(proof);
        }
    }
    Ok(())
}

/// The beginning, if this is the genesis of the network. The name comes first: a node that shows the
/// genesis of another network says nothing about this one.
fn begin(network: &Hash, genesis: &[u8]) -> Result<Governance, Rejection> {
    let named = Genesis::network_of(genesis)?;
    if named != *network {
        return Err(other_genesis(&named, network));
    }
    Genesis::governance(genesis)
}

fn other_genesis(named: &Hash, network: &Hash) -> Rejection {
    Rejection::new(Code::WrongNetwork, "a node sent the genesis of another network")
        .found(named.to_string())
        .wanted(network.to_string())
        .next("ask another node")
}
