//! Checking evidence: from the genesis to the signature of the transaction, without a network and without believing anybody.

use super::{Evidence, Link, Step};
use crate::block::{Header, leaf};
use crate::chain::Outcome;
use crate::facts::verdicts;
use crate::network::Genesis;
use crate::transaction::Transaction;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_light::fact::Fact;
use ledger_light::merkle::Path;
use ledger_light::proof::Shown;
use ledger_light::{Change, Governance, Proof, ProvedVerdict};
use std::sync::Arc;

/// The facts that evidence proves.
#[derive(Clone, Debug, PartialEq)]
pub struct Proved {
    /// The network.
    pub network: Hash,
    /// Its label, as the genesis has it.
    pub label: String,
    /// The transaction: its id and its call are those that the signer signed.
    pub transaction: Transaction,
    /// The signer.
    pub signer: Identity,
    /// The header of its block.
    pub header: Header,
    /// Its position in the block.
    pub index: u32,
    /// Its verdict.
    pub verdict: Verdict,
    /// The certified block: height, block time in microseconds, and hash.
    pub certified: (u64, u64, Hash),
    /// The nodes that signed it, `ORGANISATION/NAME`.
    pub signed_by: Vec<String>,
    /// How many voters there were.
    pub voters: usize,
    /// Height of the block that made certificates strict, as of the certified one; none if they are not.
    pub strict_since: Option<u64>,
    /// Where the way begins: 0 is the genesis.
    pub began_at: u64,
}

/// The verdict on a transaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// Number of the code.
    pub code: u32,
    /// Hash of the answer.
    pub response: Hash,
}

impl Evidence {
    /// Checks everything, beginning at this genesis; or where its reader has been before, `known`, and then the evidence must begin
    /// there, too.
    ///
    /// # Errors
    /// [`Code::WrongNetwork`], [`Code::Untrusted`], [`Code::BadSignature`] and others: then nothing is proved.
    pub fn check(&self, genesis: &[u8], known: Option<&Governance>) -> Result<Proved, Rejection> {
        let (document, network) = Genesis::from_bytes(genesis)?;
        let founded = beginning(genesis, known)?;
        let Link { headers, proof, .. } = &self.link;
        let certified = self.follow(founded.clone())?;
        let statement = proof.certificate.statement;
        let (first, last) = headers.first().zip(headers.last()).ok_or_else(no_header)?;
        if (last.height, last.time, last.hash()) != (statement.height, statement.time, statement.block) {
            return Err(Rejection::new(Code::Untrusted, "the headers do not lead to the certified block")
                .found(format!("block {}, hash {}", last.height, last.hash()))
                .wanted(format!("block {}, hash {}", statement.height, statement.block)));
        }
        if known.is_some() && first.height <= founded.height() {
            return Err(Rejection::new(Code::Untrusted, "the transaction is older than the checkpoint")
                .found(format!("block {}", first.height))
                .wanted(format!("a block after {}, the block of the checkpoint", founded.height()))
                .next("use an older checkpoint, or none"));
        }
        let changes = self.changes(&founded, &certified)?;
        let (transaction, signer) = self.link.transaction(&network, &founded.before(first.height, &changes)?)?;
        let before = founded.before(statement.height, &changes)?.voters()?;
        let signers = proof.certificate.signatures.iter().filter_map(|signature| before.nodes.get(&signature.node));
        Ok(Proved {
            network,
            label: document.label,
            verdict: self.link.verdict(&transaction)?,
            transaction,
            signer,
            header: first.clone(),
            index: self.link.path.index,
            certified: (statement.height, statement.time, statement.block),
            signed_by: signers.map(|voter| format!("{}/{}", voter.organisation, voter.name)).collect(),
            voters: certified.voters()?.voters.len(),
            strict_since: before.rule.strict_since,
            began_at: founded.height(),
        })
    }

    /// The changes up to the certified block, of which the way has shown that they are all. It leaves out those that come too late
    /// in the file, whatever they say: so they are compared once more.
    fn changes(&self, founded: &Governance, certified: &Governance) -> Result<Vec<Change>, Rejection> {
        let changes: Vec<Change> = self.steps.iter().flat_map(|step| step.changes.iter().cloned()).collect();
        let all = founded.before(certified.height().saturating_add(1), &changes)?;
        if all.chain() == certified.chain() {
            return Ok(changes);
        }
        Err(Rejection::new(Code::Untrusted, "changes of the network were forged or reordered")
            .found(format!("governing chain {}", all.chain()))
            .wanted(format!("the certified one, {}", certified.chain())))
    }

    /// Follows who governs up to the certified block. Each proof on the way must be one that its reader can follow.
    fn follow(&self, founded: Governance) -> Result<Governance, Rejection> {
        let (mut reached, mut changes) = (founded, Vec::new());
        for step in &self.steps {
            changes.extend(step.changes.iter().cloned());
            if let Some(proof) = &step.proof {
                reached = reached.follow(&changes, proof)?;
                changes.retain(|change: &Change| change.height > reached.height());
            }
        }
        reached.follow(&changes, &self.link.proof)
    }

    /// Evidence of a link, by what a node shows of the way from the genesis or from what is known, with as few proofs on it as
    /// there can be.
    ///
    /// # Errors
    /// As [`Evidence::check`].
    pub fn of(
        shown: Vec<Step>,
        link: Link,
        (genesis, known): (&[u8], Option<&Governance>),
    ) -> Result<(Self, Proved), Rejection> {
        let changes: Vec<Change> = shown.iter().flat_map(|step| step.changes.iter().cloned()).collect();
        let short = Self { steps: vec![Step { changes, proof: None }], link };
        if let Ok(proved) = short.check(genesis, known) {
            return Ok((short, proved));
        }
        let mut reached = beginning(genesis, known)?;
        let (mut steps, mut changes) = (Vec::new(), Vec::new());
        for step in shown {
            changes.extend(step.changes);
            let proof = step.proof.into_iter().find_map(|proof| Some((reached.follow(&changes, &proof).ok()?, proof)));
            if let Some((after, proof)) = proof {
                reached = after;
                let later = changes.iter().position(|change| change.height > reached.height());
                let rest = changes.split_off(later.unwrap_or(changes.len()));
                steps.push(Step { changes: std::mem::replace(&mut changes, rest), proof: Some(proof) });
            }
        }
        steps.push(Step { changes, proof: None });
        let evidence = Self { steps, link: short.link };
        let proved = evidence.check(genesis, known)?;
        Ok((evidence, proved))
    }
}

impl Link {
    /// The transaction, and who signed it, by the organisations and revocations as of the block before its own.
    fn transaction(&self, network: &Hash, before: &Governance) -> Result<(Transaction, Identity), Rejection> {
        let header = self.headers.first().ok_or_else(no_header)?;
        if !self.path.leads(leaf(&self.transaction), header.root) {
            return Err(Rejection::new(Code::Untrusted, "the transaction is not part of the block")
                .found("a path that leads to another root")
                .wanted(format!("root {}", header.root)));
        }
        let transaction = Transaction::decode(self.transaction.clone())?;
        crate::execution::check_network(&transaction, network)?;
        transaction.check_time(header.time)?;
        if Hash::of(&[&self.certificate]) != transaction.creator() {
            return Err(Rejection::new(Code::Untrusted, "the certificate is not that of the transaction's creator")
                .found(Hash::of(&[&self.certificate]).to_string())
                .wanted(transaction.creator().to_string()));
        }
        let signer = before.msps()?.verify(&self.certificate, &[], header.time)?;
        if before.is_revoked(&signer) {
            return Err(Rejection::new(
                Code::Revoked,
                "the transaction was signed with a certificate that was revoked before",
            )
            .found(signer.id())
            .wanted(format!("a certificate that was not revoked before block {}", header.height)));
        }
        transaction.verify(&signer.public_key)?;
        Ok((transaction, signer))
    }

    /// The verdict: its way leads over the effects of the same blocks to the certified state digest.
    fn verdict(&self, transaction: &Transaction) -> Result<Verdict, Rejection> {
        let digest = self.proof.ground()?.digest;
        let place = (self.path.index, &transaction.id());
        let (code, response) = self.verdict.check(place, self.headers.len(), digest)?;
        Ok(Verdict { code, response })
    }

    /// The link of a transaction, which a node makes of what it has. `before` is the state digest before its block, `later` are
    /// the blocks after it up to the certified one.
    ///
    /// # Errors
    /// [`Code::Internal`] if there is no such transaction in the block, or the fault of a block that cannot be read.
    pub fn of(
        (own, index): (&Outcome, u32),
        before: Hash,
        certificate: Bytes,
        later: impl Iterator<Item = Result<Arc<Outcome>, Rejection>>,
        proof: Proof,
    ) -> Result<Self, Rejection> {
        let missing = || Rejection::new(Code::Internal, "a block lacks a transaction that it has");
        let leaves: Vec<Hash> = own.transactions.iter().map(|transaction| leaf(transaction)).collect();
        let path = Path::new(&leaves, index).zip(own.transactions.get(index as usize));
        let (path, transaction) = path.ok_or_else(missing)?;
        let verdicts: Vec<Fact<'_>> = verdicts(&own.results).collect();
        let leaves: Vec<Hash> = verdicts.iter().map(Fact::leaf).collect();
        let verdict = verdicts.get(index as usize).and_then(|verdict| Shown::of(verdict, &leaves, index));
        let (mut headers, mut effects) = (vec![own.header.clone()], Vec::new());
        for block in later {
            let block = block?;
            headers.push(block.header.clone());
            effects.push(block.effects());
        }
        let verdict =
            ProvedVerdict { before, writes: own.writes, verdict: verdict.ok_or_else(missing)?, later: effects };
        Ok(Self { transaction: transaction.clone(), certificate, path, headers, verdict, proof })
    }
}

/// Where the way begins: at what its reader knows of this network, else at the genesis.
fn beginning(genesis: &[u8], known: Option<&Governance>) -> Result<Governance, Rejection> {
    let Some(known) = known else { return Genesis::governance(genesis) };
    let network = Genesis::network_of(genesis)?;
    if known.network() == network {
        return Ok(known.clone());
    }
    Err(Rejection::new(Code::WrongNetwork, "the checkpoint belongs to another network")
        .found(known.network().to_string())
        .wanted(format!("{network}, the network of the genesis"))
        .next("use a checkpoint of this network"))
}

fn no_header() -> Rejection {
    Rejection::new(Code::Malformed, "evidence without a header proves nothing")
}
