//! MCAP, the container in which ROS 2 keeps recordings: <https://mcap.dev/spec>. Written in chunks without compression, and
//! read from the beginning.
//!
//! ```text
//! magic  Header  (Chunk MessageIndex… | Metadata)…  DataEnd  summary  Footer  magic
//!                 └ Schema, Channel, Message…                └ what stands where, for readers that seek
//!
//! record   opcode u8, length of the content u64, content
//! text     length u32, UTF-8
//! map      length in bytes u32, keys with values
//! ```
//! All numbers are little endian. A reader skips records that it does not know. A chunk comes into the file as a whole: what a
//! killed writer leaves behind has everything but its last chunk.

mod fields;
mod reader;
mod writer;

pub use reader::{Fault, Item, Reader};
pub use writer::{Stamp, Writer};

/// At both ends of a file.
const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// The opcodes of records.
mod op {
    pub(super) const HEADER: u8 = 0x01;
    pub(super) const FOOTER: u8 = 0x02;
    pub(super) const SCHEMA: u8 = 0x03;
    pub(super) const CHANNEL: u8 = 0x04;
    pub(super) const MESSAGE: u8 = 0x05;
    pub(super) const CHUNK: u8 = 0x06;
    pub(super) const MESSAGE_INDEX: u8 = 0x07;
    pub(super) const CHUNK_INDEX: u8 = 0x08;
    pub(super) const STATISTICS: u8 = 0x0b;
    pub(super) const METADATA: u8 = 0x0c;
    pub(super) const METADATA_INDEX: u8 = 0x0d;
    pub(super) const SUMMARY_OFFSET: u8 = 0x0e;
    pub(super) const DATA_END: u8 = 0x0f;
}
