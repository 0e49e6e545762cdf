use std::{
  cmp::min,
  collections::{btree_map::Entry, BTreeMap},
  fmt, iter,
  time::{Duration, Instant},
};

use enumflags2::BitFlags;
use bytes::{Bytes, BytesMut};
#[allow(unused_imports)]
use log::{debug, error, info, trace, warn};

use crate::{
  dds::ddsdata::DDSData,
  messages::submessages::{
    elements::serialized_payload::SerializedPayload,
    submessages::{DATAFRAG_Flags, DataFrag},
  },
  rtps::constant::{
    MAX_ASSEMBLY_BYTES_PER_WRITER, MAX_FRAGMENTED_SAMPLE_BYTES, MAX_FRAGMENTS_PER_SAMPLE,
  },
  structure::{
    cache_change::ChangeKind,
    sequence_number::{FragmentNumber, SequenceNumber},
  },
};

// Consecutive fragments that were received.
struct Run {
  fragment_count: usize,
  bytes: Box<[u8]>,
}

// This is for the assembly of a single object. It holds the bytes that were
// received: what a DATAFRAG says about the size of the object reserves nothing.
struct AssemblyBuffer {
  data_size: usize,
  // Writer must guarantee constant fragment size per SequenceNumber. RTPS spec v2.5
  // Section 8.4.14.1.1 "How to select the fragment size" even says that it is fixed
  // per-writer.
  fragment_size: usize,
  fragment_count: usize,
  // By the index (from 0) of their first fragment. No two of them overlap.
  runs: BTreeMap<usize, Run>,
  received_fragments: usize,
  received_bytes: usize,

  #[allow(dead_code)] // TODO: Purpose is to use this later for e.g.
  // garbage collection, in case some buffer is not completed within reasonable time.
  created_time: Instant,
  modified_time: Instant,
}

impl AssemblyBuffer {
  pub fn new(datafrag: &DataFrag) -> Option<Self> {
    let data_size: usize = datafrag.data_size.try_into().ok()?;
    let fragment_size = usize::from(datafrag.fragment_size);
    debug!("new AssemblyBuffer data_size={data_size} frag_size={fragment_size}");

    if fragment_size == 0 || fragment_size > data_size || FragmentAssembler::is_too_large(datafrag)
    {
      error!("Cannot create AssemblyBuffer: fragment_size={fragment_size} data_size={data_size}");
      return None;
    }

    let now = Instant::now();

    Some(Self {
      data_size,
      fragment_size,
      fragment_count: usize::from(datafrag.total_number_of_fragments()),
      runs: BTreeMap::new(),
      received_fragments: 0,
      received_bytes: 0,
      created_time: now,
      modified_time: now,
    })
  }

  /// Returns `false` if the fragment run is invalid or out of bounds.
  pub fn insert_frags(&mut self, datafrag: &DataFrag) -> bool {
    debug!(
      "insert_frags: datafrag.writer_sn = {:?}, datafrag.fragment_size = {:?}, \
       datafrag.fragment_starting_num = {:?}, datafrag.fragments_in_submessage = {:?}, \
       datafrag.data_size = {:?}",
      datafrag.writer_sn,
      datafrag.fragment_size,
      datafrag.fragment_starting_num,
      datafrag.fragments_in_submessage,
      datafrag.data_size
    );

    if datafrag.data_size as usize != self.data_size
      || usize::from(datafrag.fragment_size) != self.fragment_size
    {
      error!(
        "insert_frags: sizes of {:?} have changed: data_size={} frag_size={}, were {} and {}",
        datafrag.writer_sn,
        datafrag.data_size,
        datafrag.fragment_size,
        self.data_size,
        self.fragment_size
      );
      return false;
    }
    let frags_in_submessage = usize::from(datafrag.fragments_in_submessage);
    if frags_in_submessage == 0 {
      error!("insert_frags: fragments_in_submessage is zero");
      return false;
    }
    // Fragment numbers start at 1
    let Some(first) = usize::from(datafrag.fragment_starting_num).checked_sub(1) else {
      error!(
        "insert_frags: invalid fragment_starting_num {:?}",
        datafrag.fragment_starting_num
      );
      return false;
    };
    let end = first + frags_in_submessage;
    if end > self.fragment_count {
      error!(
        "insert_frags: fragment span out of bounds: start={} count={frags_in_submessage} total={}",
        first + 1,
        self.fragment_count
      );
      return false;
    }
    // Fragments without their bytes would make a sample of what was never sent.
    let payload = &datafrag.serialized_payload;
    if payload.len() < self.byte_at(end) - self.byte_at(first) {
      error!(
        "Received DATAFRAG too small. fragment_starting_num={} out of fragment_count={}, \
         frags_in_submessage={}, frag_size={} but payload length = {}. Original data_size={}",
        first + 1,
        self.fragment_count,
        frags_in_submessage,
        self.fragment_size,
        payload.len(),
        self.data_size,
      );
      return false;
    }

    // Keep what is new.
    let mut at = first;
    while at < end {
      let known_until = self.runs.range(..=at).next_back();
      let known_until = known_until.map_or(0, |(start, run)| start + run.fragment_count);
      if known_until > at {
        at = known_until;
        continue;
      }
      let next_known = self.runs.range(at..).next().map(|(start, _)| *start);
      let until = next_known.map_or(end, |start| min(start, end));
      let offset = self.byte_at(first);
      let bytes = &payload[self.byte_at(at) - offset..self.byte_at(until) - offset];
      self.received_fragments += until - at;
      self.received_bytes += bytes.len();
      self.runs.insert(
        at,
        Run {
          fragment_count: until - at,
          bytes: bytes.into(),
        },
      );
      at = until;
    }
    self.modified_time = Instant::now();
    true
  }

  // Where a fragment begins. The last one may be smaller than the others.
  fn byte_at(&self, fragment: usize) -> usize {
    min(fragment * self.fragment_size, self.data_size)
  }

  pub fn is_complete(&self) -> bool {
    self.received_fragments == self.fragment_count
  }

  // Indices (from 0) of the fragments that are missing.
  fn missing(&self) -> impl Iterator<Item = usize> + '_ {
    let run_ends = self
      .runs
      .iter()
      .map(|(start, run)| start + run.fragment_count);
    let run_starts = self.runs.keys().copied();
    iter::once(0)
      .chain(run_ends)
      .zip(run_starts.chain(iter::once(self.fragment_count)))
      .flat_map(|(from, to)| from..to)
  }

  // All fragments are here: the runs are the whole object.
  fn assemble(self) -> Bytes {
    let mut whole = BytesMut::with_capacity(self.data_size);
    for run in self.runs.into_values() {
      whole.extend_from_slice(&run.bytes);
    }
    whole.freeze()
  }
}

// Upper bound on the number of concurrent (incomplete) reassembly buffers kept
// per writer. Fragments belonging to one sample normally arrive back-to-back,
// so only a handful of samples are ever mid-reassembly at once; this cap is far
// above that. Its purpose is to bound memory when samples never complete, e.g.
// under best-effort overload where fragments are dropped: without it, one
// incomplete `AssemblyBuffer` (all that came of the sample) accrues per lost
// sample and is only reclaimed by a 10 s idle timeout, growing to gigabytes.
// When exceeded we evict the oldest (lowest sequence number) buffer, which
// under best effort is lost anyway and under reliable will be re-requested.
const MAX_ASSEMBLY_BUFFERS: usize = 128;

// Assembles fragments from a single (remote) Writer
// So there is only one sequence of SNs
pub(crate) struct FragmentAssembler {
  assembly_buffers: BTreeMap<SequenceNumber, AssemblyBuffer>,
  // Whether the owning reader is Reliable. This decides which buffer to drop
  // when `MAX_ASSEMBLY_BUFFERS` or `MAX_ASSEMBLY_BYTES_PER_WRITER` is exceeded (see
  // `new_datafrag`).
  reliable: bool,
}

impl fmt::Debug for FragmentAssembler {
  fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    f.debug_struct("FragmentAssembler - fields omitted")
      // insert field printing here, if you really need it.
      .finish()
  }
}

impl FragmentAssembler {
  pub fn new(reliable: bool) -> Self {
    debug!("new FragmentAssembler. reliable = {reliable}");
    Self {
      assembly_buffers: BTreeMap::new(),
      reliable,
    }
  }

  // Is this a fragment of a sample that is never assembled?
  pub fn is_too_large(datafrag: &DataFrag) -> bool {
    datafrag.data_size > MAX_FRAGMENTED_SAMPLE_BYTES
      || u32::from(datafrag.total_number_of_fragments()) > MAX_FRAGMENTS_PER_SAMPLE
  }

  // Nothing is being assembled.
  pub fn is_empty(&self) -> bool {
    self.assembly_buffers.is_empty()
  }

  fn received_bytes(&self) -> usize {
    let buffers = self.assembly_buffers.values();
    buffers.map(|buffer| buffer.received_bytes).sum()
  }

  // Returns completed DDSData, when complete, and disposes the assembly buffer.
  pub fn new_datafrag(
    &mut self,
    datafrag: &DataFrag,
    flags: BitFlags<DATAFRAG_Flags>,
  ) -> Option<DDSData> {
    let writer_sn = datafrag.writer_sn;

    let sn = datafrag.writer_sn;
    match self.assembly_buffers.entry(sn) {
      Entry::Vacant(v) => {
        let Some(buf) = AssemblyBuffer::new(datafrag) else {
          error!("new_datafrag: failed to create AssemblyBuffer for {sn:?}");
          return None;
        };
        v.insert(buf);
      }
      Entry::Occupied(_) => {}
    }

    let Some(assembly_buffer) = self.assembly_buffers.get_mut(&sn) else {
      error!("new_datafrag: AssemblyBuffer missing for {sn:?}");
      return None;
    };

    if !assembly_buffer.insert_frags(datafrag) {
      error!("new_datafrag: rejected invalid DATAFRAG for {sn:?}");
      if assembly_buffer.received_fragments == 0 {
        self.assembly_buffers.remove(&sn);
      }
      return None;
    }

    if assembly_buffer.is_complete() {
      debug!("new_datafrag: COMPLETED FRAGMENT");
      if let Some(assembly_buffer) = self.assembly_buffers.remove(&writer_sn) {
        // Return what we have assembled.
        let whole = assembly_buffer.assemble();
        let serialized_data_or_key = SerializedPayload::from_bytes(&whole).map_or_else(
          |e| {
            error!("Deserializing SerializedPayload from DATAFRAG: {:?}", e);
            None
          },
          Some,
        )?;
        let dds_data = if flags.contains(DATAFRAG_Flags::Key) {
          DDSData::new_disposed_by_key(ChangeKind::NotAliveDisposed, serialized_data_or_key)
        } else {
          // it is data
          DDSData::new(serialized_data_or_key)
        };
        Some(dds_data) // completed data from fragments
      } else {
        error!("Assembly buffer mysteriously lost");
        None
      }
    } else {
      debug!("new_dataFrag: FRAGMENT NOT COMPLETED YET");
      // Bound memory: never keep more than MAX_ASSEMBLY_BUFFERS incomplete
      // reassemblies, nor more bytes of them than MAX_ASSEMBLY_BYTES_PER_WRITER.
      //
      // Which one to evict depends on reliability:
      //  * Reliable: the reader delivers strictly in order, so it must complete the
      //    LOWEST sequence number first; that buffer is exactly the one blocking
      //    progress. Dropping it would livelock, because a writer that bursts many
      //    large samples ahead (e.g. Connext) would make the reader perpetually evict
      //    the very sample it is waiting for. So evict the HIGHEST (newest) sequence
      //    number instead; the writer keeps unacked samples in its history and
      //    re-sends them once we catch up.
      //  * Best effort: there is no retransmission, so a low incomplete buffer is
      //    lost anyway. Evict the OLDEST (lowest SN) to free room for newer samples
      //    that may still complete.
      while self.assembly_buffers.len() > MAX_ASSEMBLY_BUFFERS
        || (self.assembly_buffers.len() > 1
          && self.received_bytes() > MAX_ASSEMBLY_BYTES_PER_WRITER)
      {
        let evicted = if self.reliable {
          self.assembly_buffers.pop_last()
        } else {
          self.assembly_buffers.pop_first()
        };
        if evicted.is_none() {
          break;
        }
      }
      None
    }
  }

  pub fn garbage_collect(&mut self, timeout: Duration) {
    self.assembly_buffers.retain(|sn, ab| {
      let retain = ab.modified_time.elapsed() <= timeout;
      if !retain {
        info!("AssemblyBuffer dropping {sn:?}");
      }
      retain
    });
  }

  // pub fn partially_received_sequence_numbers_iterator(&self) -> Box<dyn
  // Iterator<Item=SequenceNumber>> {   // Since we should only know about SNs
  // via DATAFRAG messages   // and AssemblyBuffers are removed immediately on
  // completion,   // the list should be just the list of current
  // AssemblyBuffers   self.assembly_buffers.keys()
  // }

  // In ascending order.
  pub fn partially_received(&self) -> impl Iterator<Item = SequenceNumber> + '_ {
    self.assembly_buffers.keys().copied()
  }

  pub fn is_partially_received(&self, sn: SequenceNumber) -> bool {
    self.assembly_buffers.contains_key(&sn)
    // assembly buffers map contains a key (SN) if and only if we have some
    // frags but not all
  }

  pub fn missing_frags_for(
    &self,
    seq: SequenceNumber,
  ) -> Box<dyn '_ + Iterator<Item = FragmentNumber>> {
    match self.assembly_buffers.get(&seq) {
      None => Box::new(iter::empty()),
      // There are at most MAX_FRAGMENTS_PER_SAMPLE.
      Some(ab) => Box::new(ab.missing().map(|f| FragmentNumber::new(f as u32 + 1))),
    }
  }
}

#[cfg(test)]
mod tests {
  use super::*;

  // Build a DATAFRAG submessage carrying the contiguous run of `k` fragments
  // starting at 1-based `start`, with the given payload bytes.
  fn datafrag(start: u32, k: u16, frag_size: u16, data_size: u32, payload: Vec<u8>) -> DataFrag {
    DataFrag {
      fragment_starting_num: FragmentNumber::new(start),
      fragments_in_submessage: k,
      fragment_size: frag_size,
      data_size,
      serialized_payload: Bytes::from(payload),
      ..Default::default()
    }
  }

  // A DATAFRAG that packs K > 1 fragments in one submessage must reassemble the
  // same bytes as one-fragment-per-submessage would. This exercises the
  // adaptive-packing writer path against the (unchanged) receiver.
  #[test]
  fn reassemble_multi_fragment_datafrag() {
    let frag_size = 1024u16;
    let data_size = 2600u32; // 3 fragments: 1024, 1024, 552
    let whole: Vec<u8> = (0..data_size as usize).map(|i| (i % 251) as u8).collect();

    // First submessage packs fragments 1 and 2 (K = 2, 2048 payload bytes).
    let first = datafrag(1, 2, frag_size, data_size, whole[0..2048].to_vec());
    let mut ab = AssemblyBuffer::new(&first).expect("valid first fragment");
    assert!(!ab.is_complete());
    ab.insert_frags(&first);
    assert!(!ab.is_complete(), "still missing the tail fragment");

    // Trailing submessage carries the shorter final fragment 3 (552 bytes).
    let tail = datafrag(3, 1, frag_size, data_size, whole[2048..2600].to_vec());
    ab.insert_frags(&tail);
    assert!(ab.is_complete(), "all fragments received");
    assert_eq!(
      &ab.assemble()[..],
      &whole[..],
      "reassembled bytes must match the original sample"
    );
  }

  // A single DATAFRAG carrying the whole sample in one multi-fragment run.
  #[test]
  fn reassemble_single_submessage_all_fragments() {
    let frag_size = 512u16;
    let data_size = 1500u32; // 3 fragments: 512, 512, 476
    let whole: Vec<u8> = (0..data_size as usize).map(|i| (i % 97) as u8).collect();

    let all = datafrag(1, 3, frag_size, data_size, whole.clone());
    let mut ab = AssemblyBuffer::new(&all).expect("valid fragment set");
    ab.insert_frags(&all);
    assert!(ab.is_complete());
    assert_eq!(&ab.assemble()[..], &whole[..]);
  }

  // Malformed span (starting at last fragment but claiming multiple fragments)
  // must not panic and must not falsely complete reassembly.
  #[test]
  fn reject_fragment_span_beyond_total() {
    let frag_size = 256u16;
    let data_size = 512u32; // 2 fragments total
    let bad = datafrag(2, 2, frag_size, data_size, vec![0u8; 256]);
    let mut ab = AssemblyBuffer::new(&bad).expect("buffer for valid data_size");
    assert!(!ab.insert_frags(&bad));
    assert!(!ab.is_complete());
  }

  #[test]
  fn fragment_assembler_rejects_span_beyond_total() {
    let frag_size = 256u16;
    let data_size = 512u32;
    let bad = datafrag(2, 2, frag_size, data_size, vec![0u8; 256]);
    let mut fa = FragmentAssembler::new(true);
    assert!(fa
      .new_datafrag(&bad, BitFlags::<DATAFRAG_Flags>::empty())
      .is_none());
  }

  fn no_flags() -> BitFlags<DATAFRAG_Flags> {
    BitFlags::empty()
  }

  #[test]
  fn a_sample_above_the_limits_is_too_large() {
    let is_too_large = |frag_size, data_size| {
      FragmentAssembler::is_too_large(&datafrag(1, 1, frag_size, data_size, vec![]))
    };
    assert!(!is_too_large(256, MAX_FRAGMENTED_SAMPLE_BYTES));
    assert!(is_too_large(1000, MAX_FRAGMENTED_SAMPLE_BYTES + 1));
    assert!(is_too_large(1000, u32::MAX));
    assert!(is_too_large(1, MAX_FRAGMENTS_PER_SAMPLE + 1));
  }

  #[test]
  fn what_is_held_is_what_came() {
    let mut fa = FragmentAssembler::new(true);
    let one = datafrag(9, 1, 1000, MAX_FRAGMENTED_SAMPLE_BYTES, vec![1; 1000]);
    for _again in 0..3 {
      assert!(fa.new_datafrag(&one, no_flags()).is_none());
      assert_eq!(fa.received_bytes(), 1000);
    }
  }

  #[test]
  fn runs_that_overlap_and_come_in_any_order_are_assembled() {
    let whole: Vec<u8> = (0..10_u8).collect();
    let run = |start: u32, k: u16| {
      let from = start as usize - 1;
      datafrag(start, k, 1, 10, whole[from..from + usize::from(k)].to_vec())
    };
    let mut ab = AssemblyBuffer::new(&run(9, 1)).unwrap();
    for (start, k) in [(9, 1), (3, 2), (6, 1), (2, 6), (9, 2)] {
      assert!(ab.insert_frags(&run(start, k)));
      assert!(!ab.is_complete());
    }
    assert_eq!(ab.missing().collect::<Vec<_>>(), [0, 7]);
    assert!(ab.insert_frags(&run(1, 10)));
    assert!(ab.is_complete());
    assert_eq!((ab.received_bytes, &ab.assemble()[..]), (10, &whole[..]));
  }

  #[test]
  fn fragments_without_their_bytes_are_refused() {
    let mut fa = FragmentAssembler::new(true);
    let empty = datafrag(1, 65_535, 256, 65_535 * 256, vec![]);
    assert!(fa.new_datafrag(&empty, no_flags()).is_none());
    assert!(fa.is_empty());
  }

  #[test]
  fn a_fragment_of_another_size_than_the_first_one_is_refused() {
    let mut ab = AssemblyBuffer::new(&datafrag(1, 1, 10, 30, vec![])).unwrap();
    assert!(!ab.insert_frags(&datafrag(2, 1, 11, 30, vec![0; 11])));
    assert!(!ab.insert_frags(&datafrag(2, 1, 10, 31, vec![0; 10])));
    assert!(ab.insert_frags(&datafrag(2, 1, 10, 30, vec![0; 10])));
  }

  #[test]
  fn beyond_the_bytes_of_a_writer_samples_are_given_up() {
    let mut fa = FragmentAssembler::new(true);
    for sn in 1..=40 {
      for start in (1..=15).map(|nth| nth * 60) {
        let part = DataFrag {
          writer_sn: SequenceNumber::new(sn),
          ..datafrag(start, 60, 1000, 1_000_000, vec![0; 60_000])
        };
        assert!(fa.new_datafrag(&part, no_flags()).is_none());
      }
    }
    assert!(fa.received_bytes() <= MAX_ASSEMBLY_BYTES_PER_WRITER);
    assert!(fa.is_partially_received(SequenceNumber::new(1)));
  }
}
