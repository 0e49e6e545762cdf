//! A chain of commands in the first node's directory, made without a node: log only, which the node executes when it
//! starts.

use crate::founding::{Founding, clock, robots, twist};
use ledger::block::Payload;
use ledger::block_store::{BlockStore, Options};
use ledger::disk::RealDisk;
use ledger::entry::{Entry, EntryKind, HardState};
use ledger::results::ResultStore;
use ledger::state::{MemoryState, State};
use ledger::transaction::{Body, Transaction};
use ledger::verify::{BLOCKS_DIRECTORY, GENESIS_FILE};
use ledger::{Bytes, Code, Hash, Ledger};
use ledger_abac::Grant;
use ledger_api::Context;
use ledgerd::Node;
use std::sync::Arc;

/// Block time from one block to the next, microseconds.
const BLOCK_EVERY: u64 = 1000;

/// A chain that is wanted.
pub(crate) struct Chain {
    /// Blocks after those that register robots and give Salma the first one.
    pub(crate) blocks: u64,
    /// Commands of a block.
    pub(crate) transactions: u64,
    /// How long commands may be executed, microseconds.
    pub(crate) ttl: u64,
}

impl Chain {
    /// Puts the chain into the first node's directory; answers with its height.
    pub(crate) fn write(&self, founding: &Founding) -> u64 {
        let data = &founding.nodes[0].0;
        let genesis = std::fs::read(data.join(GENESIS_FILE)).unwrap();
        let (_, network) = ledger::network::Genesis::from_bytes(&genesis).unwrap();
        let mut salt = 0;
        let disk = Arc::new(RealDisk::open(data.join(BLOCKS_DIRECTORY)).unwrap());
        let (store, _) = BlockStore::open(
            disk,
            Options::new(network.0, move || {
                salt += 1;
                salt
            }),
        )
        .unwrap();
        let mut nonce = 0_u128;
        let mut time = clock();
        let mut sign = |who: &Context, function: &str, args: Vec<Bytes>, time: u64| {
            nonce += 1;
            let body = Body {
                network: Bytes::copy_from_slice(&who.network.0),
                creator: Bytes::copy_from_slice(&Hash::of(&[&who.chain[0]]).0),
                nonce: Bytes::copy_from_slice(&nonce.to_be_bytes()),
                not_after: time + self.ttl,
                chaincode: "abac".into(),
                function: function.into(),
                args,
            };
            let transaction = Transaction::sign(&body, &who.key).unwrap();
            match function {
                "set" => transaction,
                _ => transaction.with_certificate(Bytes::copy_from_slice(&who.chain[0])).unwrap(),
            }
        };
        // The first two are executed here, to learn the grant.
        let state = Arc::new(State::open(Box::new(MemoryState::default())).unwrap());
        let ledger =
            Ledger::open(&genesis, Node::builder().registry().unwrap(), state, Arc::new(ResultStore::in_memory()))
                .unwrap();
        let mut height = 0;
        let mut append = |transactions: Vec<Bytes>, time: u64| {
            height += 1;
            let data = Payload { time, transactions }.to_bytes();
            let entry = Entry { index: height, term: 1, kind: EntryKind::Normal, data };
            store.append(std::slice::from_ref(&entry), Some(&HardState { term: 1, vote: 1, commit: height })).unwrap();
            if height % 64 == 0 {
                store.flush().unwrap();
            }
            entry
        };
        let setup = sign(&founding.owner, "setup", robots(), time);
        let set_up = ledger.apply(&append(vec![setup.encoded().clone()], time)).unwrap();
        assert_eq!(set_up.results[0].code(), Code::Ok, "{:?}", set_up.results[0]);
        let lease = ["Turtlebot4", "600000"].map(|arg| Bytes::copy_from_slice(arg.as_bytes())).into();
        let acquire = sign(&founding.salma, "acquire", lease, time);
        let granted = ledger.apply(&append(vec![acquire.encoded().clone()], time)).unwrap();
        assert_eq!(granted.results[0].code(), Code::Ok, "{:?}", granted.results[0]);
        let Grant { epoch, mut next_seq, .. } = serde_json::from_slice(&granted.results[0].response).unwrap();
        for _ in 0..self.blocks {
            time += BLOCK_EVERY;
            let transactions = (0..self.transactions).map(|_| {
                let service = Bytes::from_static(b"Turtlebot4/cmd_vel");
                let args = vec![service, epoch.to_string().into(), next_seq.to_string().into(), twist()];
                next_seq += 1;
                sign(&founding.salma, "set", args, time).encoded().clone()
            });
            append(transactions.collect(), time);
        }
        store.flush().unwrap();
        store.last_index()
    }
}
