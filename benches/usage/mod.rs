//! What processes used: CPU, memory, bytes on disk and on the wire, read from `/proc` and `/sys`.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use std::path::Path;
use std::time::Duration;

/// Clock ticks of `/proc` in a second; Linux has it at 100 on every platform that Rust knows.
const TICKS_PER_SECOND: u64 = 100;
/// Block unit of `st_blocks`.
const BLOCK_BYTES: u64 = 512;

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

/// Bytes that the loopback has carried so far, with the heads of packets: of everything on this machine.
pub(crate) fn on_wire() -> u64 {
    std::fs::read_to_string("/sys/class/net/lo/statistics/tx_bytes").unwrap().trim().parse().unwrap()
}
