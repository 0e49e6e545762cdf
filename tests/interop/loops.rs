//! Messages from the ledger do not get there again: not through another bridge, not through a relay, over DDS or shared
//! memory. Otherwise one command becomes thousands, never too old, and the lease never ends.

use std::time::Duration;

use ledger_base::hash::Hash;
use ledger_gate::sample::Sample;
use ros_bridge::{
    dds::{Participant, Reader, Writer},
    mark::Mark,
    names::{TopicName, TypeName},
    qos::Qos,
    queue::{Incoming, Limits},
    shm,
    stop::stop_message,
};

use crate::{
    call, expired, network,
    world::{self, World},
};

const DEADLINE: Duration = Duration::from_secs(60);
const TWIST: &str = "geometry_msgs/msg/Twist";
/// A grant that ends soon unless it is used.
const LEASE_MS: &str = "5000";
/// A user's bridge learns the network's time to half a round trip, which a busy machine makes long. A robot that has just
/// started takes a command that seems to be from before its start for an old one, and these tests send a command once.
const CLOCKS_AGREE: Duration = Duration::from_secs(1);

fn kind() -> TypeName {
    TypeName::parse(TWIST).unwrap()
}

fn topic(name: &str) -> TopicName {
    TopicName::parse(name).unwrap()
}

fn twist(number: u8) -> Sample {
    Sample::new([0, 1], &[number; 48]).unwrap()
}

fn route(direction: &str, topic: &str) -> String {
    // The driver of these tests sends one message, and a busy machine is not taken for a network that is silent.
    let patience = if direction == "from_ledger" { "command_timeout_ms = 0\nstale_after_ms = 10000\n" } else { "" };
    format!(
        "[[route]]\nservice = \"Rover/cmd_vel\"\ndirection = {direction:?}\ntopic = {topic:?}\ntype = {TWIST:?}\n{patience}"
    )
}

/// A node of ROS 2 beside the bridges.
struct Node(Participant);

impl Node {
    async fn open(domain: u16, name: &str) -> Self {
        Self(Participant::open(domain, name).await.unwrap())
    }

    fn writer(&self, name: &str) -> Writer {
        self.0.writer(&topic(name), &kind(), &Qos::default()).unwrap()
    }

    /// The publications of others; those of this node are left out.
    fn reader(&self, name: &str) -> Reader {
        self.0.reader(&topic(name), &kind(), &Qos::default(), Limits::default()).unwrap()
    }
}

async fn in_time<T>(world: &World, what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(DEADLINE, future).await.unwrap_or_else(|_| panic!("never: {what}\n{}", world.logs()))
}

async fn next(world: &World, reader: &mut Reader) -> Incoming {
    in_time(world, "a message arrives", reader.next()).await.unwrap()
}

/// The next message that is no stop: while nobody has driven, a bridge stops whoever comes.
async fn command(world: &World, reader: &mut Reader) -> Sample {
    loop {
        let sample = next(world, reader).await.sample;
        if sample != stop_message(&kind()).unwrap() {
            return sample;
        }
    }
}

/// Nothing else is left than the stop, said again.
fn only_stops(mut left: impl FnMut() -> Option<Incoming>) {
    while let Some(incoming) = left() {
        assert_eq!(incoming.sample, stop_message(&kind()).unwrap());
    }
}

async fn matched(world: &World, reader: &Reader, writer: &Writer) {
    assert!(in_time(world, "a bridge publishes", reader.matched().at_least(1)).await);
    assert!(in_time(world, "a bridge subscribes", writer.matched().at_least(1)).await);
    tokio::time::sleep(CLOCKS_AGREE).await;
}

async fn acquire(world: &World, mode: &str) {
    if mode == "exclusive" {
        call(&world.salma, "acquire", &["Rover/cmd_vel", LEASE_MS]).await;
        world.line("Salma", &["grant held"]).await;
    }
}

/// The lease has ended: nobody has used the grant since.
async fn is_free(world: &World, mode: &str) {
    if mode == "exclusive" {
        call(&world.farhad, "acquire", &["Rover/cmd_vel"]).await;
    }
}

/// README's two configurations on one machine: neither says which domain.
async fn two_bridges_in_one_domain(mode: &str) {
    let routes = ["to_ledger", "from_ledger"].map(|direction| route(direction, "/cmd_vel"));
    two_bridges(mode, routes).await;
}

/// The routes are those of Salma and of the robot, on `/cmd_vel`.
async fn two_bridges(mode: &str, [salma, rover]: [String; 2]) {
    let world = World::start_with_mode("/cmd_vel", TWIST, mode).await;
    let bridges = [("Salma", salma), ("Rover", rover)]
        .map(|(name, routes)| world.start_bridge_as(name, &format!("shared_memory = false\n{routes}"), &[]));
    let node = Node::open(0, "teleop").await;
    let (writer, mut reader) = (node.writer("/cmd_vel"), node.reader("/cmd_vel"));
    matched(&world, &reader, &writer).await;
    world.line("Salma", &["ROS domain 0 (from the default)", "ready"]).await;
    world.line("Salma", &["WARN", "another bridge publishes on /cmd_vel what came from the ledger", "circle"]).await;
    world.line("Rover", &["WARN", "another bridge takes /cmd_vel to Rover/cmd_vel", "circle"]).await;
    world.line("Rover", &["WARN", "a publisher beside this bridge on /cmd_vel", "go around the ledger"]).await;
    acquire(&world, mode).await;
    writer.write(&twist(1)).unwrap();
    assert_eq!(command(&world, &mut reader).await, twist(1));
    // Nothing renews the lease: it ends, and the robot is told to stop.
    assert_eq!(next(&world, &mut reader).await.sample, stop_message(&kind()).unwrap());
    is_free(&world, mode).await;
    only_stops(|| reader.try_next());
    let [salma, rover] = bridges.map(|bridge| bridge.report()["routes"][0].clone());
    assert_eq!((&salma["samples_in"], &salma["committed"]), (&1.into(), &1.into()), "{salma}");
    // Stops may not have come back yet.
    assert!(salma["returned"].as_u64().unwrap() >= 1, "{salma}");
    assert_eq!(rover["published"], 1, "{rover}");
}

#[test]
fn two_bridges_in_one_domain_make_no_loop_of_an_exclusive_service() {
    if network::isolated(&|| ()) {
        world::run(two_bridges_in_one_domain("exclusive"));
    }
}

#[test]
fn two_bridges_in_one_domain_make_no_loop_of_an_open_service() {
    if network::isolated(&|| ()) {
        world::run(two_bridges_in_one_domain("open"));
    }
}

#[test]
fn two_bridges_in_one_domain_make_no_loop_of_a_route_that_they_discovered() {
    if network::isolated(&|| ()) {
        let salma = "[discover]\nremap = { 'Rover/cmd_vel' = '/cmd_vel' }\n".to_owned();
        let rover = "[discover]\nrobot = 'Rover'\n".to_owned();
        world::run(two_bridges("open", [salma, rover]));
    }
}

#[test]
fn a_route_that_opens_late_tells_of_a_bridge_that_was_there_before() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TWIST).await;
        let late = route("from_ledger", "/late").replace("Rover/cmd_vel", "Late/late");
        let routes = format!("shared_memory = false\n{}{late}", route("from_ledger", "/cmd_vel"));
        let _rover = world.start_bridge_as("Rover", &routes, &[]);
        let node = Node::open(0, "another").await;
        let mark = Mark::new(&Hash([7; 32]), "Other/late");
        let _bridge = node.0.marked_writer(&topic("/late"), &kind(), &Qos::default(), mark).unwrap();
        // DDS announces them in this order: a bridge that knows this publisher knows the other bridge.
        let _publisher = node.writer("/cmd_vel");
        world.line("Rover", &["WARN", "a publisher beside this bridge on /cmd_vel"]).await;
        world.register("Late", "/late", TWIST).await;
        world.line("Rover", &["WARN", "a publisher beside this bridge on /late"]).await;
    });
}

/// The same where local processes use shared memory; the bridges use both, as they do by default.
async fn two_bridges_over_shared_memory(mode: &str) {
    let world = World::start_with_mode("/cmd_vel", TWIST, mode).await;
    // Shared memory has no namespaces, so this topic is this test's own.
    let name = format!("/loop_{mode}_{}", std::process::id());
    let bridges = [("Salma", "to_ledger"), ("Rover", "from_ledger")]
        .map(|(user, direction)| world.start_bridge_as(user, &route(direction, &name), &[]));
    let node = shm::Node::open(0, "teleop", [7; 16]).await.unwrap();
    let publisher = node.publisher(&topic(&name)).await.unwrap();
    let mut subscriber = node.subscriber(&topic(&name), Limits::default()).await.unwrap();
    world.line("Salma", &["another bridge publishes on", "circle"]).await;
    let there = async {
        // Ours, and the bridge's.
        while publisher.subscribers() < 2 || subscriber.publishers() < 2 {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    in_time(&world, "the bridges use shared memory", there).await;
    tokio::time::sleep(CLOCKS_AGREE).await;
    acquire(&world, mode).await;
    publisher.write(&twist(1)).unwrap();
    let mut received = async || in_time(&world, "a message arrives", subscriber.next()).await.unwrap().sample;
    let stop = stop_message(&kind()).unwrap();
    let mut heard = received().await;
    while heard == stop {
        heard = received().await;
    }
    assert_eq!(heard, twist(1));
    assert_eq!(received().await, stop);
    is_free(&world, mode).await;
    only_stops(|| subscriber.try_next());
    let [salma, rover] = bridges.map(|bridge| bridge.report()["routes"][0].clone());
    assert_eq!((&salma["samples_in"], &salma["committed"]), (&1.into(), &1.into()), "{salma}");
    // The message and stops, over DDS and shared memory; the last may not have come back yet.
    assert!(salma["returned"].as_u64().unwrap() >= 1, "{salma}");
    assert_eq!(rover["published"], 1, "{rover}");
}

#[test]
fn two_bridges_over_shared_memory_make_no_loop_of_an_exclusive_service() {
    if network::isolated(&|| ()) {
        world::run(two_bridges_over_shared_memory("exclusive"));
    }
}

#[test]
fn two_bridges_over_shared_memory_make_no_loop_of_an_open_service() {
    if network::isolated(&|| ()) {
        world::run(two_bridges_over_shared_memory("open"));
    }
}

/// Somebody of the operator's domain watches the robot's topic under its own name.
#[test]
fn a_bridge_that_watches_in_the_operators_domain_makes_no_loop() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start_with_mode("/cmd_vel", TWIST, "open").await;
        let settings = |domain, direction| {
            format!("domain_id = {domain}\nshared_memory = false\n{}", route(direction, "/cmd_vel"))
        };
        let salma = world.start_bridge_as("Salma", &settings(1, "to_ledger"), &[]);
        let mut watching = world.start_bridge_as("Farhad", &settings(1, "from_ledger"), &[]);
        let rover = world.start_bridge_as("Rover", &settings(3, "from_ledger"), &[]);
        let (operator, robot) = (Node::open(1, "teleop").await, Node::open(3, "driver").await);
        let (writer, watcher) = (operator.writer("/cmd_vel"), operator.reader("/cmd_vel"));
        let mut driver = robot.reader("/cmd_vel");
        assert!(in_time(&world, "the robot's bridge is there", driver.matched().at_least(1)).await);
        matched(&world, &watcher, &writer).await;
        world.line("Salma", &["another bridge publishes on /cmd_vel", "circle"]).await;
        for number in 1..4 {
            writer.write(&twist(number)).unwrap();
            // A stop in between, if this takes long: the lease of a driver who sends nothing ends.
            while next(&world, &mut driver).await.sample != twist(number) {}
            // Also one that was killed, and is known again before it publishes anything.
            drop(watching);
            watching = world.start_bridge_as("Farhad", &settings(1, "from_ledger"), &[]);
            world.line("Farhad", &["a subscriber on /cmd_vel has come"]).await;
        }
        assert_eq!(next(&world, &mut driver).await.sample, stop_message(&kind()).unwrap());
        only_stops(|| driver.try_next());
        let salma = salma.report()["routes"][0].clone();
        assert_eq!((&salma["samples_in"], &salma["committed"]), (&3.into(), &3.into()), "{salma}");
        assert_eq!(rover.report()["routes"][0]["published"], 3);
    });
}

/// A node that passes messages on from one topic to another, as relays and multiplexers do.
async fn relay(from: Reader, to: Writer) {
    let mut from = from;
    while let Some(incoming) = from.next().await {
        to.write(&incoming.sample).unwrap();
    }
}

/// A sample that is delivered on `/watched` comes back to `/cmd_vel` through a relay. `bridges` are those of the
/// operator's domain.
async fn a_relay_in_the_operators_domain(bridges: &[(&str, String)]) {
    let world = World::start_with_mode("/cmd_vel", TWIST, "exclusive").await;
    let settings = |domain: u16, routes: &str| format!("domain_id = {domain}\nshared_memory = false\n{routes}");
    let start = |name: &str, domain, routes: &str| world.start_bridge_as(name, &settings(domain, routes), &[]);
    let rover = start("Rover", 3, &route("from_ledger", "/cmd_vel"));
    let mut bridges: Vec<_> = bridges.iter().map(|(name, routes)| start(name, 1, routes)).collect();
    let (teleop, passes_on, robot) =
        (Node::open(1, "teleop").await, Node::open(1, "relay").await, Node::open(3, "driver").await);
    let (writer, mut driver) = (teleop.writer("/cmd_vel"), robot.reader("/cmd_vel"));
    let (from, to) = (passes_on.reader("/watched"), passes_on.writer("/cmd_vel"));
    matched(&world, &driver, &writer).await;
    matched(&world, &from, &to).await;
    if bridges.len() > 1 {
        world.line("Salma", &["another bridge delivers Rover/cmd_vel on /watched"]).await;
    }
    let relay = tokio::spawn(relay(from, to));
    acquire(&world, "exclusive").await;
    // Constant commands are the normal case: all of them pass, but for those that a machine that stands still makes too old.
    let mut tick = tokio::time::interval(Duration::from_millis(20));
    for number in 0..50 {
        tick.tick().await;
        writer.write(&twist(1 + number / 25)).unwrap();
    }
    let mut heard = vec![command(&world, &mut driver).await];
    loop {
        let sample = next(&world, &mut driver).await.sample;
        if sample == stop_message(&kind()).unwrap() {
            break;
        }
        heard.push(sample);
    }
    let mut sent = (0..50).map(|number| twist(1 + number / 25));
    assert!(heard.iter().all(|sample| sent.any(|other| other == *sample)), "{heard:?}\n{}", world.logs());
    is_free(&world, "exclusive").await;
    only_stops(|| driver.try_next());
    relay.abort();
    let salma = bridges.remove(0).report()["routes"][0].clone();
    let passed = heard.len() as u64;
    // A stop message that the relay passes on late is taken in, because a driver may repeat itself after a pause. Without a grant it
    // goes no further.
    assert_eq!(&salma["committed"], passed, "{salma}");
    assert_eq!(passed + expired(&salma), 50, "{salma}");
    assert!(salma["returned"].as_u64().unwrap() >= passed, "{salma}");
    assert_eq!(rover.report()["routes"][0]["published"], passed);
}

#[test]
fn a_relay_of_what_the_same_bridge_delivers_makes_no_loop_and_constant_commands_pass() {
    if network::isolated(&|| ()) {
        let routes = route("to_ledger", "/cmd_vel") + &route("from_ledger", "/watched");
        world::run(a_relay_in_the_operators_domain(&[("Salma", routes)]));
    }
}

#[test]
fn a_relay_of_what_another_bridge_delivers_makes_no_loop_and_constant_commands_pass() {
    if network::isolated(&|| ()) {
        let bridges = [("Salma", route("to_ledger", "/cmd_vel")), ("Farhad", route("from_ledger", "/watched"))];
        world::run(a_relay_in_the_operators_domain(&bridges));
    }
}

#[test]
fn a_relay_of_what_another_bridge_delivers_makes_no_loop_of_a_discovered_route() {
    if network::isolated(&|| ()) {
        let salma = "[discover]\nremap = { 'Rover/cmd_vel' = '/cmd_vel' }\n".to_owned();
        world::run(a_relay_in_the_operators_domain(&[("Salma", salma), ("Farhad", route("from_ledger", "/watched"))]));
    }
}

#[test]
fn of_two_routes_that_close_a_circle_the_second_waits_and_both_are_named() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TWIST).await;
        // The second topic is the service's own, as only the ledger knows.
        let down = route("from_ledger", "/cmd_vel").replace("topic = \"/cmd_vel\"\n", "");
        let _bridge = world.start_bridge_as("Salma", &(route("to_ledger", "/cmd_vel") + &down), &[]);
        let words = ["route 2 waits", "LGR-7001", "Rover/cmd_vel to_ledger", "Rover/cmd_vel from_ledger"];
        assert!(world.line("Salma", &words).await.contains("routes 1 and 2 close a circle"));
        world.line("Salma", &["route 1: /cmd_vel -> Rover/cmd_vel"]).await;
    });
}

#[test]
fn two_bridges_that_take_one_topic_to_one_service_say_that_each_sample_comes_twice() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TWIST).await;
        let settings = format!("shared_memory = false\n{}", route("to_ledger", "/cmd_vel"));
        let environment = [("ROS_DOMAIN_ID", "5")];
        let _bridges = ["Salma", "Farhad"].map(|name| world.start_bridge_as(name, &settings, &environment));
        for name in ["Salma", "Farhad"] {
            world.line(name, &["ROS domain 5 (from ROS_DOMAIN_ID)"]).await;
            world.line(name, &["WARN", "another bridge takes /cmd_vel to Rover/cmd_vel too"]).await;
        }
    });
}
