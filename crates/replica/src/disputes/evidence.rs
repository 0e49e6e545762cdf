//! The proofs of misbehaviour that a node has: one of each kind of a node.

use ledger_light::Misbehaviour;
use std::collections::BTreeSet;
use std::mem::discriminant;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The proofs.
#[derive(Debug, Default)]
pub struct Evidence(Mutex<Vec<Misbehaviour>>);

impl Evidence {
    /// Those that the disk holds.
    pub fn new(proofs: Vec<Misbehaviour>) -> Self {
        Self(Mutex::new(proofs))
    }

    /// All of them.
    pub fn proofs(&self) -> Vec<Misbehaviour> {
        self.lock().clone()
    }

    /// Is there a proof that says as much?
    pub fn has(&self, proof: &Misbehaviour) -> bool {
        self.lock().iter().any(|known| says_as_much(known, proof))
    }

    /// Keeps a proof; false if there was one that says as much.
    pub fn add(&self, proof: &Misbehaviour) -> bool {
        let mut proofs = self.lock();
        let is_new = !proofs.iter().any(|known| says_as_much(known, proof));
        proofs.extend(is_new.then(|| proof.clone()));
        is_new
    }

    /// The nodes that have lied. A fault is no lie.
    pub fn liars(&self) -> BTreeSet<u64> {
        self.lock().iter().filter(|proof| proof.is_lie()).map(Misbehaviour::node).collect()
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Misbehaviour>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Of one node and kind, one proof is enough.
fn says_as_much(one: &Misbehaviour, other: &Misbehaviour) -> bool {
    one.node() == other.node() && discriminant(one) == discriminant(other)
}
