//! The engine of a voter that leads a learner, as in the paper's network, without the node around it.

use crate::log;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_raft::{
    Ballot, Ballots, Engine, EngineConfig, ExecutedBlocks, Handover, Input, Lane, Link, LogHead, Membership, Output,
};
use ledger_storage::block_store::BlockStore;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const LEADER: u64 = 1;
const LEARNER: u64 = 2;

/// Votes without keys: there is one election, before anything is measured.
struct Names;

impl Ballots for Names {
    fn sign(&self, ballot: Ballot) -> Result<Bytes, Rejection> {
        Ok(format!("{ballot:?}").into())
    }

    fn check(&self, _ballot: Ballot, _signed: &[u8], _now: u64) -> Result<(), Rejection> {
        Ok(())
    }

    fn sign_handover(&self, handover: Handover) -> Result<Bytes, Rejection> {
        Ok(format!("{handover:?}").into())
    }

    fn check_handover(&self, _handover: Handover, _signed: &[u8], _now: u64) -> Result<(), Rejection> {
        Ok(())
    }

    fn sign_head(&self, _head: LogHead) -> Result<(Bytes, Bytes), Rejection> {
        Ok((Bytes::new(), Bytes::from_static(b"head")))
    }

    fn check_head(&self, _head: LogHead, _vote: &[u8], _signature: &[u8], _now: u64) -> Result<(), Rejection> {
        Ok(())
    }
}

/// Only the genesis block is known: the engine keeps the newest links itself.
struct Genesis;

impl ExecutedBlocks for Genesis {
    fn link(&self, height: u64) -> Option<Link> {
        (height == 0).then_some(Link { hash: Hash::ZERO, time: 0 })
    }
}

/// An engine and its log.
struct Member {
    engine: Engine,
    store: Arc<BlockStore>,
    _log: TempDir,
}

/// The two of them.
pub(crate) struct Engines {
    leader: Member,
    learner: Member,
    now: u64,
}

/// The time that ordering one command took.
pub(crate) struct Ordered {
    /// The engine: from the command to its block, and from the flush to the commit and the message to the learner.
    pub(crate) engine: Duration,
    /// The write and its flush.
    pub(crate) disk: Duration,
}

impl Engines {
    pub(crate) fn start() -> Self {
        let mut engines = Self { leader: Member::start(LEADER), learner: Member::start(LEARNER), now: 1 };
        // A sole voter elects itself.
        let outputs = engines.leader.step(engines.now, Input::Tick);
        engines.settle(outputs);
        engines
    }

    /// Orders a command whose write begins when `ready` returns.
    pub(crate) fn order(&mut self, transaction: &Bytes, ready: impl FnOnce()) -> Ordered {
        self.now += 1000;
        // A thread of the node does this beside the commits.
        while self.leader.store.prepare().unwrap() {}
        let start = Instant::now();
        let proposed = self.leader.step(self.now, Input::Submit { lane: Lane::Data, transaction: transaction.clone() });
        let mut engine = start.elapsed();
        let flush = proposed.iter().find_map(|output| match output {
            Output::Flush { ready } => Some(*ready),
            _ => None,
        });
        ready();
        let start = Instant::now();
        self.leader.store.flush().unwrap();
        let disk = start.elapsed();
        let start = Instant::now();
        let committed = self.leader.step(self.now, Input::Persisted { ready: flush.unwrap() });
        for output in &committed {
            if let Output::Send { message, .. } = output {
                std::hint::black_box(message.to_bytes());
            }
        }
        engine += start.elapsed();
        assert!(committed.iter().any(|output| matches!(output, Output::Commit(_))));
        self.settle(committed);
        Ordered { engine, disk }
    }

    /// Carries out everything until nothing is left, execution included.
    fn settle(&mut self, outputs: Vec<Output>) {
        let mut left: Vec<_> = outputs.into_iter().map(|output| (LEADER, output)).collect();
        while let Some((of, output)) = left.pop() {
            let (member, input) = match output {
                Output::Send { to, message } => (to, Input::Message { from: of, message }),
                Output::Flush { ready } => {
                    self.member(of).store.flush().unwrap();
                    (of, Input::Persisted { ready })
                }
                Output::Commit(blocks) => match blocks.last() {
                    Some(last) => (of, Input::Applied { height: last.index, at: self.now }),
                    None => continue,
                },
                _ => continue,
            };
            let now = self.now;
            left.extend(self.member(member).step(now, input).into_iter().map(|output| (member, output)));
        }
    }

    fn member(&mut self, id: u64) -> &mut Member {
        if id == LEADER { &mut self.leader } else { &mut self.learner }
    }
}

impl Member {
    fn start(id: u64) -> Self {
        let (log, store) = log();
        let store = Arc::new(store);
        let config = EngineConfig::new(id, Membership::new([LEADER], [LEARNER]), id);
        Self {
            engine: Engine::new(config, Arc::clone(&store), Arc::new(Genesis), Arc::new(Names)).unwrap(),
            store,
            _log: log,
        }
    }

    fn step(&mut self, now: u64, input: Input) -> Vec<Output> {
        let mut out = Vec::new();
        self.engine.step(now, input, &mut out);
        out
    }
}
