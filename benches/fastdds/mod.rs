//! Fast DDS, the DDS of `rmw_fastrtps`, in processes of its own: the program of the tests.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// A subscriber that has heard nothing for so long has failed.
const TIME_MAX: Duration = Duration::from_secs(60);

/// The program, built once.
fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("bench-fastdds-{}", std::process::id()));
        let mut above =
            Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().map(|above| above.join("tests/interop/fastdds"));
        let source = above.find(|path| path.is_dir()).expect("the sources").join("stream.cpp");
        let mut build = Command::new("g++");
        build.args(["-std=c++17", "-O2", "-o"]).arg(&program).arg(source).arg("-lfastrtps");
        assert!(build.status().expect("g++ starts").success(), "needs g++ and libfastrtps-dev");
        program
    })
}

/// The profile for large messages that docs/bridge.md recommends.
fn profile() -> &'static Path {
    static PROFILE: OnceLock<PathBuf> = OnceLock::new();
    PROFILE.get_or_init(|| {
        let mut above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().map(|above| above.join("docs/bridge.md"));
        let page = std::fs::read_to_string(above.find(|path| path.is_file()).expect("the page")).unwrap();
        let profile = page.split_once("```xml").and_then(|(_, rest)| rest.split_once("```")).expect("a profile").0;
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("bench-fastdds-{}.xml", std::process::id()));
        std::fs::write(&path, profile.trim_start()).unwrap();
        path
    })
}

/// One end of a topic.
#[derive(Clone, Copy)]
pub(crate) struct End<'a> {
    /// The ROS domain.
    pub(crate) domain: u16,
    /// As DDS has it: `rt/cmd_vel`.
    pub(crate) topic: &'a str,
    /// Bytes of data of an image; 0 for a Twist.
    pub(crate) size: usize,
    /// The files of DDS Security, if it takes part in that.
    pub(crate) enclave: Option<&'a Path>,
}

impl End<'_> {
    /// Publishes so many samples once somebody listens.
    pub(crate) fn publisher(self, count: u32, hz: f64) -> Peer {
        self.start("pub", count, &hz.to_string())
    }

    /// Receives so many samples.
    pub(crate) fn subscriber(self, count: u32) -> Peer {
        self.ready(count, TIME_MAX)
    }

    /// Receives for so long.
    pub(crate) fn subscriber_for(self, time: Duration) -> Peer {
        self.ready(0, time)
    }

    fn ready(self, count: u32, time: Duration) -> Peer {
        let mut peer = self.start("sub", count, &time.as_secs().to_string());
        assert_eq!(peer.line().as_deref(), Some("ready"));
        peer
    }

    fn start(self, role: &str, count: u32, about: &str) -> Peer {
        let mut command = Command::new(program());
        command.args([role, &self.domain.to_string(), self.topic, &count.to_string(), about, &self.size.to_string()]);
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        if self.size > 0 {
            command.env("FASTRTPS_DEFAULT_PROFILES_FILE", profile());
        }
        if let Some(enclave) = self.enclave {
            command.env("STREAM_ENCLAVE", enclave);
        }
        let mut child = command.spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap());
        Peer { child, lines }
    }
}

/// A publisher or subscriber. It ends with this value.
pub(crate) struct Peer {
    child: Child,
    lines: BufReader<ChildStdout>,
}

impl Drop for Peer {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

impl Peer {
    /// The process.
    pub(crate) fn process(&self) -> u32 {
        self.child.id()
    }

    fn line(&mut self) -> Option<String> {
        let mut line = String::new();
        (self.lines.read_line(&mut line).unwrap() > 0).then(|| line.trim_end().to_owned())
    }

    /// Waits until a publisher has found a reader.
    pub(crate) fn matched(&mut self) {
        while self.line().expect("somebody listens") != "matched" {}
    }

    /// Microseconds that the next sample was under way; none after the last one.
    pub(crate) fn sample(&mut self) -> Option<u64> {
        loop {
            if let Some((_, latency)) = self.line()?.split_once(' ') {
                return Some(latency.parse().unwrap());
            }
        }
    }

    /// Waits for all samples; answers with the latency of each, microseconds.
    pub(crate) fn samples(&mut self) -> Vec<u64> {
        std::iter::from_fn(|| self.sample()).collect()
    }

    /// Waits for all samples; answers with the moment at which each was told.
    pub(crate) fn arrivals(&mut self) -> Vec<Instant> {
        std::iter::from_fn(|| self.sample().map(|_| Instant::now())).collect()
    }
}
