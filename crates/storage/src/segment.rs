//! The files of the log: what their bytes mean, and how to read them without trusting them.
//!
//! A store is a directory of segments, `0000000001-00000000000000000001.seg` and so on: sequence number, then the index
//! of the first entry. Old segments may be dropped from the front. Then every one that is left still tells where the
//! log begins and begins with the hard state. A gap between segments is damage. A segment is a [`SegmentHeader`]
//! followed by records (see [`RecordHeader`]) without gaps, then zeros to the end of the file. All numbers are little
//! endian.
//!
//! A segment is written as `….new` and takes its final name only when its header and first records, and all of its
//! predecessor, are on disk. Hence: a `.seg` file always has a durable header (a bad one is damage, never a torn
//! write), and every segment but the newest is durable as a whole.
//!
//! Three links tell a torn tail (which was never acknowledged and is zeroed) from rot (which is refused):
//! - every record can be recognised on its own. Its header's CRC is salted with the segment's random salt and the
//!   record's offset. So neither recycled bytes nor bytes that a hostile client placed in a payload parse as a record;
//! - every record names its predecessor's CRC, so what a failed attempt left behind never continues the log;
//! - every record says up to where the log was durable when it was written: a bad record before that point is rot.
//!
//! A segment that continues another begins with the hard state and a [`Seal`], which says what that other one holds. So
//! opening a store reads whole only the newest segment, and the others when they are used.

mod error;
mod header;
mod record;
mod scan;
mod seal;
mod window;

pub use error::StoreError;
pub use header::{
    Base, HEADER_BYTES, LogPosition, SEGMENT_BYTES_MAX, SegmentHeader, VERSION, parse_name, segment_name,
};
pub use record::{
    ENTRY_BYTES_MAX, RECORD_BYTES_MAX, RECORD_HEADER_BYTES, Record, RecordHeader, decode_record, encode_record,
    encoded_bytes,
};
pub use scan::{Found, Scan, scan};
pub(crate) use scan::{ScannedSegment, Tail, check_sealed, read_head, read_header};
pub(crate) use seal::MARK_BYTES;
pub use seal::{Contents, SEAL_BYTES_MAX, Seal};
pub(crate) use window::Window;
