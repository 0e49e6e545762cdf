//! The bytes of a command on a node's disk, for good.

use crate::support::network::{SERVICE, register_robots};
use crate::support::{Fleet, connect};
use bytes::Bytes;
use ledger_abac::Grant;
use ledger_identity::Role;
use ledger_storage::segment::{HEADER_BYTES, LogPosition, RECORD_HEADER_BYTES, RecordHeader, SegmentHeader};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

/// Bytes of a `geometry_msgs/msg/Twist` with its encapsulation header.
const TWIST: [u8; 52] = {
    let mut twist = [7; 52];
    [twist[0], twist[1], twist[2], twist[3]] = [0, 1, 0, 0];
    twist
};
/// Most bytes that a command alone in its block takes: in the log, and in the results with their index.
const COMMAND_BYTES_MAX: u64 = 550;
/// Of a block that is certified, beside: governing chain, control chain and results root. The first block of each window of block time is one.
const ROOTS_BYTES: f64 = 96.0;
/// Length of such a window.
const WINDOW: Duration = Duration::from_millis(200);
/// Of the index, which is written when a file is finished, for each transaction.
const INDEX_BYTES: u64 = 13;
/// Most bytes of the world state of a few robots. It holds their last messages, however many there were.
const STATE_BYTES_MAX: u64 = 512 * 1024;
const COMMANDS: u64 = 300;

#[derive(Debug)]
struct Taken {
    blocks: u64,
    results: u64,
    state: u64,
}

fn taken(data: &Path, segments: &[std::path::PathBuf]) -> Taken {
    let blocks = segments.iter().map(|path| used(&fs::read(path).unwrap())).sum();
    Taken { blocks, results: directory(&data.join("results")), state: directory(&data.join("state")) }
}

/// Bytes of a segment without the zeros at its end.
fn used(segment: &[u8]) -> u64 {
    let (header, _) = SegmentHeader::decode(segment).unwrap();
    let mut offset = HEADER_BYTES;
    while let Some(rest) = segment.get(offset as usize..).filter(|rest| rest.len() > RECORD_HEADER_BYTES) {
        let position = LogPosition { sequence: header.sequence, offset: offset as u32 };
        let Ok(found) = RecordHeader::decode(rest, header.salt, position) else { break };
        offset += found.record_bytes() as u64;
    }
    offset
}

fn directory(path: &Path) -> u64 {
    let entries = fs::read_dir(path).unwrap().map(Result::unwrap);
    entries
        .map(|entry| if entry.path().is_dir() { directory(&entry.path()) } else { entry.metadata().unwrap().len() })
        .sum()
}

#[tokio::test]
async fn a_command_alone_in_its_block_takes_less_than_550_bytes() {
    let fleet = Fleet::found(1);
    let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]));
    let place = &fleet.nodes[0];
    let (mut counts, mut windows) = (Vec::new(), 0.0);
    for commands in [10, COMMANDS] {
        let mut node = place.start();
        let client = connect(&salma).await;
        if counts.is_empty() {
            register_robots(&connect(&owner).await, "exclusive").await;
            client.invoke("abac", "acquire", vec![SERVICE.into(), "600000".into()]).await.unwrap();
        }
        let renewed = client.invoke("abac", "renew", vec![SERVICE.into()]).await.unwrap();
        let Grant { epoch, next_seq, .. } = serde_json::from_slice(&renewed.response).unwrap();
        let first = next_seq.max(1_795_228_838_000_000);
        let begun = Instant::now();
        for seq in first..first + commands {
            let args =
                vec![SERVICE.into(), epoch.to_string().into(), seq.to_string().into(), Bytes::from_static(&TWIST)];
            client.invoke("abac", "set", args).await.unwrap();
        }
        windows = begun.elapsed().div_duration_f64(WINDOW) + 1.0;
        node.interrupt();
        counts.push(taken(&place.data, &place.segments()));
    }
    let [before, after] = counts.as_slice() else { unreachable!() };
    let each = |of: fn(&Taken) -> u64| (of(after) - of(before)) as f64 / COMMANDS as f64;
    let [blocks, results] = [each(|taken| taken.blocks), each(|taken| taken.results) + INDEX_BYTES as f64];
    println!("bytes of a command: {blocks:.0} in the log, {results:.0} in results; {after:?}");
    let roots = windows * ROOTS_BYTES / COMMANDS as f64;
    assert!(blocks + results < COMMAND_BYTES_MAX as f64 + roots, "{before:?} {after:?}");
    assert!(after.state < STATE_BYTES_MAX, "{after:?}");
}
