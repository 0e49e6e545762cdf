//! The disk alone, as the measure of what a commit may cost at best: disks differ, and so do their moods.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use crate::founding::bench_directory;
use crate::load::{histogram, wait_until};
use hdrhistogram::Histogram;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::time::{Duration, Instant};

/// Bytes that one command of the latency bench takes in the log.
const RECORD: [u8; 360] = [7; 360];
/// Space that is written beforehand, as the log does.
const ZEROED_BYTES: usize = 4 << 20;

/// A file into which nothing but the bench writes.
pub(crate) struct Disk {
    file: File,
    end: u64,
}

impl Disk {
    pub(crate) fn new() -> Self {
        let file = tempfile::tempfile_in(bench_directory()).unwrap();
        file.write_all_at(&vec![0; ZEROED_BYTES], 0).unwrap();
        file.sync_all().unwrap();
        Self { file, end: 0 }
    }

    /// Nanoseconds of a write with `fdatasync`, at `hz` for `duration`.
    pub(crate) fn measure(&mut self, hz: f64, duration: Duration) -> Histogram<u64> {
        let start = Instant::now();
        let count = (duration.as_secs_f64() * hz).ceil() as u32;
        let times: Vec<_> = (0..count)
            .map(|number| {
                wait_until(start + Duration::from_secs_f64(f64::from(number) / hz));
                let begin = Instant::now();
                self.file.write_all_at(&RECORD, self.end).unwrap();
                self.file.sync_data().unwrap();
                self.end = (self.end + RECORD.len() as u64) % (ZEROED_BYTES - RECORD.len()) as u64;
                begin.elapsed()
            })
            .collect();
        histogram(times.into_iter())
    }
}
