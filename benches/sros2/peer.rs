//! Fast DDS in processes of its own: the program of the tests.

use crate::{HZ, Side, usage};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// The ROS domain.
const DOMAIN: &str = "9";
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

/// A publisher or subscriber of `/cmd_vel`. It ends with this value.
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
    /// Publishes so many commands once somebody listens.
    pub(crate) fn publisher(enclave: Option<&Path>, count: u32) -> Self {
        Self::start(enclave, ["pub", DOMAIN, "rt/cmd_vel", &count.to_string(), &HZ.to_string(), "0"])
    }

    /// Receives so many commands.
    pub(crate) fn subscriber(enclave: Option<&Path>, count: u32) -> Self {
        Self::ready(enclave, &count.to_string(), TIME_MAX)
    }

    /// Receives for so long.
    pub(crate) fn subscriber_for(enclave: &Path, time: Duration) -> Self {
        Self::ready(Some(enclave), "0", time)
    }

    fn ready(enclave: Option<&Path>, count: &str, time: Duration) -> Self {
        let mut peer = Self::start(enclave, ["sub", DOMAIN, "rt/cmd_vel", count, &time.as_secs().to_string(), "0"]);
        assert_eq!(peer.line().as_deref(), Some("ready"));
        peer
    }

    fn start(enclave: Option<&Path>, arguments: [&str; 6]) -> Self {
        let mut command = Command::new(program());
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped());
        if let Some(enclave) = enclave {
            command.env("STREAM_ENCLAVE", enclave);
        }
        let mut child = command.spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap());
        Self { child, lines }
    }

    fn line(&mut self) -> Option<String> {
        let mut line = String::new();
        (self.lines.read_line(&mut line).unwrap() > 0).then(|| line.trim_end().to_owned())
    }

    /// Microseconds that the next command was under way.
    fn sample(&mut self) -> Option<u64> {
        loop {
            if let Some((_, latency)) = self.line()?.split_once(' ') {
                return Some(latency.parse().unwrap());
            }
        }
    }

    /// Waits for all commands; answers with the latency of each, microseconds.
    pub(crate) fn samples(&mut self) -> Vec<u64> {
        std::iter::from_fn(|| self.sample()).collect()
    }

    /// Waits for all commands; answers with the moment at which each was told.
    pub(crate) fn arrivals(&mut self) -> Vec<Instant> {
        std::iter::from_fn(|| self.sample().map(|_| Instant::now())).collect()
    }
}

/// One turn of Fast DDS, with the enclaves of driver and robot or without. Discovery is not part of it.
pub(crate) fn stream(side: &mut Side, enclaves: Option<&[PathBuf; 2]>, count: u32) {
    let [driver, robot] = [0, 1].map(|end| enclaves.map(|enclaves| enclaves[end].as_path()));
    let mut subscriber = Peer::subscriber(robot, count);
    let mut publisher = Peer::publisher(driver, count + 50);
    while publisher.line().as_deref() != Some("matched") {}
    let processes = [subscriber.child.id(), publisher.child.id()];
    let before = usage::cpu(&processes);
    let mut latencies: Vec<_> = (0..count - 1).map_while(|_| subscriber.sample()).collect();
    side.cpu += usage::cpu(&processes) - before;
    latencies.extend(subscriber.samples());
    assert_eq!(latencies.len(), count as usize, "commands are lost");
    latencies.into_iter().for_each(|latency| side.latency.record(latency * 1000).unwrap());
}
