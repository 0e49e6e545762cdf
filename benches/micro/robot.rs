//! The robot's side: the gate, and the two ways into its graph.

use crate::founding::clock;
use crate::{World, own_network, timed};
use bytes::Bytes;
use criterion::Criterion;
use ledger_abac::{Capabilities, Direction, Fencing, Grant, Mode, Publishing, Sequence};
use ledger_gate::gate::{Delivered, Gate, Now, Settings};
use ledger_gate::sample::{CDR_LE, SAMPLE_BYTES_MAX, Sample};
use ledger_gate::service::Service;
use ledger_gate::speed::Speeds;
use ledger_gate::standing::{Members, Standing};
use ros_bridge::dds::Participant;
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::{Incoming, Limits};
use ros_bridge::shm;
use std::cell::RefCell;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;

/// Domain of the leg over DDS, in a network of its own.
const DDS_DOMAIN: u16 = 3;
/// Time for one sample, or for two participants to find each other.
const WAIT_MAX: Duration = Duration::from_secs(20);

/// The robot's checks of every message: decode, time, epoch, holder, signature, sequence.
pub(crate) fn gate(criterion: &mut Criterion) {
    let world = RefCell::new(World::new());
    let (context, epoch) = (world.borrow().founding.salma.clone(), world.borrow().epoch);
    let now = || Now { wall: clock(), steady: clock() };
    let settings = Settings {
        network: context.network,
        sample_bytes_max: SAMPLE_BYTES_MAX,
        max_age: None,
        // The answer counts as long as the benchmark takes.
        stale_after: Duration::from_secs(3600),
        command_timeout: None,
    };
    // Opened before any of the commands was signed; those are valid for a minute.
    let mut gate = Gate::new(settings, "Turtlebot4/cmd_vel", now());
    let service = Service {
        service: "Turtlebot4/cmd_vel".into(),
        robot: "Turtlebot4".into(),
        organisation: "Org2".into(),
        topic: "/cmd_vel".into(),
        type_name: "geometry_msgs/msg/Twist".into(),
        capabilities: Capabilities {
            publishing: Publishing::Grant,
            fencing: Fencing::Newest,
            sequence: Sequence::PerEpoch,
        },
        direction: Direction::Command,
        max_age_ms: 1000,
        lease_ms: 10_000,
        stop_hex: None,
        confidential: false,
        speeds: Speeds::default(),
        epoch,
    };
    let time = clock();
    let grant = Grant {
        service: service.service.clone(),
        holder: "Org1/Salma".to_owned(),
        epoch,
        expires: time + 10_000_000,
        mode: Mode::EXCLUSIVE,
        acquired_at: time,
        lease_ms: 10_000,
        next_seq: 0,
        taken: None,
        limits: ledger_abac::Limits::default(),
        givers: Vec::new(),
        may_delegate: false,
        follows: None,
        task: None,
        policy_version: 0,
        policies: Vec::new(),
    };
    let standing = Standing {
        services: Vec::new(),
        grants: vec![grant],
        tasks: Vec::new(),
        stopped: false,
        settled: std::collections::BTreeSet::new(),
        members: Members { msps: Arc::clone(&context.msps), revoked: Arc::default(), barred: Arc::default() },
        height: 1,
        time,
    };
    gate.learn(&service, &standing, now().steady, now());
    let certificate = Bytes::copy_from_slice(&context.chain[0]);
    criterion.bench_function("gate", |bencher| {
        timed(
            bencher,
            || world.borrow_mut().command(),
            |command| {
                let delivered =
                    Delivered { block_time: clock(), transaction: command.encoded(), certificate: &certificate };
                assert_eq!(gate.pass(delivered, now()).unwrap().samples.len(), 1);
            },
        );
    });
}

/// One way between two participants on this machine, one sample at a time, as the bridge reads and writes.
pub(crate) fn dds_leg(criterion: &mut Criterion) {
    if !own_network::is_own() {
        eprintln!(
            "dds_leg is left out: no network namespace of its own (needs unshare, ip, and the right to use them)"
        );
        return;
    }
    let runtime = runtime();
    let (topic, message) = cmd_vel();
    let (writer, mut reader) = runtime.block_on(async {
        let (here, there) = (
            Participant::open(DDS_DOMAIN, "here").await.unwrap(),
            Participant::open(DDS_DOMAIN, "there").await.unwrap(),
        );
        let writer = here.writer(&topic, &message, &Qos::default()).unwrap();
        let reader = there.reader(&topic, &message, &Qos::default(), Limits::default()).unwrap();
        let both = async { writer.matched().at_least(1).await && reader.matched().at_least(1).await };
        assert!(timeout(WAIT_MAX, both).await.unwrap());
        (writer, reader)
    });
    leg(criterion, "dds_leg", &runtime, |sample| writer.write(sample).unwrap(), async || reader.next().await);
}

/// The same through shared memory.
pub(crate) fn iceoryx2_leg(criterion: &mut Criterion) {
    let runtime = runtime();
    // Shared memory has no namespaces: a name that no other process has.
    let topic = TopicName::parse(&format!("/bench_{}", std::process::id())).unwrap();
    let (publisher, mut subscriber) = runtime.block_on(async {
        let (here, there) =
            (shm::Node::open(0, "here", [7; 16]).await.unwrap(), shm::Node::open(0, "there", [8; 16]).await.unwrap());
        (here.publisher(&topic).await.unwrap(), there.subscriber(&topic, Limits::default()).await.unwrap())
    });
    let publish = |sample: &Sample| assert_eq!(publisher.write(sample).unwrap(), 1);
    leg(criterion, "iceoryx2_leg", &runtime, publish, async || subscriber.next().await);
}

fn runtime() -> Runtime {
    Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap()
}

fn cmd_vel() -> (TopicName, TypeName) {
    (TopicName::parse("/cmd_vel").unwrap(), TypeName::parse("geometry_msgs/msg/Twist").unwrap())
}

/// From handing a sample over until its reader's task has it.
fn leg(
    criterion: &mut Criterion,
    name: &str,
    runtime: &Runtime,
    publish: impl Fn(&Sample),
    mut next: impl AsyncFnMut() -> Option<Incoming>,
) {
    let mut number = 0_u64;
    criterion.bench_function(name, |bencher| {
        bencher.iter_custom(|iterations| {
            let mut total = Duration::ZERO;
            for _ in 0..iterations {
                number += 1;
                let sample = Sample::new(CDR_LE, &number.to_le_bytes().repeat(6)).unwrap();
                let start = Instant::now();
                publish(&sample);
                let received = runtime.block_on(async { timeout(WAIT_MAX, next()).await.unwrap().unwrap() });
                total += start.elapsed();
                assert_eq!(received.sample, sample);
            }
            total
        });
    });
}
