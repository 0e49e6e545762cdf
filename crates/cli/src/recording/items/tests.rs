#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use super::*;
use mcap::WriteOptions;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;

fn written() -> Vec<u8> {
    let mut file = Vec::new();
    let options = WriteOptions::new().compression(None).disable_seeking(true);
    let mut writer = options.create(NoSeek::new(&mut file)).unwrap();
    let schema = writer.add_schema("std_msgs/msg/String", "ros2msg", b"string data\n").unwrap();
    let about = [("service".to_owned(), "A/a".to_owned())].into();
    let channel_id = writer.add_channel(schema, "/a", "cdr", &about).unwrap();
    writer.write_metadata(&Metadata { name: "about".to_owned(), metadata: about }).unwrap();
    for sequence in 0..3_u32 {
        let log_time = 7 + u64::from(sequence);
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time - 1 };
        writer.write_to_known_channel(&header, &[sequence as u8; 10]).unwrap();
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    file
}

fn read(file: &[u8]) -> (Vec<Item>, Option<Fault>) {
    let mut reader = Reader::new(file);
    let mut items = Vec::new();
    loop {
        match reader.read() {
            Ok(Some(item)) => items.push(item),
            Ok(None) => return (items, None),
            Err(fault) => return (items, Some(fault)),
        }
    }
}

#[test]
fn everything_that_was_written_is_read_in_its_order() {
    let (items, fault) = read(&written());
    assert!(fault.is_none() && items.len() == 5, "{items:?} {fault:?}");
    assert_eq!(items[0], Item::Schema(1, "std_msgs/msg/String".to_owned()));
    let Item::Channel { id, schema: 1, topic, encoding, about } = &items[1] else { unreachable!("{items:?}") };
    assert_eq!((topic.as_str(), encoding.as_str(), about["service"].as_str()), ("/a", "cdr", "A/a"));
    assert_eq!(items[4], Item::Message { channel: *id, log_time: 9, data: vec![2; 10] });
}

#[test]
fn a_file_that_was_cut_is_read_up_to_its_last_whole_chunk() {
    let file = written();
    let whole = read(&file).0;
    for length in 8..file.len() {
        let (items, fault) = read(&file[..length]);
        assert!(whole.starts_with(&items), "{length}");
        assert!(matches!(fault, None | Some(Fault::Cut)), "{length}: {fault:?}");
        assert!(fault.is_some() || items.len() == whole.len(), "{length}");
    }
    for length in 0..8 {
        assert!(matches!(read(&file[..length]).1, Some(Fault::NotMcap)));
    }
}

#[test]
fn no_changed_byte_makes_a_message_another_one() {
    let file = written();
    let whole = read(&file).0;
    for place in 0..file.len() {
        let mut changed = file.clone();
        changed[place] ^= 0x41;
        let (items, _) = read(&changed);
        // Whatever stands in a chunk is covered by its sum; a record in front of it may be lost with its opcode.
        for item in items.iter().filter(|item| matches!(item, Item::Message { .. })) {
            assert!(whole.contains(item), "{place}: {item:?}");
        }
    }
}

#[test]
fn a_length_beyond_everything_allocates_nothing() {
    let mut file = mcap::MAGIC.to_vec();
    file.push(op::METADATA);
    file.extend(u64::MAX.to_le_bytes());
    assert!(matches!(read(&file).1, Some(Fault::Damaged(_))));
    let end = file.len();
    file[end - 8..].copy_from_slice(&(RECORD_BYTES_MAX as u64).to_le_bytes());
    assert!(matches!(read(&file).1, Some(Fault::Cut)));
    // A text that says it is longer than its record.
    let mut channel = vec![0; 4];
    channel.extend(u32::MAX.to_le_bytes());
    let mut file = mcap::MAGIC.to_vec();
    file.push(op::CHANNEL);
    file.extend((channel.len() as u64).to_le_bytes());
    file.extend(channel);
    assert!(matches!(read(&file).1, Some(Fault::Damaged(_))));
}

/// A file with one chunk of these records; without a sum.
fn of_chunk(records: &[u8], compression: &str) -> Vec<u8> {
    let mut chunk = [0; 16].to_vec();
    chunk.extend((records.len() as u64).to_le_bytes());
    chunk.extend([0; 4]);
    chunk.extend((compression.len() as u32).to_le_bytes());
    chunk.extend(compression.as_bytes());
    chunk.extend((records.len() as u64).to_le_bytes());
    chunk.extend(records);
    let mut file = mcap::MAGIC.to_vec();
    file.push(op::CHUNK);
    file.extend((chunk.len() as u64).to_le_bytes());
    file.extend(chunk);
    file
}

#[test]
fn a_record_longer_than_its_chunk_is_damage_and_takes_nothing_from_what_follows() {
    let mut message = vec![op::MESSAGE];
    message.extend(22_u64.to_le_bytes());
    message.extend([0; 22]);
    let (items, fault) = read(&of_chunk(&message, ""));
    assert!(items.len() == 1 && matches!(fault, Some(Fault::Cut)), "{items:?} {fault:?}");
    for length in [23, 24, u64::MAX] {
        message[1..9].copy_from_slice(&length.to_le_bytes());
        let mut file = of_chunk(&message, "");
        file.extend([0; 64]);
        let (items, fault) = read(&file);
        assert!(items.is_empty() && matches!(fault, Some(Fault::Damaged(_))), "{length}: {items:?} {fault:?}");
    }
}

#[test]
fn a_compressed_chunk_is_named() {
    let (items, fault) = read(&of_chunk(&[0; 20], "zstd"));
    assert!(items.is_empty() && matches!(&fault, Some(Fault::Compressed(name)) if name == "zstd"), "{fault:?}");
}
