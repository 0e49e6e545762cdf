//! Blocks as bytes, the log when it is opened, the world state.

use crate::founding::bench_directory;
use crate::{BLOCK_TRANSACTIONS, ENTRY_BYTES, timed};
use bytes::Bytes;
use criterion::{BenchmarkId, Criterion, Throughput};
use ledger::block::Payload;
use ledger_base::hash::Hash;
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::RealDisk;
use ledger_storage::entry::{Entry, EntryKind, HardState};
use ledger_storage::state::{SledStore, State, Store, Tip, WriteSet};
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

/// Blocks of the log that is opened.
const RECOVERED_BLOCKS: u64 = 20_000;
/// Keys that a block writes: one robot's command, a busy fleet's.
const STATE_KEYS: [usize; 3] = [1, 10, 100];
/// Bytes of a value: about what is kept of a last message.
const VALUE_BYTES: usize = 96;

fn open(directory: &Path) -> BlockStore {
    BlockStore::open(Arc::new(RealDisk::open(directory).unwrap()), Options::new([1; 32], || 1)).unwrap().0
}

/// The bytes of a block from its transactions and back: what each node does for each block besides executing it.
pub(crate) fn block_encode(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("block_encode");
    for count in BLOCK_TRANSACTIONS {
        let transactions = vec![Bytes::from(vec![7; ENTRY_BYTES[0]]); count];
        let payload = Payload { time: 1, transactions };
        let bytes = payload.to_bytes();
        group.throughput(Throughput::Elements(count as u64));
        group.bench_function(BenchmarkId::new("encode", count), |bencher| {
            bencher.iter(|| black_box(&payload).to_bytes())
        });
        group.bench_function(BenchmarkId::new("decode", count), |bencher| {
            bencher.iter(|| Payload::from_bytes(black_box(&bytes).clone()).unwrap());
        });
    }
    group.finish();
}

/// Opening a log of blocks with one command each; the time is for all of them.
pub(crate) fn recover(criterion: &mut Criterion) {
    let directory = tempfile::tempdir_in(bench_directory()).unwrap();
    {
        let store = open(directory.path());
        let entry = |index| {
            let data = Bytes::from(vec![7; ENTRY_BYTES[0]]);
            Entry { index, term: 1, kind: EntryKind::Normal, data }
        };
        for first in (1..=RECOVERED_BLOCKS).step_by(500) {
            while store.prepare().unwrap() {}
            let entries: Vec<_> = (first..first + 500).map(entry).collect();
            let commit = HardState { term: 1, vote: 1, commit: first + 499 };
            store.append(&entries, Some(&commit)).unwrap();
            store.flush().unwrap();
        }
    }
    let mut group = criterion.benchmark_group("recover");
    group.sample_size(10).throughput(Throughput::Elements(RECOVERED_BLOCKS));
    group.bench_function(BenchmarkId::from_parameter(RECOVERED_BLOCKS), |bencher| {
        bencher.iter(|| assert_eq!(open(directory.path()).last_index(), RECOVERED_BLOCKS));
    });
    group.finish();
}

/// The writes of a block: made visible, which every block waits for, and stored, which happens beside twice a second.
pub(crate) fn state_apply(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("state_apply");
    for count in STATE_KEYS {
        let writes = || -> WriteSet {
            let key = |number| Bytes::from(format!("abac\0last/Robot{number:04}/cmd_vel"));
            (0..count).map(|number| (key(number), Some(Bytes::from(vec![7; VALUE_BYTES])))).collect()
        };
        let directory = tempfile::tempdir_in(bench_directory()).unwrap();
        let state = State::open(Box::new(SledStore::open(directory.path()).unwrap())).unwrap();
        let mut height = 0;
        group.throughput(Throughput::Elements(count as u64));
        group.bench_function(BenchmarkId::new("commit", count), |bencher| {
            let prepare = || {
                height += 1;
                std::cell::Cell::new(Some((writes(), height)))
            };
            timed(bencher, prepare, |input| {
                let (writes, height) = input.take().unwrap();
                state.commit(writes, Tip { height, term: 1, time: 1, hash: Hash::ZERO, digest: Hash::ZERO }, false);
            });
        });
        let directory = tempfile::tempdir_in(bench_directory()).unwrap();
        let store = SledStore::open(directory.path()).unwrap();
        group.sample_size(20).bench_function(BenchmarkId::new("store", count), |bencher| {
            timed(bencher, writes, |writes| store.write(writes, (b"\0tip", b"here")).unwrap());
        });
    }
    group.finish();
}
