//! Bridges that name no route: they learn from the ledger which robots there are. CycloneDDS is at both ends.

use crate::python::Python;
use crate::sharing::owner_of;
use crate::support::page::{get, values};
use crate::support::wait::eventually;
use crate::world::{self, Process, World};
use crate::{call, command, network, stop_message};
use ledger_api::Client;
use ros_bridge::dds::{Matched, Participant};
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::Limits;
use rustix::process::Signal;
use std::time::Duration;

const TYPE: &str = "geometry_msgs/msg/Twist";
const DEADLINE: Duration = Duration::from_secs(60);
/// Where the bridges tell their figures.
const SALMAS_PAGE: &str = "127.0.0.1:7461";
const ROVERS_PAGE: &str = "127.0.0.1:7462";

/// A robot with a command service and a feed, as its owner describes it.
fn description(robot: &str, organisation_attribute: &str) -> String {
    let service = |topic: &str, direction: &str| serde_json::json!({"topic": topic, "type": TYPE, "direction": direction, "max_age_ms": 5000, "lease_ms": 4000});
    let services = [service("/cmd_vel", "command"), service("/odom", "feed")];
    serde_json::json!({"name": robot, "attribute_required": organisation_attribute, "trusted": ["Org1", "Org2"], "services": services}).to_string()
}

fn start(world: &World, name: &str, domain: u16, discover: &str) -> Process {
    let settings = format!("domain_id = {domain}\nshared_memory = false\n[discover]\n{discover}");
    world.start_bridge_as(name, &settings, &[])
}

/// Other nodes of the operator's graph.
struct Graph(Participant);

impl Graph {
    async fn open(domain: u16) -> Self {
        Self(Participant::open(domain, "operator").await.unwrap())
    }

    fn writer(&self, topic: &str) -> ros_bridge::dds::Writer {
        let (topic, kind) = (TopicName::parse(topic).unwrap(), TypeName::parse(TYPE).unwrap());
        self.0.writer(&topic, &kind, &Qos::default()).unwrap()
    }

    fn reader(&self, topic: &str) -> ros_bridge::dds::Reader {
        let (topic, kind) = (TopicName::parse(topic).unwrap(), TypeName::parse(TYPE).unwrap());
        self.0.reader(&topic, &kind, &Qos::default(), Limits::default()).unwrap()
    }
}

async fn until_matched(world: &World, matched: &Matched, count: usize) {
    let reached = async {
        while matched.now().matched != count {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    let reached = tokio::time::timeout(DEADLINE, reached).await;
    reached.unwrap_or_else(|_| panic!("{} instead of {count}\n{}", matched.now().matched, world.logs()));
}

fn route<'a>(report: &'a serde_json::Value, service: &str) -> &'a serde_json::Value {
    report["routes"].as_array().unwrap().iter().find(|route| route["service"] == service).unwrap()
}

/// The sum of the values of a figure with these words among their labels, on the page of a bridge.
fn sum(page: &str, figure: &str, words: &str) -> f64 {
    let metrics = get(page, "/metrics").1;
    values(&metrics, figure).into_iter().filter(|(labels, _)| labels.contains(words)).map(|(_, value)| value).sum()
}

/// Waits until Salma's bridge has kept back so many commands.
fn are_withheld(count: f64) {
    eventually("her bridge keeps all of them back", || {
        (sum(SALMAS_PAGE, "ledgerd_bridge_dropped_total", "withheld") >= count).then_some(())
    });
}

/// Waits until the robot's bridge has decided on so many commands.
fn are_judged(count: f64) {
    eventually("the robot's bridge has all of them", || {
        let figures = ["ledgerd_bridge_delivered_total", "ledgerd_bridge_dropped_total"];
        (figures.map(|figure| sum(ROVERS_PAGE, figure, "cmd_vel")).iter().sum::<f64>() >= count).then_some(())
    });
}

async fn replace(owner: &Client, robot: &str) {
    call(owner, "replace", &[&description(robot, "Rover")]).await;
}

/// Neither side names a route. Commands begin to pass when Salma holds the service, and end with her grant; the feed
/// comes without one.
#[test]
fn a_user_drives_and_watches_a_robot_that_neither_bridge_names() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let owner = owner_of(&world).await;
        replace(&owner, "Rover").await;
        let rover = start(&world, "Rover", 3, &format!("robot = 'Rover'\n[admin]\nlisten = '{ROVERS_PAGE}'\n"));
        let salma = start(&world, "Salma", 1, &format!("namespace = '/fleet'\n[admin]\nlisten = '{SALMAS_PAGE}'\n"));
        world.line("Rover", &["Rover/cmd_vel -> /cmd_vel"]).await;
        world.line("Rover", &["/odom -> Rover/odom"]).await;
        world.line("Salma", &["/fleet/Rover/cmd_vel -> Rover/cmd_vel"]).await;
        world.line("Salma", &["Rover/odom -> /fleet/Rover/odom"]).await;

        // Without a grant nothing is submitted.
        let mut robot = Python::start("twist_subscriber.py", &["3", "rt/cmd_vel", "0", "0", "0", "240"]);
        assert_eq!((robot.line().unwrap(), robot.line().unwrap()), ("ready".to_owned(), "matched".to_owned()));
        let early = Python::start("twist_publisher.py", &["1", "rt/fleet/Rover/cmd_vel", "20", "50", "0", "900"]);
        assert!(early.finish());
        are_withheld(20.0);
        call(&world.salma, "acquire", &["Rover/cmd_vel", "60000"]).await;
        world.line("Salma", &["grant held"]).await;
        let mut teleop = Python::start("twist_publisher.py", &["1", "rt/fleet/Rover/cmd_vel", "30", "50", "0"]);
        assert_eq!(teleop.line().unwrap(), "matched");
        let sent = [(); 30].map(|()| teleop.line().unwrap());
        assert!(teleop.finish());
        are_judged(30.0);
        call(&world.salma, "release", &["Rover/cmd_vel"]).await;
        world.line("Salma", &["grant ended"]).await;
        let late = Python::start("twist_publisher.py", &["1", "rt/fleet/Rover/cmd_vel", "20", "50", "0", "900"]);
        assert!(late.finish());
        are_withheld(40.0);

        // The feed, the other way.
        let mut odom = Python::start("twist_publisher.py", &["3", "rt/odom", "3000", "20", "0", "5000"]);
        assert_eq!(odom.line().unwrap(), "matched");
        let mut watch = Python::start("twist_subscriber.py", &["1", "rt/fleet/Rover/odom", "20", "0", "0", "60"]);
        assert_eq!((watch.line().unwrap(), watch.line().unwrap()), ("ready".to_owned(), "matched".to_owned()));
        for number in 0..20 {
            watch.line().unwrap_or_else(|| panic!("feed {number}\n{}", world.logs()));
        }
        assert!(watch.finish());

        let (salma, rover) = (salma.report(), rover.report());
        let commands = route(&salma, "Rover/cmd_vel");
        assert_eq!((&commands["submitted"], &commands["committed"]), (&30.into(), &30.into()), "{commands}");
        assert_eq!((&commands["withheld"], &commands["refused"]), (&40.into(), &serde_json::json!({})), "{commands}");
        // The robot heard each in its turn, and stands now. Only a machine that stalled until the robot was stopped may have kept
        // some from it.
        let (delivered, stops) = (route(&rover, "Rover/cmd_vel"), &route(&rover, "Rover/cmd_vel")["stops"]);
        let published = delivered["published"].as_u64().unwrap();
        let dropped: u64 = delivered["gate"].as_object().unwrap().values().map(|count| count.as_u64().unwrap()).sum();
        let stalled = ["stale", "uncertified"].iter().any(|reason| stops[reason] != serde_json::Value::Null);
        assert!(published + dropped == 30 && (dropped == 0 || stalled), "{rover}");
        let mut rest = sent.iter();
        for number in 0..published {
            let heard = command(&mut robot).unwrap_or_else(|| panic!("{number}\n{}", world.logs()));
            assert!(rest.any(|sent| *sent == heard), "{heard} is not hers, or comes too late");
        }
        assert_eq!(robot.line().unwrap(), stop_message());
    });
}

#[test]
fn robots_and_services_come_change_and_go_while_the_bridge_runs_and_others_are_not_touched() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let owner = owner_of(&world).await;
        let bridge = start(&world, "Salma", 1, "deny = { to_ledger = ['.*/secret'] }");
        let graph = Graph::open(1).await;
        let rover = graph.writer("/Rover/cmd_vel");
        until_matched(&world, rover.matched(), 1).await;

        // One more robot; another needs an attribute that Salma has not, and one service is denied here.
        let (arm, odom) = (graph.writer("/Arm/cmd_vel"), graph.reader("/Arm/odom"));
        call(&owner, "setup", &[&description("Arm", "Rover")]).await;
        call(&owner, "setup", &[&description("Vault", "Safe")]).await;
        world.register("Hidden", "/secret", TYPE).await;
        until_matched(&world, arm.matched(), 1).await;
        until_matched(&world, odom.matched(), 1).await;
        world.line("Salma", &["not offered", "Vault/cmd_vel", "LGR-3001"]).await;

        // A service with another type has another route, and the robot that is removed has none.
        let other = description("Arm", "Rover").replace(TYPE, "std_msgs/msg/String");
        call(&owner, "replace", &[&other]).await;
        until_matched(&world, arm.matched(), 0).await;
        world.line("Salma", &["/Arm/cmd_vel -> Arm/cmd_vel", "std_msgs/msg/String"]).await;
        call(&owner, "remove", &["Arm"]).await;
        world.line("Salma", &["discovered: 2 routes ended, 0 started"]).await;

        // A policy that lets her no longer.
        crate::apply(&owner, &[("nobody", "forbid (principal, action, resource);")]).await;
        until_matched(&world, rover.matched(), 0).await;
        crate::apply(&owner, &[]).await;
        until_matched(&world, rover.matched(), 1).await;
        let report = bridge.report();
        let services: Vec<_> =
            report["routes"].as_array().unwrap().iter().map(|route| route["service"].clone()).collect();
        assert_eq!(services, ["Rover/cmd_vel"], "{report}");
    });
}

#[test]
fn on_sighup_discovery_begins_changes_and_ends_and_a_configured_route_counts_before_it() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let head = "domain_id = 1\nshared_memory = false\n";
        let set = format!(
            "[[route]]\nservice = 'Rover/cmd_vel'\ndirection = 'to_ledger'\ntopic = '/drive'\ntype = '{TYPE}'\n"
        );
        let bridge = world.start_bridge_as("Salma", &format!("{head}{set}"), &[]);
        let graph = Graph::open(1).await;
        let [drive, plain, fleet] =
            ["/drive", "/Rover/cmd_vel", "/fleet/Rover/cmd_vel"].map(|topic| graph.writer(topic));
        until_matched(&world, drive.matched(), 1).await;
        let reload = |text: &str| {
            world.config_of("Salma", &format!("{head}{text}"));
            bridge.signal(Signal::HUP);
        };
        reload(&format!("{set}[discover]\n"));
        world.line("Salma", &["0 routes ended, 0 started"]).await;
        reload("[discover]\n");
        until_matched(&world, plain.matched(), 1).await;
        until_matched(&world, drive.matched(), 0).await;
        reload("[discover]\nnamespace = '/fleet'\n");
        until_matched(&world, fleet.matched(), 1).await;
        until_matched(&world, plain.matched(), 0).await;
        reload(&set);
        until_matched(&world, drive.matched(), 1).await;
        until_matched(&world, fleet.matched(), 0).await;
    });
}
