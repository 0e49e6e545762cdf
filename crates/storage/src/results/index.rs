//! Finding a transaction by its id: a set while its file is written, a sorted table at its end afterwards.

use super::Place;
use crate::disk::DiskFile;
use ledger_base::hash::Hash;
use std::collections::BTreeSet;
use std::io;

/// Bytes of a page of the table.
pub(super) const PAGE_BYTES: usize = 4096;
/// Bytes of one item.
const ITEM_BYTES: usize = 12;
/// Items of a page.
const PAGE_ITEMS: usize = 340;
/// An item holds block and position in one number, the position in so many of its bits.
pub(super) const POSITION_BITS: u32 = 12;
/// Most transactions of a block whose places fit into the index.
pub const INDEXED_TRANSACTIONS_MAX: usize = 1 << POSITION_BITS;
/// Where a page says how many items it has; its CRC follows after zeros.
const COUNT_AT: usize = PAGE_ITEMS * ITEM_BYTES;
const CRC_AT: usize = PAGE_BYTES - 4;
const _: () = assert!(COUNT_AT + 4 <= CRC_AT);

/// One transaction: the beginning of its id, and where it is. Ids may agree in their beginning; the reader compares them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Item {
    /// The first eight bytes of the id, big-endian.
    pub(super) id: u64,
    /// Height of its block above the first of the file.
    pub(super) block: u32,
    /// Position in the block.
    pub(super) position: u32,
}

impl Item {
    pub(super) fn place(&self, first: u64) -> Place {
        Place { height: first + u64::from(self.block), position: self.position }
    }
}

/// The beginning of an id.
pub(super) fn beginning(Hash(id): &Hash) -> u64 {
    id.iter().take(8).fold(0, |number, byte| number << 8 | u64::from(*byte))
}

/// The pages of a table: of items in order, at most 340 each 12 bytes, then their number `u32`, zeros, and CRC-32C of
/// all before it. An item is the id `u64`, then block and position, `u32`: the position in the lower 12 bits; all LE.
pub(super) fn pages(items: &BTreeSet<Item>) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(items.len().div_ceil(PAGE_ITEMS) * PAGE_BYTES);
    let mut items = items.iter().peekable();
    while items.peek().is_some() {
        let mut page = Vec::with_capacity(PAGE_BYTES);
        let mut count = 0u32;
        for item in items.by_ref().take(PAGE_ITEMS) {
            page.extend(item.id.to_le_bytes());
            page.extend((item.block << POSITION_BITS | item.position).to_le_bytes());
            count += 1;
        }
        page.resize(COUNT_AT, 0);
        page.extend(count.to_le_bytes());
        page.resize(CRC_AT, 0);
        page.extend(crc32c::crc32c(&page).to_le_bytes());
        bytes.append(&mut page);
    }
    bytes
}

/// The items of the `count` pages from `start` on whose id begins so.
pub(super) fn find(file: &dyn DiskFile, start: u64, count: u32, id: u64) -> io::Result<Vec<Item>> {
    // The first page whose last item is not below.
    let (mut low, mut high) = (0, count);
    while low < high {
        let middle = low + (high - low) / 2;
        let below = page(file, start, middle)?.last().is_none_or(|last| last.id < id);
        (low, high) = if below { (middle + 1, high) } else { (low, middle) };
    }
    let mut found = Vec::new();
    for number in low..count {
        let items = page(file, start, number)?;
        found.extend(items.iter().filter(|item| item.id == id));
        if items.last().is_none_or(|last| last.id > id) {
            break;
        }
    }
    Ok(found)
}

fn page(file: &dyn DiskFile, start: u64, number: u32) -> io::Result<Vec<Item>> {
    let damaged = || io::Error::new(io::ErrorKind::InvalidData, format!("page {number} of its index is damaged"));
    let mut bytes = vec![0; PAGE_BYTES];
    let read = file.read_at(&mut bytes, start + u64::from(number) * PAGE_BYTES as u64)?;
    let (content, crc) = bytes.split_last_chunk::<4>().filter(|_| read == PAGE_BYTES).ok_or_else(damaged)?;
    if crc32c::crc32c(content) != u32::from_le_bytes(*crc) {
        return Err(damaged());
    }
    let (items, rest) = content.split_at_checked(COUNT_AT).ok_or_else(damaged)?;
    let count = rest.first_chunk().map_or(0, |count| u32::from_le_bytes(*count));
    let read = items.chunks_exact(ITEM_BYTES).take(count as usize).filter_map(|item| {
        let (id, place) = item.split_first_chunk()?;
        let place = u32::from_le_bytes(*place.first_chunk()?);
        let (block, position) = (place >> POSITION_BITS, place & ((1 << POSITION_BITS) - 1));
        Some(Item { id: u64::from_le_bytes(*id), block, position })
    });
    Ok(read.collect())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::disk::{Disk, SimDisk};

    #[test]
    fn every_item_is_found_also_those_that_share_an_id_across_pages() {
        let mut items: BTreeSet<Item> =
            (0..1000u32).map(|n| Item { id: u64::from(n) * 3, block: n, position: n % 7 }).collect();
        let same: Vec<Item> = (0..600).map(|position| Item { id: 900, block: 9, position }).collect();
        items.extend(&same);
        let bytes = pages(&items);
        let file = SimDisk::new(1).create("a").unwrap();
        file.write_at(&bytes, 100).unwrap();
        let count = (bytes.len() / PAGE_BYTES) as u32;
        for item in &items {
            assert!(find(&*file, 100, count, item.id).unwrap().contains(item), "{item:?}");
        }
        assert_eq!(find(&*file, 100, count, 900).unwrap().len(), 601);
        for absent in [1, 2, 2998, u64::MAX] {
            assert_eq!(find(&*file, 100, count, absent).unwrap(), []);
        }
        assert_eq!(find(&*file, 100, 0, 0).unwrap(), []);
    }

    #[test]
    fn a_damaged_page_is_noticed() {
        let bytes = pages(&BTreeSet::from([Item { id: 5, block: 1, position: 1 }]));
        for bit in (0..bytes.len() * 8).step_by(7) {
            let disk = SimDisk::new(1);
            let file = disk.create("a").unwrap();
            file.write_at(&bytes, 0).unwrap();
            assert!(disk.flip("a", bit as u64));
            assert!(find(&*file, 0, 1, 5).is_err(), "bit {bit}");
        }
    }
}
