//! The disk under a node's space. A simulated disk is small: each of its bytes stands for many of a real one.

use ledger_replica::space::{self, Measured, RESERVE_BYTES, Reserve};
use ledger_storage::disk::SimDisk;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Bytes of a real disk for each byte of a simulated one.
const SCALE: u64 = 1024;
/// Bytes of a real disk.
const TOTAL_BYTES: u64 = 1 << 40;
/// The place of the reserve on a simulated disk.
const RESERVE: u64 = RESERVE_BYTES / SCALE;

/// The disk with a node's log, and the reserve beside it. Clones share it.
#[derive(Clone)]
pub struct Ground {
    disk: SimDisk,
    laid: Arc<AtomicBool>,
}

impl Ground {
    /// A disk without a reserve.
    pub fn of(disk: &SimDisk) -> Self {
        Self { disk: disk.clone(), laid: Arc::default() }
    }
}

impl space::Ground for Ground {
    fn measure(&mut self) -> Option<Measured> {
        let free = self.disk.free_bytes().map_or(TOTAL_BYTES, |free| free.saturating_mul(SCALE));
        Some(Measured { free: free.min(TOTAL_BYTES), total: TOTAL_BYTES })
    }

    fn reserve(&self) -> Reserve {
        if self.laid.load(Ordering::Relaxed) { Reserve::Laid } else { Reserve::Missing }
    }

    fn lay(&mut self) {
        self.laid.store(true, Ordering::Relaxed);
        if let Some(free) = self.disk.free_bytes() {
            self.disk.set_capacity(Some(self.disk.used_bytes() + free.saturating_sub(RESERVE)));
        }
    }

    fn give_up(&mut self) -> bool {
        self.laid.store(false, Ordering::Relaxed);
        if let Some(free) = self.disk.free_bytes() {
            self.disk.set_capacity(Some(self.disk.used_bytes() + free + RESERVE));
        }
        true
    }
}
