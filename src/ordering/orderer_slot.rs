//! Where the rest of the node finds the orderer. Engines come and go: there is none while the node fetches blocks
//! that the others have dropped from their logs, or when it stops.

use super::orderer::{Handle, Orderer};
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Input, Status};
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError, RwLock};

/// The place of the orderer.
pub(crate) struct OrdererSlot {
    phase: RwLock<Phase>,
    /// The threads of the running orderer.
    orderer: Mutex<Option<Orderer>>,
    /// How ordering stood last.
    last: Mutex<Option<Status>>,
    /// Nodes that have lied, by proof: no engine follows them.
    excluded: Mutex<BTreeSet<u64>>,
}

enum Phase {
    /// Fetching blocks up to this height; 0 = not known yet.
    CatchingUp(u64),
    Running(Handle),
    Stopping,
}

impl OrdererSlot {
    /// A place for an orderer that is to come.
    pub(crate) fn empty() -> Self {
        Self {
            phase: RwLock::new(Phase::CatchingUp(0)),
            orderer: Mutex::default(),
            last: Mutex::default(),
            excluded: Mutex::default(),
        }
    }

    /// Takes in an orderer; ends it at once if the node is stopping.
    pub(crate) fn take_in(&self, mut orderer: Orderer) {
        let stopping = {
            let mut phase = self.phase.write().unwrap_or_else(PoisonError::into_inner);
            match *phase {
                Phase::Stopping => true,
                _ => {
                    *phase = Phase::Running(orderer.handle().clone());
                    false
                }
            }
        };
        if stopping {
            orderer.stop();
        } else {
            *self.orderer.lock().unwrap_or_else(PoisonError::into_inner) = Some(orderer);
            let excluded = self.excluded.lock().unwrap_or_else(PoisonError::into_inner).clone();
            self.exclude(excluded);
        }
    }

    /// Nothing that these nodes send as leaders or candidates is taken any more, by this engine and all later ones.
    pub(crate) fn exclude(&self, liars: BTreeSet<u64>) {
        self.excluded.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&liars);
        // Without an engine, the next one is given them.
        let _without_an_engine = self.input(Input::Exclude(liars));
    }

    /// Ends the orderer, if there is one, for a node that fetches blocks up to a height. Waits for the threads.
    pub(crate) fn clear(&self, catching_up_to: u64) {
        self.change(|phase| {
            if !matches!(phase, Phase::Stopping) {
                *phase = Phase::CatchingUp(catching_up_to);
            }
        });
    }

    /// Tells how far the node, which has no orderer now, has to catch up.
    pub(crate) fn show_progress(&self, catching_up_to: u64) {
        if let Phase::CatchingUp(to) = &mut *self.phase.write().unwrap_or_else(PoisonError::into_inner) {
            *to = catching_up_to;
        }
    }

    /// Ends the orderer for good. Waits for the threads.
    pub(crate) fn stop(&self) {
        self.change(|phase| *phase = Phase::Stopping);
    }

    fn change(&self, change: impl FnOnce(&mut Phase)) {
        {
            let mut phase = self.phase.write().unwrap_or_else(PoisonError::into_inner);
            if let Phase::Running(handle) = &*phase {
                *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some(handle.status());
            }
            change(&mut phase);
        }
        let orderer = self.orderer.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(mut orderer) = orderer {
            orderer.stop();
        }
    }

    /// The running orderer.
    ///
    /// # Errors
    /// [`Code::Behind`] while the node catches up, [`Code::ShuttingDown`] when it stops.
    pub(crate) fn handle(&self) -> Result<Handle, Rejection> {
        match &*self.phase.read().unwrap_or_else(PoisonError::into_inner) {
            Phase::Running(handle) => Ok(handle.clone()),
            Phase::CatchingUp(to) => Err(Rejection::new(Code::Behind, "this node is fetching missed blocks")
                .wanted(if *to == 0 { String::new() } else { format!("height {to}") })),
            Phase::Stopping => Err(Rejection::new(Code::ShuttingDown, "the node is stopping")),
        }
    }

    /// Hands in a message or a transaction without a copy of the handle.
    ///
    /// # Errors
    /// As [`OrdererSlot::handle`]; [`Code::Overloaded`] if the inbox is full.
    pub(crate) fn input(&self, input: Input) -> Result<(), Rejection> {
        if let Phase::Running(handle) = &*self.phase.read().unwrap_or_else(PoisonError::into_inner) {
            return if handle.input(input) { Ok(()) } else { Err(overloaded()) };
        }
        self.handle().map(drop)
    }

    /// How ordering stands, or stood last; none before it began.
    pub(crate) fn status(&self) -> Option<Status> {
        match &*self.phase.read().unwrap_or_else(PoisonError::into_inner) {
            Phase::Running(handle) => Some(handle.status()),
            _ => self.last.lock().unwrap_or_else(PoisonError::into_inner).clone(),
        }
    }

    /// The height that the node fetches blocks up to; none if it follows as usual.
    pub(crate) fn catching_up_to(&self) -> Option<u64> {
        match &*self.phase.read().unwrap_or_else(PoisonError::into_inner) {
            Phase::CatchingUp(to) => Some(*to),
            _ => None,
        }
    }
}

fn overloaded() -> Rejection {
    Rejection::new(Code::Overloaded, "the node cannot accept more transactions now")
}
