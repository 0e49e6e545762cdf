//! A sample in fragments (§8.4.14.1). It takes the bytes that have come, whatever it claims to become.

use super::content::Content;
use crate::limits::SAMPLE_BYTES_MAX;
use crate::time::Ticks;
use crate::wire::submessage::{DataFrag, InlineQos, NumberSet, Payload};
use bytes::Bytes;
use std::collections::BTreeMap;

/// Most fragments of a sample: a sample of 16 MiB in fragments of 256 bytes, the smallest ones that peers use.
const FRAGMENTS_MAX: u32 = 65_536;
/// Bytes that a run of fragments counts beyond its own: a map may be half empty.
const RUN_OVERHEAD: usize = 128;
const _: () = assert!(RUN_OVERHEAD >= size_of::<(u32, Run)>() * 11 / 5 + 16);
/// Bytes that a sample in assembly counts beyond its runs: a map may be half empty, and the first run needs a map.
pub(super) const ASSEMBLY_OVERHEAD: usize = 1024;
const _: () = assert!(ASSEMBLY_OVERHEAD >= size_of::<(i64, Assembly)>() * 11 / 5 + 12 * size_of::<(u32, Run)>());

/// The fragments of a sample that have come.
#[derive(Debug)]
pub(super) struct Assembly {
    sample_bytes: usize,
    fragment_bytes: u16,
    is_key: bool,
    /// How many there are, and how many have come.
    count: u32,
    came: u32,
    /// How many came that do not fit these sizes.
    misfits: u32,
    /// Consecutive fragments under the number of the first one. Runs are not joined before the end: fragments in reverse order would
    /// be copied again and again.
    runs: BTreeMap<u32, Run>,
    /// Bytes that are allocated for them.
    bytes: usize,
    timestamp: Option<Ticks>,
    inline_qos: InlineQos,
}

#[derive(Debug, Default)]
struct Run {
    fragments: u32,
    bytes: Vec<u8>,
}

impl Assembly {
    /// For the sample of this fragment. None if its sizes are impossible, or too large.
    pub(super) fn new(fragment: &DataFrag) -> Option<Self> {
        let sample_bytes = usize::try_from(fragment.sample_bytes).ok().filter(|bytes| *bytes <= SAMPLE_BYTES_MAX)?;
        let count = fragment.sample_bytes.checked_div(u32::from(fragment.fragment_bytes))?;
        let count = count + u32::from(!fragment.sample_bytes.is_multiple_of(u32::from(fragment.fragment_bytes)));
        (1..=FRAGMENTS_MAX).contains(&count).then(|| Self {
            sample_bytes,
            fragment_bytes: fragment.fragment_bytes,
            is_key: fragment.is_key,
            count,
            came: 0,
            misfits: 0,
            runs: BTreeMap::new(),
            bytes: 0,
            timestamp: None,
            inline_qos: InlineQos::default(),
        })
    }

    /// Is the fragment of a sample of these sizes? Others are ignored, unless most are: then the first one was the wrong one.
    pub(super) fn fits(&mut self, fragment: &DataFrag) -> Fit {
        let is_same = usize::try_from(fragment.sample_bytes) == Ok(self.sample_bytes)
            && fragment.fragment_bytes == self.fragment_bytes
            && fragment.is_key == self.is_key;
        if is_same {
            return Fit::Same;
        }
        self.misfits = self.misfits.saturating_add(1);
        if self.misfits > self.came { Fit::Replaces } else { Fit::Other }
    }

    /// Takes the fragments of a submessage. True if one of them is new.
    ///
    /// CycloneDDS sends the inline QoS and the time with the first fragment only, so they are taken from wherever they stand.
    pub(super) fn add(&mut self, fragment: &DataFrag, timestamp: Option<Ticks>) -> bool {
        self.timestamp = self.timestamp.or(timestamp);
        self.inline_qos.related = self.inline_qos.related.or(fragment.inline_qos.related);
        self.inline_qos.key_hash = self.inline_qos.key_hash.or(fragment.inline_qos.key_hash);
        self.inline_qos.status |= fragment.inline_qos.status;
        let mut rest: &[u8] = &fragment.payload;
        let before = self.came;
        for number in (0..u32::from(fragment.count)).filter_map(|index| fragment.first.checked_add(index)) {
            let Some((bytes, behind)) = self.bytes_of(number).and_then(|bytes| rest.split_at_checked(bytes)) else {
                break;
            };
            self.put(number, bytes);
            rest = behind;
        }
        self.came > before
    }

    /// How long a fragment is; none if there is no such fragment.
    fn bytes_of(&self, number: u32) -> Option<usize> {
        let index = number.checked_sub(1).filter(|index| *index < self.count)?;
        let offset = usize::try_from(index).ok()?.checked_mul(usize::from(self.fragment_bytes))?;
        Some(self.sample_bytes.checked_sub(offset)?.min(usize::from(self.fragment_bytes)))
    }

    fn put(&mut self, number: u32, bytes: &[u8]) {
        if let Some((start, run)) = self.runs.range_mut(..=number).next_back() {
            let end = start.saturating_add(run.fragments);
            if number < end {
                return;
            }
            if number == end {
                self.bytes = self.bytes.saturating_sub(run.bytes.capacity());
                run.append(bytes, self.sample_bytes);
                self.bytes = self.bytes.saturating_add(run.bytes.capacity());
                self.came = self.came.saturating_add(1);
                return;
            }
        }
        let mut run = Run::default();
        run.append(bytes, self.sample_bytes);
        self.bytes = self.bytes.saturating_add(run.bytes.capacity()).saturating_add(RUN_OVERHEAD);
        self.came = self.came.saturating_add(1);
        self.runs.insert(number, run);
    }

    pub(super) fn is_complete(&self) -> bool {
        self.came == self.count
    }

    /// The bytes that it takes.
    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    /// The fragments that have not come, as many as a NACK_FRAG can name.
    pub(super) fn missing(&self) -> NumberSet {
        let holes = self.runs.iter().map(|(start, run)| (*start, start.saturating_add(run.fragments)));
        let mut cursor = 1;
        let mut set: Option<NumberSet> = None;
        for (start, end) in holes.chain([(self.count.saturating_add(1), 0)]) {
            for number in (cursor..start).map(i64::from) {
                if !set.get_or_insert_with(|| NumberSet::new(number)).insert(number) {
                    return set.unwrap_or_else(|| NumberSet::new(1));
                }
            }
            cursor = end;
        }
        set.unwrap_or_else(|| NumberSet::new(1))
    }

    /// The sample, when all fragments have come.
    pub(super) fn finish(self) -> Content {
        let mut runs = self.runs.into_values();
        let mut bytes = runs.next().unwrap_or_default().bytes;
        bytes.reserve_exact(self.sample_bytes.saturating_sub(bytes.len()));
        for run in runs {
            bytes.extend_from_slice(&run.bytes);
        }
        let bytes = Bytes::from(bytes);
        let payload = if self.is_key { Payload::Key(bytes) } else { Payload::Data(bytes) };
        Content { timestamp: self.timestamp, inline_qos: self.inline_qos, payload }
    }
}

/// Whether a fragment belongs to what has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fit {
    Same,
    Other,
    Replaces,
}

impl Run {
    /// Appends a fragment. Memory doubles, up to that of the sample: at most twice what has come.
    fn append(&mut self, bytes: &[u8], sample_bytes: usize) {
        if self.bytes.capacity().saturating_sub(self.bytes.len()) < bytes.len() {
            let doubled = self.bytes.len().min(sample_bytes.saturating_sub(self.bytes.len()));
            self.bytes.reserve_exact(doubled.max(bytes.len()));
        }
        self.bytes.extend_from_slice(bytes);
        self.fragments = self.fragments.saturating_add(1);
    }
}
