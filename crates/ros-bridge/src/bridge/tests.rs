//! Whole routes, between a real local graph and a ledger that answers what the test says.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

mod beside;
mod latched_tests;
mod limit_tests;
mod lost_tests;
mod shm_tests;
mod start_tests;
mod stop_tests;

use std::{
    path::Path,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_api::Context;
use ledger_base::rejection::Code;
use ledger_gate::{
    fixture::{Network, User, micros},
    sample::{CDR_LE, Sample},
};
use serde_json::json;
use testkit::own_network as network;

use self::beside::{Beside, Reader, Writer};
use super::{Bridge, run::keep_running};
use crate::{
    config::Config,
    graph::{
        dds::Matched,
        messages::stop::stop_message,
        names::{TopicName, TypeName},
        qos::Qos,
        queue::Limits,
    },
    ledger::fake::{Fake, Fate, held_by},
    routes::counters::RouteSummary,
};

const DEADLINE: Duration = Duration::from_secs(20);
const DOMAIN: u16 = 5;

struct Bench {
    fake: Arc<Fake>,
    network: Network,
    bridge: Bridge,
    graph: Beside,
}

/// A bridge with one route, and another ROS 2 node beside it.
async fn bench(mode: &str, more: &str, prepare: impl FnOnce(&Fake)) -> Bench {
    bench_with("shared_memory = false", mode, more, prepare).await
}

/// The same with these settings of the bridge.
async fn bench_with(settings: &str, mode: &str, more: &str, prepare: impl FnOnce(&Fake)) -> Bench {
    let network = Network::until(2900);
    let fake = Fake::new(mode, &network);
    prepare(&fake);
    // A driver of these tests sends one message, and the ledger gives no sign of life by itself.
    let mut more = more.to_owned();
    for (key, patient) in [("command_timeout_ms", 0), ("stale_after_ms", 20_000)] {
        if more.contains("from_ledger") && !more.contains(key) {
            more += &format!("\n{key} = {patient}");
        }
    }
    beside::prepare().await;
    let transport = beside::transport();
    let text = format!(
        "domain_id = {DOMAIN}\n{transport}\n{settings}\n[[route]]\nservice = 'T/cmd_vel'\n\
         type = 'geometry_msgs/msg/Twist'\n{more}"
    );
    let config = Config::parse(&text, Path::new(""), |_| ()).unwrap();
    let bridge = Bridge::start_with(config, fake.clone(), &context(&network)).await.unwrap();
    let graph = Beside::open("beside").await;
    Bench { fake, network, bridge, graph }
}

fn context(network: &Network) -> Context {
    Context {
        name: "T".into(),
        organisation: "Org2".into(),
        network: network.robot.network,
        label: String::new(),
        nodes: vec!["127.0.0.1:1".into()],
        chain: Vec::new(),
        key: Arc::clone(&network.robot.key),
        msps: Arc::clone(&network.msps),
        renew: ledger_api::context::RenewalRule::default(),
        memory: ledger_api::context::Memory::default(),
    }
}

fn names() -> (TopicName, TypeName) {
    (TopicName::parse("/cmd_vel").unwrap(), TypeName::parse("geometry_msgs/msg/Twist").unwrap())
}

impl Bench {
    async fn reader(&self) -> Robot {
        let (topic, message) = names();
        let reader = self.graph.reader(&topic, &message, &Qos::default(), Limits::default()).await.unwrap();
        self.matched(reader.matched()).await;
        Robot { reader, stands: true }
    }

    async fn writer(&self) -> Writer {
        let (topic, message) = names();
        let writer = self.graph.writer(&topic, &message, &Qos::default()).await.unwrap();
        self.matched(writer.matched()).await;
        writer
    }

    /// Waits until both ends know each other.
    async fn matched(&self, beside: &Matched) {
        assert!(tokio::time::timeout(DEADLINE, beside.at_least(1)).await.unwrap());
        // A route that follows its neighbours' QoS makes a new end meanwhile.
        self.until(|route| route.matched == 1).await;
    }

    async fn sets(&self, count: usize) -> Vec<Vec<Bytes>> {
        let mut sets = self.fake.sets.subscribe();
        let enough = sets.wait_for(|sets| sets.len() >= count);
        tokio::time::timeout(DEADLINE, enough).await.unwrap().unwrap().clone()
    }

    /// Waits until the route has done something.
    async fn until(&self, holds: impl Fn(&RouteSummary) -> bool) {
        let done = async {
            while !holds(&self.bridge.summary().routes[0]) {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        tokio::time::timeout(DEADLINE, done).await.unwrap();
    }

    fn message(&self, user: &User, epoch: u64, seq: u64) -> (Sample, u64) {
        let sample = twist(7);
        let now = self.message_of(user, epoch, seq, &sample);
        (sample, now)
    }

    fn message_of(&self, user: &User, epoch: u64, seq: u64, sample: &Sample) -> u64 {
        let now = micros();
        let signed = sign(user, epoch, seq, sample, now);
        self.fake.deliver(now, "message", &json!({}), Some((&signed, &user.certificate)));
        now
    }
}

fn sign(user: &User, epoch: u64, seq: u64, sample: &Sample, now: u64) -> Transaction {
    User { not_after: now + 2_500_000, ..user.clone() }.set(epoch, seq, &[sample.wire().clone()])
}

fn twist(number: u8) -> Sample {
    Sample::new(CDR_LE, &[number; 48]).unwrap()
}

fn stop() -> Sample {
    stop_message(&names().1).unwrap()
}

/// A robot that hears a stop once, however often it is said.
struct Robot {
    reader: Reader,
    stands: bool,
}

impl Robot {
    /// The next message, stops that are said again among them.
    async fn hear(&mut self) -> Sample {
        tokio::time::timeout(DEADLINE, self.reader.next()).await.unwrap().unwrap().sample
    }
}

async fn next(robot: &mut Robot) -> Sample {
    loop {
        let heard = robot.hear().await;
        let stood = std::mem::replace(&mut robot.stands, heard == stop());
        if !(stood && robot.stands) {
            return heard;
        }
    }
}

/// How often the robot was stopped, and why; but for the start of the bridge.
fn stops(mut summary: RouteSummary) -> Vec<(&'static str, u64)> {
    summary.stops.remove("start");
    summary.stops.into_iter().collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_users_samples_are_submitted_in_order_with_the_epoch_of_the_grant() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'to_ledger'", |fake| fake.set_own_epoch(3)).await;
    let writer = bench.writer().await;
    for number in 0..20 {
        writer.write(&twist(number)).unwrap();
    }
    let sets = bench.sets(20).await;
    let mut last = 0;
    for (number, args) in (0..).zip(&sets) {
        assert_eq!((&args[0][..], &args[1][..], args.len()), (&b"T/cmd_vel"[..], &b"3"[..], 4));
        assert_eq!(args[3], twist(number).wire());
        let seq: u64 = std::str::from_utf8(&args[2]).unwrap().parse().unwrap();
        assert!(seq > last, "{seq} follows {last}");
        last = seq;
    }
    let grant = json!(held_by("Org1/Salma", 4, 10_000));
    bench.fake.deliver(micros(), "granted", &grant, None);
    let mut count = 20;
    let changed = loop {
        writer.write(&twist(1)).unwrap();
        count += 1;
        let newest = bench.sets(count).await.pop().unwrap();
        if newest[1] != "3" {
            break newest;
        }
    };
    assert_eq!(changed[1], "4");
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(summary.samples_in, count as u64);
    assert_eq!((summary.submitted, summary.committed), (count as u64, summary.commit_us.count));
    assert!(summary.commit_us.max >= summary.commit_us.p50);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_sample_whose_length_cannot_be_the_types_is_refused_here_and_never_submitted() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'to_ledger'\nbatch_max = 4", |fake| fake.set_own_epoch(3)).await;
    let writer = bench.writer().await;
    // Multiples of four: DDS fills others up. A longer one passes: some writers leave bytes behind a message.
    for length in [4, 24, 44] {
        writer.write(&Sample::new(CDR_LE, &vec![7; length]).unwrap()).unwrap();
    }
    writer.write(&twist(1)).unwrap();
    let sets = bench.sets(1).await;
    assert_eq!((sets[0].len(), &sets[0][3]), (4, twist(1).wire()), "one message, and the right one");
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(summary.refused[Code::BadMessage.name()], 3);
    assert_eq!((summary.samples_in, summary.submitted), (4, 1));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn refusals_are_counted_by_code_and_the_grant_is_asked_for_again() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'to_ledger'", |fake| {
        fake.set_fate(Fate::Refused(Code::NotHolder));
    })
    .await;
    bench.fake.set_own_epoch(9);
    let writer = bench.writer().await;
    let mut count = 0;
    let refreshed = async {
        loop {
            writer.write(&twist(1)).unwrap();
            count += 1;
            if bench.sets(count).await[count - 1][1] == "9" {
                break;
            }
        }
    };
    tokio::time::timeout(DEADLINE, refreshed).await.unwrap();
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    let refused = summary.refused["NOT_HOLDER"];
    assert!(refused + 1 >= count as u64 && summary.committed == 0, "{refused} of {count}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_ledger_that_is_slower_than_the_topic_gets_the_newest_samples() {
    if !network::isolated(&|| ()) {
        return;
    }
    let more = "direction = 'to_ledger'\nqos = { depth = 20 }";
    let bench = bench("exclusive", more, |fake| fake.set_fate(Fate::Lost)).await;
    let writer = bench.writer().await;
    // Far more than may be without a verdict: the rest must neither pile up nor be submitted.
    for number in 0..1000u32 {
        writer.write(&twist(u8::try_from(number % 250).unwrap())).unwrap();
        if number % 10 == 9 {
            assert!(writer.flush(DEADLINE).await);
        }
    }
    let sets = bench.sets(256).await;
    assert_eq!(sets.len(), 256);
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert!(summary.replaced >= 1000 - 256 - 20 - 100, "{} were replaced", summary.replaced);
    assert_eq!((summary.submitted, summary.committed), (256, 0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn what_passes_the_gate_reaches_the_robot_and_a_release_stops_it() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| fake.set_holder("Org1/Salma", 3, 10_000)).await;
    let mut reader = bench.reader().await;
    let (salma, farhad) = (&bench.network.salma, &bench.network.farhad);
    let (sent, _) = bench.message(salma, 3, 1);
    assert_eq!(next(&mut reader).await, sent);
    bench.message(farhad, 3, 2);
    bench.message(salma, 3, 1);
    let released = json!({ "service": "T/cmd_vel", "holder": "Org1/Salma", "epoch": 3, "reason": "released" });
    bench.fake.set_free();
    bench.fake.deliver(micros(), "released", &released, None);
    assert_eq!(next(&mut reader).await, stop());
    bench.message(salma, 3, 5);
    bench.fake.set_holder("Org1/Farhad", 4, 10_000);
    // The bridge has not heard of the grant: this message waits for the answer of the voters.
    let (sent, _) = bench.message(farhad, 4, 1);
    assert_eq!(next(&mut reader).await, sent, "nothing in between");
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(next(&mut reader).await, stop(), "Farhad moved it last");
    assert_eq!((summary.published, summary.stops["released"], summary.stops["shutdown"]), (2, 1, 1));
    assert_eq!(summary.gate["not_holder"], 2);
    assert_eq!(summary.gate["stale_sequence"], 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_silent_ledger_stops_the_robot() {
    if !network::isolated(&|| ()) {
        return;
    }
    let more = "direction = 'from_ledger'\nstale_after_ms = 5000";
    let bench = bench("exclusive", more, |fake| fake.set_holder("Org1/Salma", 3, 10_000)).await;
    let mut reader = bench.reader().await;
    let (sent, _) = bench.message(&bench.network.salma, 3, 1);
    assert_eq!(next(&mut reader).await, sent);
    assert_eq!(next(&mut reader).await, stop());
    let before_stop = bench.bridge.summary().routes.pop().unwrap();
    assert_eq!(before_stop.published, 1);
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(stops(summary), [("stale", 1)], "it stands already when the bridge ends");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_driver_whose_lease_has_run_out_is_stopped_while_the_node_still_gives_signs_of_life() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| fake.set_holder("Org1/Salma", 3, 1500)).await;
    let mut reader = bench.reader().await;
    let (sent, _) = bench.message(&bench.network.salma, 3, 1);
    assert_eq!(next(&mut reader).await, sent);
    let alive = async {
        loop {
            bench.fake.heartbeat(micros());
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::select! {
        stopped = next(&mut reader) => assert_eq!(stopped, stop()),
        () = alive => {}
    }
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(stops(summary), [("lease", 1)]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_robot_stops_when_no_majority_of_the_voters_answers_while_its_node_still_gives_signs_of_life() {
    if !network::isolated(&|| ()) {
        return;
    }
    let more = "direction = 'from_ledger'\nstale_after_ms = 3000";
    let bench = bench("exclusive", more, |fake| fake.set_holder("Org1/Salma", 3, 60_000)).await;
    let mut reader = bench.reader().await;
    let salma = &bench.network.salma;
    let alive = async {
        loop {
            bench.fake.heartbeat(micros());
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    let withheld = async {
        let (sent, _) = bench.message(salma, 3, 1);
        assert_eq!(next(&mut reader).await, sent);
        bench.fake.answers.store(false, Ordering::Relaxed);
        assert_eq!(next(&mut reader).await, stop());
        // Signed and delivered, but nobody knows who holds the robot now.
        bench.message(salma, 3, 2);
        bench.fake.set_holder("Org1/Farhad", 4, 60_000);
        bench.fake.answers.store(true, Ordering::Relaxed);
        bench.until(|summary| summary.gate.contains_key("stale_epoch")).await;
    };
    tokio::select! {
        () = withheld => {}
        () = alive => {}
    }
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(summary.published, 1);
    assert_eq!(stops(summary), [("uncertified", 1)]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_node_that_makes_up_a_grant_moves_no_robot() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| fake.set_holder("Org1/Salma", 3, 60_000)).await;
    let mut reader = bench.reader().await;
    let (salma, farhad) = (&bench.network.salma, &bench.network.farhad);
    // Farhad has signed an acquire, which the ledger refused.
    let acquire = User { not_after: micros() + 30_000_000, ..farhad.clone() };
    let acquire = acquire.sign("abac", "acquire", vec!["T/cmd_vel".into()]);
    let made_up = json!(held_by("Org1/Farhad", 4, 60_000));
    bench.fake.deliver(micros(), "granted", &made_up, Some((&acquire, &farhad.certificate)));
    bench.message(farhad, 4, 1);
    bench.until(|summary| summary.gate.contains_key("unknown_epoch")).await;
    let (sent, _) = bench.message(salma, 3, 1);
    assert_eq!(next(&mut reader).await, sent, "nothing in between");
    assert_eq!(bench.bridge.stop().await.routes.pop().unwrap().published, 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn events_that_never_end_do_not_put_off_a_stop() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| {
        fake.set_holder("Org1/Salma", 3, 1500);
        fake.floods.store(true, Ordering::Relaxed);
    })
    .await;
    let mut reader = bench.reader().await;
    let (sent, _) = bench.message(&bench.network.salma, 3, 1);
    assert_eq!(next(&mut reader).await, sent);
    assert_eq!(next(&mut reader).await, stop());
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(stops(summary), [("lease", 1)]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_revocation_stops_the_robot_that_the_revoked_moved() {
    if !network::isolated(&|| ()) {
        return;
    }
    for event in ["revoked", "revocation_list"] {
        let bench = bench("open", "direction = 'from_ledger'\nstale_after_ms = 60000", |_| ()).await;
        let mut reader = bench.reader().await;
        let salma = &bench.network.salma;
        let (sent, _) = bench.message(salma, 0, 1);
        assert_eq!(next(&mut reader).await, sent);
        let revoked = salma.revocation(&bench.network);
        let serials = ["07", &revoked.serial, "08"];
        let told = json!({ "issuer": revoked.issuer, "serial": revoked.serial, "serials": serials });
        bench.fake.deliver(micros(), event, &told, None);
        assert_eq!(next(&mut reader).await, stop(), "{event}");
        let summary = bench.bridge.stop().await.routes.pop().unwrap();
        assert_eq!(summary.stops["revoked"], 1, "{event}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_change_of_mode_counts_from_its_block_on() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| fake.set_holder("Org1/Salma", 3, 10_000)).await;
    let mut reader = bench.reader().await;
    let farhad = &bench.network.farhad;
    bench.message(farhad, 0, 1);
    bench.fake.set_mode("open");
    bench.fake.deliver(micros(), "robot", &json!({ "robot": "T" }), None);
    let (sent, _) = bench.message(farhad, 0, 2);
    assert_eq!(next(&mut reader).await, sent);
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!((summary.published, summary.gate["stale_epoch"]), (1, 1));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_robot_whose_rule_this_version_does_not_know_is_not_driven() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| fake.set_holder("Org1/Salma", 3, 10_000)).await;
    let mut reader = bench.reader().await;
    let salma = &bench.network.salma;
    let (sent, _) = bench.message(salma, 3, 1);
    assert_eq!(next(&mut reader).await, sent);
    bench.fake.set_mode("limited");
    bench.fake.deliver(micros(), "robot", &json!({ "robot": "T" }), None);
    assert_eq!(next(&mut reader).await, stop());
    bench.message(salma, 3, 2);
    bench.until(|summary| summary.gate.contains_key("no_service")).await;
    bench.fake.set_mode("exclusive");
    bench.fake.deliver(micros(), "robot", &json!({ "robot": "T" }), None);
    let (sent, _) = bench.message(salma, 3, 3);
    assert_eq!(next(&mut reader).await, sent, "nothing in between");
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!((summary.published, summary.stops["no_service"], summary.gate["no_service"]), (2, 1, 1));
}
