//! The use of processes: CPU, memory, bytes on disk and on the wire, read from `/proc` and `/sys`.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::time::Duration;

/// Clock ticks of `/proc` in a second; Linux has it at 100 on every platform that Rust knows.
const TICKS_PER_SECOND: u64 = 100;
/// Block unit of `st_blocks`.
const BLOCK_BYTES: u64 = 512;
/// Bytes that are looked at once for the end of a file.
const FILLED_PIECE_BYTES: usize = 1 << 20;

/// CPU time of these processes so far.
pub(crate) fn cpu(processes: &[u32]) -> Duration {
    let ticks = |process: &u32| {
        let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap();
        // The name, in parentheses, may hold blanks; after it comes the state, field 3.
        let fields: Vec<_> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
        let ticks = |field: usize| fields[field - 3].parse::<u64>().unwrap();
        ticks(14) + ticks(15)
    };
    Duration::from_millis(processes.iter().map(ticks).sum::<u64>() * 1000 / TICKS_PER_SECOND)
}

/// The same to the nanosecond. The use of threads that have ended meanwhile is missing.
pub(crate) fn cpu_exact(processes: &[u32]) -> Duration {
    let of_thread = |thread: std::fs::DirEntry| {
        let statistics = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
        statistics.split_whitespace().next()?.parse::<u64>().ok()
    };
    let threads = |process: &u32| std::fs::read_dir(format!("/proc/{process}/task")).unwrap().flatten();
    Duration::from_nanos(processes.iter().flat_map(threads).filter_map(of_thread).sum())
}

/// Resident memory of a process, bytes.
pub(crate) fn resident(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() * 1024
}

/// Bytes that a directory takes on disk.
pub(crate) fn on_disk(directory: &Path) -> u64 {
    use std::os::unix::fs::MetadataExt;
    let Ok(entries) = std::fs::read_dir(directory) else { return 0 };
    let of = |entry: std::fs::DirEntry| match entry.metadata() {
        Ok(metadata) if metadata.is_dir() => on_disk(&entry.path()),
        Ok(metadata) => metadata.blocks() * BLOCK_BYTES,
        Err(_) => 0,
    };
    entries.flatten().map(of).sum()
}

/// Bytes that the files in a directory hold, without the zeros at their ends: logs are zeroed ahead.
pub(crate) fn filled(directory: &Path) -> u64 {
    let Ok(entries) = std::fs::read_dir(directory) else { return 0 };
    let of = |entry: std::fs::DirEntry| match entry.path() {
        path if path.is_dir() => filled(&path),
        path => match File::open(path) {
            Ok(file) => filled_until(&file),
            Err(_) => 0,
        },
    };
    entries.flatten().map(of).sum()
}

fn filled_until(file: &File) -> u64 {
    let mut end = file.metadata().map_or(0, |metadata| metadata.len());
    let mut piece = vec![0; FILLED_PIECE_BYTES];
    while end > 0 {
        let start = end.saturating_sub(FILLED_PIECE_BYTES as u64);
        let piece = &mut piece[..(end - start) as usize];
        if file.read_exact_at(piece, start).is_err() {
            return end;
        }
        if let Some(last) = piece.iter().rposition(|byte| *byte != 0) {
            return start + last as u64 + 1;
        }
        end = start;
    }
    0
}

/// Bytes that the loopback has carried so far, with the heads of packets: of everything on this machine.
pub(crate) fn on_wire() -> u64 {
    std::fs::read_to_string("/sys/class/net/lo/statistics/tx_bytes").unwrap().trim().parse().unwrap()
}
