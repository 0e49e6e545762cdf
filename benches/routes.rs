//! The cost of a bridge in processor and memory: of a process with one route, ten and a hundred, and of each sample that passes. Also
//! its memory over a long time beside a reader that stands still.
//!
//! Nodes, bridges and the ends over Fast DDS are processes of their own. A driver's bridge takes samples to the ledger, a
//! second bridge delivers them.
//!
//! `cargo bench --bench routes [-- idle | passing | stalled]`; `LEDGERD_BENCH_SECONDS` sets the length of each part. Needs `g++` and
//! `libfastrtps-dev`. Runs in a network of its own.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod fastdds;
mod founding;
mod load;
mod network;
mod own_network;
mod report;
mod usage;

use bytes::Bytes;
use fastdds::End;
use founding::{Founding, PAPER};
use hdrhistogram::Histogram;
use ledger_api::Context;
use network::Network;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tokio::runtime::Builder;

/// Routes of one bridge.
const ROUTES: [usize; 3] = [1, 10, 100];
/// Streams: the name, Hz, bytes of an image, or 0 for a Twist.
const STREAMS: [(&str, f64, usize); 3] = [("Twist", 50.0, 0), ("Twist", 1000.0, 0), ("Image of 1 MB", 30.0, 1_000_000)];
/// ROS domains of the driver and of the robot.
const DOMAINS: [u16; 2] = [221, 222];
/// Time until a new bridge has discovered everything.
const SETTLED: Duration = Duration::from_secs(4);
/// The nodes take an image whole.
const LIMITS: &str = "[limits]\npayload_bytes_max = 2097152\n";
/// The latency of a stop message, which says that it was sent long ago, is above this, in microseconds.
const STOP_US: u64 = 60_000_000;
/// How often memory is looked at beside a reader that stands still.
const LOOKS: u32 = 10;

/// A part of this bench, which takes so long at each of its steps.
type Part = fn(&Site, Duration) -> Value;

/// Robots, people, nodes and the directory of the bridges.
struct Site {
    network: Network,
    home: TempDir,
}

/// A bridge in a process of its own. It ends with this value.
struct Bridge(Child, PathBuf);

impl Drop for Bridge {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
        if std::thread::panicking() {
            println!("{}", std::fs::read_to_string(&self.1).unwrap_or_default());
        }
    }
}

fn main() {
    assert!(own_network::enter(), "needs a network of its own: `unshare`, `ip`, and the right to use them");
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(10.0, |text| text.parse().expect("seconds"));
    let time = Duration::from_secs_f64(if smoke { 1.0 } else { seconds });
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let site = runtime.block_on(Site::start());
    let parts: [(&str, Part); 3] = [("idle", idle), ("passing", passing), ("stalled", stalled)];
    let named = |name: &str| std::env::args().any(|argument| argument == name);
    let all = !parts.iter().any(|(name, _)| named(name));
    let chosen = parts.into_iter().filter(|(name, _)| all || named(name));
    let results: serde_json::Map<_, _> = chosen.map(|(name, part)| (name.to_owned(), part(&site, time))).collect();
    if !smoke {
        report::write("routes", &results.into());
    }
}

impl Site {
    async fn start() -> Self {
        let network = Network::start_with(PAPER, LIMITS).await;
        let site = Self { home: tempfile::tempdir().unwrap(), network };
        let robot = |number: usize| founding::robot(&format!("Robot{number}"), "Fleet");
        let camera = r#"{"name":"Camera","attribute_required":"Fleet","trusted":["Org1","Org2"],"services":
            [{"topic":"/image","type":"sensor_msgs/msg/Image","mode":"exclusive"}]}"#;
        let robots: Vec<_> = (0..ROUTES[2]).map(robot).chain([Bytes::from_static(camera.as_bytes())]).collect();
        let owner = site.network.owner_at(0).await;
        for some in robots.chunks(50) {
            owner.invoke("abac", "setup", some.to_vec()).await.unwrap();
        }
        for person in site.people() {
            person.save(site.home.path()).unwrap();
        }
        let driver = site.network.connect(site.people()[0]).await;
        for robot in ["Robot0", "Camera"] {
            driver.invoke("abac", "acquire", vec![robot.into(), "600000".into()]).await.unwrap();
        }
        site
    }

    /// The driver, and the owner of the other bridge.
    fn people(&self) -> [&Context; 2] {
        let Founding { drivers, .. } = self.network.founding();
        [&drivers[0], &drivers[1]]
    }

    /// A bridge of one of them, with routes for these services.
    fn bridge(&self, end: usize, services: &[(String, &str)]) -> Bridge {
        let (name, home) = (&self.people()[end].name, self.home.path());
        let direction = ["to_ledger", "from_ledger"][end];
        let context = home.join("contexts").join(name);
        let mut settings = format!("context_dir = {context:?}\ndomain_id = {}\nshared_memory = false\n", DOMAINS[end]);
        for (service, message) in services {
            let topic = format!("/{}", service.to_lowercase());
            write!(
                settings,
                "[[route]]\nservice = {service:?}\ndirection = {direction:?}\ntype = {message:?}\ntopic = {topic:?}\n\
                 sample_bytes_max = 2097152\n"
            )
            .unwrap();
        }
        let config = home.join(format!("{name}.toml"));
        std::fs::write(&config, settings).unwrap();
        Bridge::start(&config, &home.join(format!("{name}.log")))
    }
}

impl Bridge {
    fn start(config: &Path, log: &Path) -> Self {
        let said = File::create(log).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_ledgerd"));
        command.args(["bridge", "--config"]).arg(config).stdin(Stdio::null()).stdout(Stdio::null()).stderr(said);
        Self(command.spawn().unwrap(), log.to_owned())
    }

    fn mib(&self) -> f64 {
        usage::resident(self.0.id()) as f64 / f64::from(1 << 20)
    }

    fn cpu(&self) -> Duration {
        usage::cpu(&[self.0.id()])
    }
}

fn twists(count: usize) -> Vec<(String, &'static str)> {
    (0..count).map(|number| (format!("Robot{number}/cmd_vel"), "geometry_msgs/msg/Twist")).collect()
}

/// Bridges that carry nothing.
fn idle(site: &Site, time: Duration) -> Value {
    println!("\nidle            routes   CPU, % of a core   resident, MiB");
    let mut lines = Vec::new();
    for (end, direction) in ["to_ledger", "from_ledger"].into_iter().enumerate() {
        for count in ROUTES {
            let bridge = site.bridge(end, &twists(count));
            std::thread::sleep(SETTLED);
            let before = bridge.cpu();
            std::thread::sleep(time);
            let cpu = 100.0 * (bridge.cpu() - before).as_secs_f64() / time.as_secs_f64();
            println!("{direction:12} {count:9} {cpu:18.2} {:15.1}", bridge.mib());
            lines.push(json!({ "direction": direction, "routes": count, "cpu_percent": cpu, "mib": bridge.mib() }));
        }
    }
    lines.into()
}

/// One route at each side, and samples that pass.
fn passing(site: &Site, time: Duration) -> Value {
    println!("\npassing             Hz  samples | ms p50      p99 | CPU for each, µs: to_ledger  from_ledger | MiB");
    let lines = STREAMS.map(|(what, hz, size)| {
        let (service, message) =
            if size == 0 { ("Robot0/cmd_vel", "geometry_msgs/msg/Twist") } else { ("Camera/image", "sensor_msgs/msg/Image") };
        let routes = [(service.to_owned(), message)];
        let bridges = [0, 1].map(|end| site.bridge(end, &routes));
        let topic = format!("rt/{}", service.to_lowercase());
        let end = |end: usize| End { domain: DOMAINS[end], topic: &topic, size, enclave: None };
        let count = (time.as_secs_f64() * hz) as u32;
        // The first second warms up, and is not measured.
        let warm = hz as u32;
        let mut subscriber = end(1).subscriber_for(time + Duration::from_secs(30));
        std::thread::sleep(SETTLED);
        let mut publisher = end(0).publisher(count + warm, hz);
        publisher.matched();
        (0..warm / 2).for_each(|_| assert!(subscriber.sample().is_some(), "nothing arrives"));
        let before = bridges.each_ref().map(Bridge::cpu);
        let mut latencies = Histogram::<u64>::new(3).unwrap();
        for _ in 0..count {
            let Some(latency) = subscriber.sample() else { break };
            latencies.record(latency * 1000).unwrap();
        }
        let samples = latencies.len();
        let cpu = [0, 1].map(|end| (bridges[end].cpu() - before[end]).as_secs_f64() * 1e6 / samples as f64);
        let mib = bridges.each_ref().map(Bridge::mib);
        let at = |quantile| latencies.value_at_quantile(quantile) as f64 / 1e6;
        println!(
            "{what:14} {hz:7} {samples:8} | {:6.2} {:8.2} | {:27.0} {:12.0} | {:.1} {:.1}",
            at(0.5), at(0.99), cpu[0], cpu[1], mib[0], mib[1]
        );
        json!({
            "what": what, "hz": hz, "samples": samples, "latency_ms": report::percentiles(&latencies),
            "to_ledger_cpu_us": cpu[0], "from_ledger_cpu_us": cpu[1], "to_ledger_mib": mib[0], "from_ledger_mib": mib[1],
        })
    });
    lines.to_vec().into()
}

/// Memory of a bridge that delivers at 50 Hz, while one of its two readers stands still.
fn stalled(site: &Site, time: Duration) -> Value {
    let routes = twists(1);
    let bridges = [0, 1].map(|end| site.bridge(end, &routes));
    let end = |end: usize| End { domain: DOMAINS[end], topic: "rt/robot0/cmd_vel", size: 0, enclave: None };
    let hz = STREAMS[0].1;
    let mut reader = end(1).subscriber_for(time + Duration::from_secs(8));
    let stalled = end(1).subscriber_for(time + Duration::from_secs(60));
    std::thread::sleep(SETTLED);
    let process = Pid::from_raw(i32::try_from(stalled.process()).unwrap()).unwrap();
    kill_process(process, Signal::STOP).unwrap();
    let mut publisher = end(0).publisher((time.as_secs_f64() * hz) as u32, hz);
    publisher.matched();
    // A stop message carries no time.
    let counting = std::thread::spawn(move || reader.samples().iter().filter(|latency| **latency < STOP_US).count());
    println!("\nbeside a reader that stands still, MiB: to_ledger, from_ledger");
    let begun = Instant::now();
    let mut looks = Vec::new();
    for look in 0..=LOOKS {
        std::thread::sleep((time * look / LOOKS).saturating_sub(begun.elapsed()));
        let mib = bridges.each_ref().map(Bridge::mib);
        println!("{:6.0} s {:8.1} {:8.1}", begun.elapsed().as_secs_f64(), mib[0], mib[1]);
        looks.push(json!({ "s": begun.elapsed().as_secs(), "mib": mib }));
    }
    kill_process(process, Signal::CONT).unwrap();
    let heard = counting.join().unwrap();
    println!("the other reader heard {heard} of {:.0}", time.as_secs_f64() * hz);
    json!({ "looks": looks, "heard": heard })
}
