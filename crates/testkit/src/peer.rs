//! The software on the other side that we did not write: CycloneDDS or Fast DDS, with the same words on the command line.

use crate::python::{CYCLONE, Python, is_zenoh, source};
use std::path::PathBuf;
use std::process::Command;

/// The DDS of a process on the other side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// CycloneDDS in Python, as in `rmw_cyclonedds`.
    Cyclone,
    /// Fast DDS in C++, as in `rmw_fastrtps`.
    Fast,
    /// Fast DDS with the profile for large messages of docs/bridge.md.
    FastWithLargeBuffers,
}

/// Both.
pub const PEERS: [Peer; 2] = [Peer::Cyclone, Peer::Fast];

impl Peer {
    /// Starts a publisher: it waits for a reader, and says "matched".
    pub fn publishes(self, domain: u16, topic: &str, (count, rate, size): (u32, u32, usize), words: &[&str]) -> Python {
        self.start(["pub", &domain.to_string(), topic, &count.to_string(), &rate.to_string(), &size.to_string()], words)
    }

    /// Starts a subscriber: it says "ready", then "matched", then the number of each sample.
    pub fn subscribes(self, domain: u16, topic: &str, (count, size): (u32, usize), words: &[&str]) -> Python {
        self.start(["sub", &domain.to_string(), topic, &count.to_string(), "90", &size.to_string()], words)
    }

    fn start(self, args: [&str; 6], words: &[&str]) -> Python {
        let args = args.into_iter().chain(words.iter().copied());
        if self == Self::Cyclone || is_zenoh() {
            return Python::start_within(&[], CYCLONE, "stream.py", &args.collect::<Vec<_>>());
        }
        let mut command = Command::new(fast_dds());
        command.args(args);
        if self == Self::FastWithLargeBuffers {
            command.env("FASTRTPS_DEFAULT_PROFILES_FILE", profile());
        }
        Python::run(command)
    }
}

/// The number of the next sample that a subscriber has.
pub fn number(subscriber: &mut Python) -> Option<u32> {
    Some(subscriber.line()?.split_once(' ')?.0.parse().expect("a number"))
}

/// The program with Fast DDS, built where it is not there in this version.
pub fn fast_dds() -> PathBuf {
    let text = std::fs::read(source("fastdds/stream.cpp")).expect("the source is there");
    let version = text.iter().fold(0_u64, |hash, byte| hash.wrapping_mul(0x0100_0000_01b3) ^ u64::from(*byte));
    let program = crate::scratch().join(format!("fastdds-stream-{version:016x}"));
    // Tests run in many processes: the first one builds, the others wait for it.
    let lock = std::fs::File::create(program.with_extension("lock")).expect("a file to lock");
    lock.lock().expect("the file can be locked");
    if !program.exists() {
        let building = program.with_extension(std::process::id().to_string());
        let mut command = Command::new("g++");
        command.args(["-std=c++17", "-O1", "-Wall", "-Werror", "-o"]).arg(&building);
        let done = command.arg(source("fastdds/stream.cpp")).arg("-lfastrtps").status().expect("g++ starts");
        assert!(done.success(), "Fast DDS is missing: install libfastrtps-dev of Debian, as ./test does");
        std::fs::rename(building, &program).expect("the program is put in its place");
    }
    program
}

/// The profile of docs/bridge.md for Fast DDS with large messages.
fn profile() -> PathBuf {
    let book = std::fs::read_to_string(source("../../docs/bridge.md")).expect("the page is there");
    let profile = book.split_once("```xml").and_then(|(_, rest)| rest.split_once("```")).expect("a profile is in it").0;
    let path = crate::scratch().join(format!("fastdds-profile-{}.xml", std::process::id()));
    std::fs::write(&path, profile).expect("the profile is written");
    path
}
