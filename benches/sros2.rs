//! SROS2's access control beside ours: the same `geometry_msgs/msg/Twist` from publisher to subscriber at 50 Hz.
//!
//! - *plain*: Fast DDS, the DDS of `rmw_fastrtps`, without security.
//! - *secured*: the same with DDS Security, and the files that SROS2 gives an enclave. Its governance is that of SROS2:
//!   participants authenticate, topics have permissions, everything is encrypted.
//! - *ledger*: the paper's network with its bridges, sample to sample over DDS by RustDDS.
//!
//! Then come two questions of people. How long does it take until somebody new drives, and until somebody drives no more?
//!
//! `cargo bench --bench sros2`; `LEDGERD_BENCH_SECONDS` sets the length. Needs `g++`, `libfastrtps-dev` and `openssl`. Runs in a
//! network of its own.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

#[path = "sros2/enclave.rs"]
mod enclave;
mod fastdds;
mod founding;
#[path = "ros/graph.rs"]
mod graph;
mod load;
mod network;
mod own_network;
mod report;
#[path = "ros/site.rs"]
mod site;
mod usage;

use bytes::Bytes;
use enclave::{Keystore, Right};
use fastdds::End;
use graph::{Ends, Middleware};
use hdrhistogram::Histogram;
use ledger_api::Enrolment;
use ledger_base::hash::Hash;
use ledger_identity::Role;
use ledger_identity::certificate::Certificate;
use ledger_identity::key::KeyKind;
use load::histogram;
use serde_json::{Value, json};
use site::Site;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Runtime};

const HZ: f64 = 50.0;
/// Turns of each side, so that all meet the same mood of the machine.
const TURNS: u32 = 4;
const OPERATOR_DOMAIN: u16 = 211;
const ROBOT_DOMAIN: u16 = 212;
const NEWCOMER_DOMAIN: u16 = 213;
const FAST_DOMAIN: u16 = 9;
/// How long somebody whose right has ended is listened to, with SROS2.
const LISTENED: Duration = Duration::from_secs(10);
/// How long a right lasts that ends while it is used. Participants need some of it to find each other.
const LASTS: Duration = Duration::from_secs(6);

/// One side: latencies in nanoseconds, and the CPU of its processes.
struct Side {
    name: &'static str,
    latency: Histogram<u64>,
    cpu: Duration,
}

/// The answers to the questions of people.
struct People {
    /// From the decision until the first command is heard.
    new_to_sros2: Duration,
    new_to_the_ledger: Duration,
    /// Commands that arrived in [`LISTENED`] after the publisher's permissions had expired.
    after_expiry: usize,
    /// From the call that revoked until the last command; none if none arrived after it.
    revoked: Option<Duration>,
}

impl Side {
    fn new(name: &'static str) -> Self {
        Self { name, latency: histogram(std::iter::empty()), cpu: Duration::ZERO }
    }

    fn cpu_us(&self) -> f64 {
        self.cpu.as_secs_f64() * 1e6 / self.latency.len() as f64
    }
}

fn main() {
    assert!(own_network::enter(), "needs a network of its own: `unshare`, `ip`, and the right to use them");
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(20.0, |text| text.parse().expect("seconds"));
    let count = ((if smoke { 2.0 } else { seconds }) * HZ / f64::from(TURNS)) as u32;
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let keystore = Keystore::new();
    let mut site = runtime.block_on(Site::start(OPERATOR_DOMAIN, ROBOT_DOMAIN));
    let mut ends = runtime.block_on(Ends::open(Middleware::Dds, OPERATOR_DOMAIN, ROBOT_DOMAIN));
    // Certificates travel, caches warm up.
    ends.run(&runtime, HZ, Duration::from_secs(1));
    let mut sides = ["plain", "secured", "ledger"].map(Side::new);
    let secured = [keystore.enclave("driver", Right::Publish, None), keystore.enclave("robot", Right::Subscribe, None)];
    for _ in 0..TURNS {
        stream(&mut sides[0], None, count);
        stream(&mut sides[1], Some(&secured), count);
        let before = usage::cpu(&site.processes());
        let (latency, lost) = ends.run(&runtime, HZ, Duration::from_secs_f64(f64::from(count) / HZ));
        assert_eq!(lost, 0, "samples are lost");
        sides[2].latency.add(latency).unwrap();
        sides[2].cpu += usage::cpu(&site.processes()) - before;
    }
    let revoked = revoked_on_the_ledger(&runtime, &site, &mut ends);
    drop(ends);
    let people = People {
        new_to_sros2: newcomer_to_sros2(&keystore, &secured[1]),
        new_to_the_ledger: newcomer_to_the_ledger(&runtime, &mut site),
        after_expiry: after_the_end_with_sros2(&keystore, &secured[1]),
        revoked,
    };
    print(&sides, &people);
    if !smoke {
        report::write("sros2", &results(&sides, &people));
    }
}

/// An end of `/cmd_vel` over Fast DDS.
fn end(enclave: Option<&Path>) -> End<'_> {
    End { domain: FAST_DOMAIN, topic: "rt/cmd_vel", size: 0, enclave }
}

/// One turn of Fast DDS, with the enclaves of driver and robot or without. Discovery is not part of it.
fn stream(side: &mut Side, enclaves: Option<&[PathBuf; 2]>, count: u32) {
    let [driver, robot] = [0, 1].map(|end| enclaves.map(|enclaves| enclaves[end].as_path()));
    let mut subscriber = end(robot).subscriber(count);
    let mut publisher = end(driver).publisher(count + 50, HZ);
    publisher.matched();
    let processes = [subscriber.process(), publisher.process()];
    let before = usage::cpu(&processes);
    let mut latencies: Vec<_> = (0..count - 1).map_while(|_| subscriber.sample()).collect();
    side.cpu += usage::cpu(&processes) - before;
    latencies.extend(subscriber.samples());
    assert_eq!(latencies.len(), count as usize, "commands are lost");
    latencies.into_iter().for_each(|latency| side.latency.record(latency * 1000).unwrap());
}

/// From the decision that somebody may drive until the robot hears the first command: keys, signed permissions, discovery.
fn newcomer_to_sros2(keystore: &Keystore, robot: &Path) -> Duration {
    let mut subscriber = end(Some(robot)).subscriber(1);
    let begun = Instant::now();
    let newcomer = keystore.enclave("newcomer", Right::Publish, None);
    let _publisher = end(Some(&newcomer)).publisher(10_000, HZ);
    subscriber.samples();
    begun.elapsed()
}

/// How many commands of a running publisher still arrive in [`LISTENED`] after its permissions have expired.
fn after_the_end_with_sros2(keystore: &Keystore, robot: &Path) -> usize {
    let ended = keystore.enclave("ended", Right::Publish, Some(LASTS));
    let begun = Instant::now();
    let mut subscriber = end(Some(robot)).subscriber_for(LASTS + LISTENED + Duration::from_secs(2));
    let _publisher = end(Some(&ended)).publisher(10_000, HZ);
    // The validity has whole seconds.
    let after = begun + LASTS + Duration::from_secs(1);
    subscriber.arrivals().into_iter().filter(|at| (after..after + LISTENED).contains(at)).count()
}

/// From the call that revokes a driver's certificate until its last command reaches the robot, while it publishes on. None if
/// no command arrives after the call.
fn revoked_on_the_ledger(runtime: &Runtime, site: &Site, ends: &mut Ends) -> Option<Duration> {
    let founding = site.network.founding();
    let certificate = Certificate::parse(&founding.salma.chain[0]).unwrap();
    let issuer = hex::encode(certificate.issuer_name.hash().0);
    let args = vec![issuer.into(), hex::encode(&certificate.serial).into()];
    let admin = runtime.block_on(site.network.connect(&founding.operator));
    let mut revoking = None;
    let mut called = Instant::now();
    for number in 0..100 {
        if number == 25 {
            (called, revoking) = (Instant::now(), Some(runtime.spawn(revoke(admin.clone(), args.clone()))));
        }
        ends.write(runtime);
        std::thread::sleep(Duration::from_secs_f64(1.0 / HZ));
    }
    runtime.block_on(revoking.unwrap()).unwrap();
    let (before, newest) = ends.arrivals();
    assert!(before > 20, "the driver drove before: {before} commands arrived");
    newest.checked_duration_since(called)
}

async fn revoke(admin: ledger_api::Client, args: Vec<Bytes>) {
    admin.invoke("msp", "revoke", args).await.unwrap();
}

/// From the decision that somebody may drive until the robot hears the first command: registered, enrolled, granted, with a
/// bridge that starts.
fn newcomer_to_the_ledger(runtime: &Runtime, site: &mut Site) -> Duration {
    let founding = site.network.founding();
    let (node, root) = (founding.nodes[0].1.clone(), root(&founding.operator));
    let admin = runtime.block_on(site.network.connect(&founding.operator));
    let begun = Instant::now();
    let context = runtime.block_on(async {
        let attributes = BTreeMap::from([("Turtlebot4".to_owned(), "true".to_owned())]);
        let registered = admin.register("Newcomer", Role::Member, &attributes).await.unwrap();
        Enrolment::new(node, root).enrol("Newcomer", &registered.secret, KeyKind::Ed25519).await.unwrap()
    });
    runtime.block_on(site.drive(&context, NEWCOMER_DOMAIN));
    let mut ends = runtime.block_on(Ends::open(Middleware::Dds, NEWCOMER_DOMAIN, ROBOT_DOMAIN));
    while ends.arrivals().0 == 0 {
        assert!(begun.elapsed() < Duration::from_secs(30), "the newcomer does not drive");
        ends.write(runtime);
        std::thread::sleep(Duration::from_secs_f64(1.0 / HZ));
    }
    begun.elapsed()
}

/// The fingerprint of the CA behind an identity.
fn root(context: &ledger_api::Context) -> Hash {
    let msp = context.msps.get(&context.organisation).unwrap();
    Hash::of(&[msp.roots().next().unwrap()])
}

fn print(sides: &[Side], people: &People) {
    println!("\nms, from publishing to receiving at {HZ} Hz; CPU of all processes for each sample, µs");
    for side in sides {
        let at = |quantile| side.latency.value_at_quantile(quantile) as f64 / 1e6;
        println!("{:8} p50 {:6.3}  p99 {:6.3}  CPU {:6.0}", side.name, at(0.5), at(0.99), side.cpu_us());
    }
    let People { new_to_sros2, new_to_the_ledger, after_expiry, revoked } = people;
    println!("\nuntil somebody new drives: SROS2 {new_to_sros2:.1?}, ledger {new_to_the_ledger:.1?}");
    println!("SROS2: {after_expiry} commands arrived in {LISTENED:?} after the publisher's permissions had expired");
    match revoked {
        Some(last) => println!("ledger: the last command arrived {last:.1?} after the call that revoked"),
        None => println!("ledger: no command arrived after the call that revoked"),
    }
}

fn results(sides: &[Side], people: &People) -> Value {
    let side = |side: &Side| json!({ "name": side.name, "latency_ms": report::percentiles(&side.latency), "cpu_us": side.cpu_us() });
    json!({
        "hz": HZ, "sides": sides.iter().map(side).collect::<Vec<_>>(), "new_with_sros2_s": people.new_to_sros2.as_secs_f64(),
        "new_with_the_ledger_s": people.new_to_the_ledger.as_secs_f64(),
        "commands_after_expiry_with_sros2": people.after_expiry,
        "last_after_revocation_s": people.revoked.map(|last| last.as_secs_f64()),
    })
}
