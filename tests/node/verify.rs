//! `ledgerd verify`: whatever is changed in a node's directory is found, and its place named.

use crate::support::ctl::verify;
use crate::support::network::{message, register_robots};
use crate::support::wait::eventually;
use crate::support::{Fleet, connect};
use ledger::block::Payload;
use ledger_identity::Role;
use ledger_storage::segment::{
    HEADER_BYTES, LogPosition, RECORD_HEADER_BYTES, Record, RecordHeader, SegmentHeader, decode_record, encode_record,
};
use std::fs;
use std::path::PathBuf;

/// A node attests when it starts, and not again while a test runs.
const ATTESTS_ONCE: &str = "attest_ms = 3600000";
/// Most transactions of the node itself: one for each CA that it carries, and the attestation, if there was time for them.
const OF_THE_NODE: u64 = 3;

/// A record of a segment and where it stands.
struct Placed {
    offset: u64,
    durable_upto: LogPosition,
    record: Record,
}

fn read(segment: &[u8]) -> (SegmentHeader, u32, Vec<Placed>) {
    let (header, crc) = SegmentHeader::decode(segment).unwrap();
    let mut offset = HEADER_BYTES;
    let mut records = Vec::new();
    while let Some(rest) = segment.get(offset as usize..) {
        let position = LogPosition { sequence: header.sequence, offset: offset as u32 };
        let Ok(found) = RecordHeader::decode(rest, header.salt, position) else { break };
        let record = decode_record(&found, &rest[RECORD_HEADER_BYTES..found.record_bytes()]).unwrap();
        records.push(Placed { offset, durable_upto: found.durable_upto, record });
        offset += found.record_bytes() as u64;
    }
    (header, crc, records)
}

/// The segment again, with every checksum as it has to be.
fn write(mut segment: Vec<u8>, header: &SegmentHeader, mut previous: u32, records: &[Placed]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for placed in records {
        let offset = HEADER_BYTES as usize + bytes.len();
        previous = encode_record(&placed.record, header.salt, offset as u32, previous, placed.durable_upto, &mut bytes);
    }
    let end = HEADER_BYTES as usize + bytes.len();
    segment[HEADER_BYTES as usize..end].copy_from_slice(&bytes);
    segment
}

/// A network with some history; its node is stopped.
async fn stopped() -> (Fleet, PathBuf) {
    let fleet = Fleet::found(1);
    fleet.nodes[0].configure(&format!("[order]\n{ATTESTS_ONCE}"));
    let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]));
    let mut node = fleet.nodes[0].start();
    let owner = connect(&owner).await;
    register_robots(&owner, "open").await;
    let client = connect(&salma).await;
    for seq in 0..12 {
        client.invoke("abac", "set", message(0, seq, b"forward")).await.unwrap();
    }
    verify(&fleet.nodes[0].data).refused(3, &["LGR-7002", "stop the node"]);
    node.check();
    node.interrupt();
    let segment = fleet.nodes[0].segments().remove(0);
    (fleet, segment)
}

#[tokio::test]
async fn a_right_directory_is_right_and_a_running_node_or_another_directory_is_an_error() {
    let (fleet, _) = stopped().await;
    let data = fleet.nodes[0].data.clone();
    let report = verify(&data).ok().json();
    assert_eq!(report["ok"], true);
    assert!((13..=13 + OF_THE_NODE).contains(&report["transactions"].as_u64().unwrap()), "{report}");
    assert_eq!(report["verdicts"]["OK"], report["transactions"]);
    assert_eq!(report["state_compared"], true);
    verify(&fleet.home()).refused(3, &["LGR-7002", "genesis.json"]);
    verify("/nowhere".as_ref()).refused(3, &["LGR-7002", "/nowhere"]);
    // Without the state there is less to compare, and still everything to execute.
    fs::remove_dir_all(fleet.nodes[0].data.join("state")).unwrap();
    let report = verify(&data).ok().json();
    // The log itself may not know yet that its last block is committed; then that one is only counted.
    let seen = report["transactions"].as_u64().unwrap() + report["uncommitted"].as_u64().unwrap();
    assert!((13..=13 + OF_THE_NODE).contains(&seen) && report["state_compared"] == false, "{report}");
    assert!(!fleet.nodes[0].data.join("state").exists(), "verifying has made a directory");
}

#[tokio::test]
async fn every_changed_byte_is_found_and_its_place_named() {
    let (fleet, path) = stopped().await;
    let data = fleet.nodes[0].data.clone();
    let file = path.file_name().unwrap().to_string_lossy().into_owned();
    let right = fs::read(&path).unwrap();
    let (_, _, records) = read(&right);
    let mut faults = 0;
    // Headers, checksums, payloads, from the first byte to the last record.
    let mut places: Vec<u64> = vec![0, 8, 16, 48, 56, 92];
    places.extend(records.iter().flat_map(|placed| [placed.offset, placed.offset + 12, placed.offset + 30]));
    for place in places {
        let mut wrong = right.clone();
        wrong[place as usize] ^= 0x04;
        fs::write(&path, &wrong).unwrap();
        let told = verify(&data);
        if told.code == 0 && place >= records.last().unwrap().offset {
            // Nothing after it proves that it was written as a whole: a torn tail, and nothing was promised by it.
            assert!(told.json()["torn_bytes"].as_u64() > Some(0), "{told:?}");
            continue;
        }
        let told = told.refused(1, &["LGR-500", &file, "byte"]);
        // The place that is named is the record with the changed byte, or the header's.
        let start = records.iter().map(|placed| placed.offset).filter(|start| *start <= place).max().unwrap_or(0);
        let named: Vec<u64> = told.stderr.split("byte ").skip(1).filter_map(number).collect();
        assert!(named.iter().any(|named| (start..=place).contains(named)), "byte {place} of record {start}: {told:?}");
        faults += 1;
    }
    println!("verify: {faults} bytes changed");
}

fn number(text: &str) -> Option<u64> {
    let digits: String = text.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().ok()
}

#[tokio::test]
async fn a_forger_who_makes_all_checksums_fit_is_found_out() {
    let (fleet, path) = stopped().await;
    let data = fleet.nodes[0].data.clone();
    let file = path.file_name().unwrap().to_string_lossy().into_owned();
    let right = fs::read(&path).unwrap();
    assert_eq!(
        {
            let (header, crc, records) = read(&right);
            write(right.clone(), &header, crc, &records)
        },
        right,
        "the forger's tools"
    );
    let mut faults = 0;
    for state in ["kept", "deleted"] {
        if state == "deleted" {
            fs::remove_dir_all(fleet.nodes[0].data.join("state")).unwrap();
        }
        for index in 0..read(&right).2.len() {
            let (header, crc, mut records) = read(&right);
            let offset = records[index].offset;
            // Without the state, the last block may not be known to be committed.
            let later = records[index + 1..].iter().any(|placed| matches!(placed.record, Record::Entry(_)));
            let Record::Entry(entry) = &mut records[index].record else { continue };
            if !later {
                continue;
            }
            let mut payload = Payload::from_bytes(entry.data.clone()).unwrap();
            // What was said to the robot. A block may also have what the node says of its own.
            let said = payload.transactions.iter_mut().find_map(|transaction| {
                let at = transaction.windows(7).position(|window| window == b"forward")?;
                Some((transaction, at))
            });
            let Some((transaction, at)) = said else { continue };
            let mut bytes = transaction.to_vec();
            bytes[at] = b'F';
            *transaction = bytes.into();
            entry.data = payload.to_bytes();
            fs::write(&path, write(right.clone(), &header, crc, &records)).unwrap();
            let byte = format!("{file} byte {offset}");
            // Without the state nothing is left to compare with: the signature alone shows that nobody signed this.
            verify(&data).refused(1, &["LGR-5004", &byte]);
            faults += 1;
        }
    }
    println!("verify: {faults} forgeries");
    assert!(faults >= 20);
}

#[tokio::test]
async fn a_torn_tail_is_told_and_a_cut_before_what_was_durable_is_refused() {
    let (fleet, path) = stopped().await;
    let data = fleet.nodes[0].data.clone();
    let right = fs::read(&path).unwrap();
    let (_, _, records) = read(&right);
    // The last record is torn: nobody relied on it, or the state shows that somebody did.
    let last = records.last().unwrap();
    let mut torn = right.clone();
    torn[last.offset as usize + 20..].fill(0);
    fs::write(&path, &torn).unwrap();
    let ran = verify(&data);
    match ran.code {
        0 => assert!(ran.json()["torn_bytes"].as_u64() > Some(0), "{ran:?}"),
        _ => drop(ran.refused(1, &["LGR-5004"])),
    }
    // In the middle it is not a tail.
    let middle = &records[records.len() / 2];
    let mut torn = right.clone();
    torn[middle.offset as usize + 30..middle.offset as usize + 40].fill(0);
    fs::write(&path, &torn).unwrap();
    verify(&data).refused(1, &["LGR-500", "byte"]);
    // The whole second half gone: the state has seen more.
    let mut torn = right.clone();
    torn[middle.offset as usize..].fill(0);
    fs::write(&path, &torn).unwrap();
    verify(&data).refused(1, &["LGR-5004", "missing"]);
    // The file itself shortened.
    fs::write(&path, &right[..middle.offset as usize + 3]).unwrap();
    verify(&data).refused(1, &["LGR-500"]);
    println!("verify: 4 cuts");
}

#[tokio::test]
async fn an_archive_of_a_quiet_node_reaches_the_newest_block_while_it_runs_and_when_it_has_stopped() {
    let fleet = Fleet::found(1);
    let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]));
    let mut node = fleet.nodes[0].start();
    let owner = connect(&owner).await;
    register_robots(&owner, "open").await;
    let client = connect(&salma).await;
    let (data, to) = (fleet.nodes[0].data.clone(), fleet.path().join("archive"));
    let archive = ["ledger", "archive", &data.to_string_lossy(), "--to", &to.to_string_lossy()];
    for seq in 0..3 {
        let published = client.invoke("abac", "set", message(0, seq, b"forward")).await.unwrap();
        let archived = eventually("the archive has the block", || {
            let archived = fleet.ctl().json(&archive);
            (archived["last_height"].as_u64() >= Some(published.height)).then_some(archived)
        });
        assert_eq!((&archived["first_height"], &archived["blocks"]), (&1.into(), &archived["last_height"]));
        let report = verify(&to).ok().json();
        assert_eq!((&report["height"], &report["first_height"]), (&archived["last_height"], &1.into()), "{report}");
        assert_eq!((&report["uncommitted"], &report["torn_bytes"]), (&0.into(), &0.into()), "{report}");
    }
    assert_eq!(fleet.nodes[0].segments().len(), 1, "no segment is finished");
    node.check();
    node.interrupt();
    let archived = fleet.ctl().json(&archive);
    let (whole, report) = (verify(&data).ok().json(), verify(&to).ok().json());
    assert_eq!((&report["height"], &report["state_digest"]), (&archived["last_height"], &whole["state_digest"]));
    assert_eq!((&report["transactions"], &report["height"]), (&whole["transactions"], &whole["height"]), "{whole}");
}

#[tokio::test]
async fn the_blocks_of_a_running_node_are_archived_and_the_archive_verifies_alone() {
    let fleet = Fleet::found(1);
    let settings = "[limits]\npayload_bytes_max = 65536\n[storage]\nsegment_mib = 1\n[order]\n";
    fleet.nodes[0].configure(&format!("{settings}{ATTESTS_ONCE}"));
    let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]));
    let mut node = fleet.nodes[0].start();
    let owner = connect(&owner).await;
    register_robots(&owner, "open").await;
    let client = connect(&salma).await;
    let image = vec![7; 40_000];
    let (data, to) = (fleet.nodes[0].data.clone(), fleet.path().join("archive"));
    let archive = ["ledger", "archive", &data.to_string_lossy(), "--to", &to.to_string_lossy()];
    let mut last_height = 0;
    for round in 0..3 {
        for seq in 0..40 {
            client.invoke("abac", "set", message(0, round * 40 + seq, &image)).await.unwrap();
        }
        let archived = fleet.ctl().json(&archive);
        assert!(archived["segments_copied"].as_u64() > Some(0), "{archived}");
        assert!(archived["last_height"].as_u64() > Some(last_height), "{archived}");
        last_height = archived["last_height"].as_u64().unwrap();
        let report = verify(&to).ok().json();
        assert_eq!((&report["ok"], &report["first_height"]), (&true.into(), &1.into()));
        assert_eq!(report["height"].as_u64(), Some(last_height), "{report}");
    }
    node.check();
    node.interrupt();
    let report = verify(&data).ok().json();
    assert!((121..=121 + OF_THE_NODE).contains(&report["transactions"].as_u64().unwrap()), "{report}");
    println!("archive: up to block {last_height}");
}
