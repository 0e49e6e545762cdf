//! A stream of images from one DDS to another, each in a process of its own but ours, which is this one.

use hdrhistogram::Histogram;
use ledger_gate::sample::{CDR_LE, Sample};
use ros_bridge::dds::{Participant, Reader};
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::Limits;
use rustix::time::{ClockId, clock_gettime};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;
use tokio::runtime::Runtime;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, sleep_until, timeout, timeout_at};

/// A party that finds nobody for so long has failed.
const CONNECT_MAX: Duration = Duration::from_secs(30);
/// So long after the last sample was due it is waited for.
const LATE: Duration = Duration::from_secs(3);
/// The ROS domain.
const DOMAIN: u16 = 9;
/// Where the data of an image begin, behind the header of the sample.
const DATA: usize = 48;

/// CycloneDDS on a loopback without multicast.
const CYCLONE: &str = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/>\
    </Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>\
    <MaxAutoParticipantIndex>11</MaxAutoParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>\
    </Domain></CycloneDDS>";

/// The DDS of one end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Party {
    /// The readers and writers of a bridge.
    Bridge,
    /// CycloneDDS, in Python.
    Cyclone,
    /// Fast DDS, in C++.
    Fast,
}

impl Party {
    /// As it is called in results.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Bridge => "bridge",
            Self::Cyclone => "cyclone",
            Self::Fast => "fast",
        }
    }

    /// One end in a process of its own. `about` is the rate of a publisher, and the time of a subscriber.
    fn start(self, role: &str, count: u32, about: f64, size: usize) -> Other {
        let mut above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().map(|above| above.join("tests/interop"));
        let sources = above.find(|path| path.is_dir()).expect("the sources");
        let mut command = match self {
            Self::Cyclone => {
                let python = std::env::var_os("LEDGERD_TEST_PYTHON").unwrap_or_else(|| "python3".into());
                let mut command = Command::new(python);
                command.arg(sources.join("stream.py"));
                command
            }
            Self::Fast => Command::new(built(&sources)),
            Self::Bridge => unreachable!("it is this process"),
        };
        command.args([
            role,
            &DOMAIN.to_string(),
            "rt/image",
            &count.to_string(),
            &about.to_string(),
            &size.to_string(),
        ]);
        command.env("CYCLONEDDS_URI", CYCLONE).stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap_or_else(|error| panic!("{command:?}: {error}"));
        let lines = BufReader::new(child.stdout.take().unwrap());
        Other { child, lines }
    }
}

/// The program of Fast DDS, built once.
fn built(sources: &Path) -> PathBuf {
    let program = std::env::temp_dir().join(format!("ledgerd-bench-fastdds-{}", std::process::id()));
    if !program.exists() {
        let source = sources.join("fastdds/stream.cpp");
        let mut build = Command::new("g++");
        build.args(["-std=c++17", "-O2", "-o"]).arg(&program).arg(source).arg("-lfastrtps");
        assert!(build.status().expect("g++ starts").success(), "needs g++ and libfastrtps-dev");
    }
    program
}

/// A publisher or subscriber in a process of its own. It ends with this value.
struct Other {
    child: Child,
    lines: BufReader<ChildStdout>,
}

impl Other {
    fn line(&mut self) -> Option<String> {
        let mut line = String::new();
        (self.lines.read_line(&mut line).unwrap() > 0).then(|| line.trim_end().to_owned())
    }
}

impl Drop for Other {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

/// Publishes `count` images of `size` bytes at `hz`, and measures in microseconds from publishing to receiving. Images that are
/// missing were not received.
pub(crate) fn run(runtime: &Runtime, from: Party, to: Party, (size, hz, count): (usize, f64, u32)) -> Histogram<u64> {
    latencies(runtime.block_on(async {
        let (topic, message) = (TopicName::parse("/image").unwrap(), TypeName::parse("sensor_msgs/msg/Image").unwrap());
        let bridge = Participant::open(DOMAIN, "ledgerd_bridge").await.unwrap();
        let time = Duration::from_secs_f64(f64::from(count) / hz) + LATE;
        let receiving = if to == Party::Bridge {
            let limits = Limits { sample_bytes_max: 8 << 20, ..Limits::default() };
            let reader = bridge.reader(&topic, &message, &Qos::default(), limits).unwrap();
            tokio::spawn(read(reader, count, time))
        } else {
            let mut subscriber = to.start("sub", count, time.as_secs_f64() + 2.0, size);
            spawn_blocking(move || told(&mut subscriber))
        };
        if from == Party::Bridge {
            let writer = bridge.writer(&topic, &message, &Qos::default()).unwrap();
            assert!(timeout(CONNECT_MAX, writer.matched().at_least(1)).await.expect("nobody is there"));
            let start = Instant::now();
            for number in 0..count {
                let image = prepared(number, size);
                sleep_until(start + Duration::from_secs_f64(f64::from(number) / hz)).await;
                writer.write(&stamped(image)).unwrap();
            }
            receiving.await.unwrap()
        } else {
            let mut publisher = from.start("pub", count, hz, size);
            spawn_blocking(move || while publisher.line().is_some() {}).await.unwrap();
            receiving.await.unwrap()
        }
    }))
}

/// A histogram of microseconds.
pub(crate) fn latencies(microseconds: impl IntoIterator<Item = u64>) -> Histogram<u64> {
    let mut latencies = Histogram::new_with_bounds(1, 60_000_000, 3).unwrap();
    microseconds.into_iter().for_each(|latency| latencies.saturating_record(latency));
    latencies
}

/// The latencies that a subscriber in another process says.
fn told(subscriber: &mut Other) -> Vec<u64> {
    let mut latencies = Vec::new();
    while let Some(line) = subscriber.line() {
        latencies.extend(line.split_once(' ').map(|(_, latency)| latency.parse::<u64>().unwrap()));
    }
    latencies
}

/// The images that a bridge receives, until all have come or nothing comes any more.
async fn read(mut reader: Reader, count: u32, time: Duration) -> Vec<u64> {
    let mut latencies = Vec::new();
    let deadline = Instant::now() + CONNECT_MAX + time;
    let mut until = deadline;
    while latencies.len() < count as usize {
        let Ok(Some(incoming)) = timeout_at(until, reader.next()).await else { break };
        let came = monotonic_ns();
        let sent = incoming.sample.body()[DATA..DATA + 8].try_into().unwrap();
        latencies.push(u64::try_from(came - i64::from_le_bytes(sent)).unwrap() / 1000);
        until = deadline.min(Instant::now() + LATE);
    }
    latencies
}

fn monotonic_ns() -> i64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec * 1_000_000_000 + now.tv_nsec
}

/// An image as in stream.py, without its time.
fn prepared(number: u32, size: usize) -> Vec<u8> {
    let mut body = vec![0; DATA];
    let length = u32::try_from(size).unwrap();
    for (at, value) in [(0, number), (8, 7), (20, 1), (24, length), (28, 6), (40, length), (44, length)] {
        body[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
    body[12..18].copy_from_slice(b"camera");
    body[32..37].copy_from_slice(b"mono8");
    body.resize(DATA + size, u8::try_from(number % 251).unwrap());
    body
}

fn stamped(mut body: Vec<u8>) -> Sample {
    body[DATA..DATA + 8].copy_from_slice(&monotonic_ns().to_le_bytes());
    Sample::new(CDR_LE, &body).unwrap()
}
