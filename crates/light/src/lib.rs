//! The knowledge that a robot or an auditor needs to believe a block and a fact in it, without believing any one node.
//!
//! Executing a block gives facts: verdicts, events, writes of control state. Their Merkle root, the *results root*, is what
//! voters sign. Enough signatures are a [`Certificate`]. Nothing here knows a file, a network, a clock or a chaincode, and
//! everything that is read is bounded and may be hostile. docs/format.md has each byte.
//!
//! | module | what is there |
//! |---|---|
//! | [`merkle`] | the tree of RFC 6962: roots, and the path from a leaf to its root |
//! | [`fact`] | the leaves: what executing a block gave |
//! | [`control`] | the chains over writes of control state, which show that none was left out |
//! | [`digest`] | the state digest, and the way from a verdict to that of a later block |
//! | [`statement`] | what a voter says about a block, and its signature |
//! | [`vote`] | who is to lead, as a voter says, and its signature |
//! | [`transfer`] | to whom a leader hands over, and its signature |
//! | [`head`] | the head of a leader's log, and the proof of two in one term |
//! | [`voters`] | whose signatures count, and how many are enough |
//! | [`certificate`] | the statement with enough signatures |
//! | [`proof`] | a certificate with facts of its block |
//! | [`checkpoint`] | where a reader was |
//! | [`governance`] | whom to believe at a height, followed from a pinned beginning |
//! | [`way`] | from where a reader was to the newest proof that it believes |
//! | [`codec`] | reading hostile bytes in one form |
//! | [`lie`] | proofs of misbehaviour: two signed things of one node for one place that differ |
//!
//! ```
//! use ledger_base::hash::Hash;
//! use ledger_light::{fact::Fact, merkle};
//!
//! let facts = [
//!     Fact::Ground { governing: Hash::ZERO, control: Hash::ZERO, digest: Hash::ZERO, previous: Hash::ZERO },
//!     Fact::Verdict { index: 0, id: Hash::ZERO, code: 0, response: Hash::of(&[b"done"]) },
//! ];
//! let leaves: Vec<Hash> = facts.iter().map(Fact::leaf).collect();
//! let root = merkle::root(leaves.clone());
//! let path = merkle::Path::new(&leaves, 1).ok_or("no such leaf")?;
//! assert!(path.leads(leaves[1], root));
//! assert!(!path.leads(leaves[0], root));
//! # Ok::<(), &str>(())
//! ```

#![forbid(unsafe_code)]

pub mod certificate;
pub mod checkpoint;
pub mod codec;
pub mod complaint;
pub mod control;
pub mod digest;
pub mod fact;
pub mod governance;
pub mod head;
pub mod lie;
pub mod merkle;
pub mod proof;
pub mod statement;
pub mod transfer;
pub mod vote;
pub mod voters;
pub mod way;

pub use certificate::Certificate;
pub use checkpoint::Checkpoint;
pub use complaint::Complaint;
pub use digest::ProvedVerdict;
pub use governance::{Change, Governance};
pub use head::{Branch, BranchLink, DoubleHead, Head, block_hash};
pub use lie::{DoubleVote, Fault, Lie, Misbehaviour};
pub use proof::Proof;
pub use statement::{Signature, Signed, Statement};
pub use transfer::Transfer;
pub use vote::Vote;
pub use voters::{CertificateRule, Survives, Voter, Voters, strict_quorum};
pub use way::Way;
