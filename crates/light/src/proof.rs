//! Proofs: a certificate, and facts of its block with their paths to the results root.

use crate::certificate::{CERTIFICATE_BYTES_MAX, Certificate};
use crate::codec::{Reader, put};
use crate::fact::{FACT_BYTES_MAX, Fact};
use crate::merkle::{PATH_BYTES_MAX, Path};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};

const DOMAIN: &[u8] = b"ledgerd proof v1\0";
/// Most facts of one proof.
pub const FACTS_MAX: usize = 64;
/// Longest encoding.
pub const PROOF_BYTES_MAX: usize =
    DOMAIN.len() + 4 + CERTIFICATE_BYTES_MAX + 4 + FACTS_MAX * (8 + FACT_BYTES_MAX + PATH_BYTES_MAX);

/// A fact, and the way from it to the results root.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shown {
    /// The bytes of the [`Fact`].
    pub fact: Bytes,
    /// Its path.
    pub path: Path,
}

/// A certificate with facts of its block. The first one is the ground.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Proof {
    /// The certificate.
    pub certificate: Certificate,
    /// The ground, then others.
    pub facts: Vec<Shown>,
}

/// The ground of a certified block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ground {
    /// The governing chain after the block.
    pub governing: Hash,
    /// The control chain after the block.
    pub control: Hash,
    /// The state digest after the block.
    pub digest: Hash,
}

impl Shown {
    /// The fact at a position among the leaves of a block; none if there is no such leaf.
    pub fn of(fact: &Fact<'_>, leaves: &[Hash], index: u32) -> Option<Self> {
        Some(Self { fact: fact.to_bytes().into(), path: Path::new(leaves, index)? })
    }
}

impl Proof {
    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = DOMAIN.to_vec();
        put(&mut bytes, &self.certificate.to_bytes());
        bytes.extend_from_slice(&(self.facts.len() as u32).to_be_bytes());
        for Shown { fact, path } in &self.facts {
            put(&mut bytes, fact);
            put(&mut bytes, &path.to_bytes());
        }
        bytes.into()
    }

    /// Reads its bytes. Nothing is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("a proof", PROOF_BYTES_MAX, DOMAIN, bytes)?;
        let certificate = Certificate::from_bytes(reader.part(CERTIFICATE_BYTES_MAX)?)?;
        let count = reader.u32()? as usize;
        if count > FACTS_MAX {
            return Err(reader.malformed(&format!("{count} facts"), &format!("at most {FACTS_MAX}")));
        }
        let mut facts = Vec::new();
        for _ in 0..count {
            let fact = reader.part_owned(FACT_BYTES_MAX)?;
            facts.push(Shown { fact, path: Path::from_bytes(reader.part(PATH_BYTES_MAX)?)? });
        }
        reader.end()?;
        Ok(Self { certificate, facts })
    }

    /// The ground, if its path leads to the certified root. Whether enough have signed is not checked here.
    ///
    /// # Errors
    /// [`Code::Untrusted`] if it does not, [`Code::Malformed`].
    pub fn ground(&self) -> Result<Ground, Rejection> {
        let first = self.facts.first().filter(|shown| shown.path.index == 0);
        let fact = first.map(|shown| self.fact(shown)).transpose()?;
        match fact {
            Some(Fact::Ground { governing, control, digest, .. }) => Ok(Ground { governing, control, digest }),
            _ => Err(Rejection::new(Code::Malformed, "a proof does not begin with the ground of its block")
                .wanted("the ground first, which is the first leaf of the block")
                .next("ask another node for it")),
        }
    }

    /// The facts after the ground, each of whose paths leads to the certified root.
    ///
    /// # Errors
    /// [`Code::Untrusted`] at the first one whose path does not, [`Code::Malformed`].
    pub fn others(&self) -> Result<Vec<Fact<'_>>, Rejection> {
        self.facts.iter().skip(1).map(|shown| self.fact(shown)).collect()
    }

    /// Does it show that this transaction succeeded with this answer? As nobody knows the id before, the answer is newer then
    /// than the transaction.
    ///
    /// # Errors
    /// [`Code::Untrusted`] if it does not; as [`Proof::others`].
    pub fn answers(&self, id: &Hash, answer: &[u8]) -> Result<(), Rejection> {
        let (shown, wanted) = (self.others()?, Hash::of(&[answer]));
        let is_proved = shown.iter().any(|fact| match fact {
            Fact::Verdict { id: of, code, response, .. } => of == id && *code == 0 && *response == wanted,
            _ => false,
        });
        if is_proved {
            return Ok(());
        }
        Err(Rejection::new(Code::Untrusted, "the proof does not show this answer to this transaction")
            .found(format!("{} facts of block {}", shown.len(), self.certificate.statement.height))
            .wanted(format!("the verdict on transaction {id}"))
            .next("ask another node"))
    }

    /// Does it show that the block gave this event?
    ///
    /// # Errors
    /// [`Code::Untrusted`] if it does not; as [`Proof::others`].
    pub fn gives(&self, chaincode: &str, name: &str, subject: &str, payload: &[u8]) -> Result<(), Rejection> {
        let (shown, wanted) = (self.others()?, Hash::of(&[payload]));
        let is_proved = shown.iter().any(|fact| match *fact {
            Fact::Event { chaincode: of, name: named, subject: about, payload, .. } => {
                (of, named, about, payload) == (chaincode, name, subject, wanted)
            }
            _ => false,
        });
        if is_proved {
            return Ok(());
        }
        Err(Rejection::new(Code::Untrusted, "the proof does not show this event")
            .found(format!("{} facts of block {}", shown.len(), self.certificate.statement.height))
            .wanted(format!("{chaincode} {name} about {subject:?}"))
            .next("ask another node"))
    }

    fn fact<'a>(&self, shown: &'a Shown) -> Result<Fact<'a>, Rejection> {
        let fact = Fact::from_bytes(&shown.fact)?;
        if shown.path.leads(fact.leaf(), self.certificate.statement.results) {
            return Ok(fact);
        }
        Err(Rejection::new(Code::Untrusted, "a fact is not one of the block that its proof names")
            .found(format!("a path from leaf {} of {} to another root", shown.path.index, shown.path.count))
            .wanted(format!("results root {}", self.certificate.statement.results))
            .next("ask another node for it"))
    }
}
