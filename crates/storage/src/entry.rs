//! The content of the log: entries, and the hard state of the orderer.

use bytes::Bytes;

/// One entry of the ordering log. A committed entry is a block; its index is the height.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Place in the log. Starts at 1; 0 is the genesis block, which is not stored here.
    pub index: u64,
    /// Term of the leader that proposed it. Never falls from one entry to the next.
    pub term: u64,
    /// The meaning of `data` to the orderer.
    pub kind: EntryKind,
    /// The content, opaque to the store. Empty for the entry a new leader starts with.
    pub data: Bytes,
}

/// The kind of the data of an entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EntryKind {
    /// Transactions, or nothing.
    Normal,
    /// A change of the membership, one node at a time.
    ConfChange,
    /// A change of the membership in joint steps.
    ConfChangeV2,
}

impl EntryKind {
    /// The byte that stands for it on disk.
    pub const fn code(self) -> u8 {
        match self {
            Self::Normal => 1,
            Self::ConfChange => 2,
            Self::ConfChangeV2 => 3,
        }
    }

    /// The kind a byte stands for, if any.
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            1 => Some(Self::Normal),
            2 => Some(Self::ConfChange),
            3 => Some(Self::ConfChangeV2),
            _ => None,
        }
    }
}

/// The facts that a voter must not forget across a restart, besides its entries.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct HardState {
    /// Newest term seen. Never falls.
    pub term: u64,
    /// The node that got this node's vote in `term`; 0 for none.
    pub vote: u64,
    /// Everything up to this index is committed. May lag behind what is known in memory.
    pub commit: u64,
}
