//! The local graph is lost for a while: the process at the other end stands still, or the network interface is gone. Afterwards
//! the routes carry messages again, and nobody starts anything anew.

use crate::peer::{PEERS, Peer, number};
use crate::python::{CYCLONE, Python};
use crate::world::{self, World};
use crate::{call, network};
use std::process::Command;
use std::time::{Duration, Instant};

const TYPE: &str = "geometry_msgs/msg/Twist";
const TOPIC: &str = "rt/cmd_vel";
/// More than a test has time for.
const MANY: (u32, u32, usize) = (100_000, 50, 0);

fn signal(name: &str, process: &Python) {
    let id = process.child.id().to_string();
    assert!(Command::new("kill").args([name, &id]).status().unwrap().success());
}

fn set_interface(state: &str) {
    assert!(Command::new("ip").args(["link", "set", "lo", state]).status().unwrap().success());
}

/// The robot's controller hears a message with a number above this; answers with that number.
fn hears_beyond(world: &World, robot: &mut Python, beyond: u32) -> u32 {
    loop {
        let heard = number(robot).unwrap_or_else(|| panic!("nothing comes beyond {beyond}\n{}", world.logs()));
        if heard > beyond {
            return heard;
        }
    }
}

/// Salma drives the robot through two bridges; both ends speak this DDS.
struct Drive {
    world: World,
    _bridges: [world::Process; 2],
    robot: Python,
    teleop: Python,
}

impl Drive {
    async fn begin(peer: Peer) -> Self {
        let world = World::start("/cmd_vel", TYPE).await;
        call(&world.salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        let bridges = [("Salma", 1, "to_ledger"), ("Rover", 3, "from_ledger")]
            .map(|(name, domain, way)| world.start_default_bridge(name, domain, way, "/cmd_vel", TYPE));
        let mut robot = peer.subscribes(3, TOPIC, (0, 0), &[]);
        assert_eq!((robot.line().as_deref(), robot.line().as_deref()), (Some("ready"), Some("matched")));
        let teleop = peer.publishes(1, TOPIC, MANY, &[]);
        hears_beyond(&world, &mut robot, 20);
        Self { world, _bridges: bridges, robot, teleop }
    }
}

#[test]
fn peers_that_stood_still_until_they_were_given_up_are_served_and_heard_again() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        for peer in PEERS {
            let Drive { world, mut robot, teleop, _bridges } = Drive::begin(peer).await;
            signal("-STOP", &teleop);
            signal("-STOP", &robot);
            world.line("Salma", &["a publisher on /cmd_vel has left"]).await;
            world.line("Rover", &["a subscriber on /cmd_vel has left"]).await;
            signal("-CONT", &robot);
            signal("-CONT", &teleop);
            // Old messages, and stops, come first. A number that was not yet said proves that both ways work.
            let mut before = hears_beyond(&world, &mut robot, 20);
            let deadline = Instant::now() + Duration::from_secs(60);
            let mut fresh = 0;
            while fresh < 50 {
                let heard = hears_beyond(&world, &mut robot, before);
                fresh += u32::from(heard > before);
                before = heard;
                assert!(Instant::now() < deadline, "{peer:?}: only {fresh} new ones\n{}", world.logs());
            }
        }
    });
}

#[test]
fn an_interface_that_went_and_came_back_carries_messages_again() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        for peer in PEERS {
            let Drive { world, mut robot, teleop: _teleop, _bridges } = Drive::begin(peer).await;
            set_interface("down");
            // The robot's bridge stops it: so much is certain without a network.
            world.line("Rover", &["lost: the ledger gives no sign of life"]).await;
            world.line("Salma", &["a publisher on /cmd_vel has left"]).await;
            world.line("Rover", &["a subscriber on /cmd_vel has left"]).await;
            set_interface("up");
            world.line("Rover", &["the ledger is back"]).await;
            let mut before = hears_beyond(&world, &mut robot, 20);
            for _ in 0..50 {
                before = hears_beyond(&world, &mut robot, before);
            }
        }
    });
}

/// CycloneDDS on the interface `robot0`, with a peer at this address of it.
fn on_robot0(address: &str) -> String {
    CYCLONE.replace("name='lo'", "name='robot0'").replace("127.0.0.1", address)
}

fn ip(words: &str) {
    assert!(Command::new("ip").args(words.split(' ')).status().unwrap().success(), "ip {words}");
}

/// Gives the interface another address, and nodes of the graph there that were started after that.
fn graph_at(address: &str) -> (Python, Python) {
    let cyclone = on_robot0(address);
    let stream = |args: &[&str]| Python::start_within(&[], &cyclone, "stream.py", args);
    let mut robot = stream(&["sub", "3", TOPIC, "0", "90", "0"]);
    assert_eq!(robot.line().as_deref(), Some("ready"));
    (robot, stream(&["pub", "1", TOPIC, "100000", "50", "0"]))
}

#[test]
fn a_bridge_whose_interface_has_got_another_address_joins_the_graph_again() {
    if !network::isolated(&|| ()) {
        return;
    }
    ip("link add robot0 type veth peer name robot1");
    ip("address add 10.77.0.1/24 dev robot0");
    ["robot0", "robot1"].into_iter().for_each(|name| ip(&format!("link set {name} up")));
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        call(&world.salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        let _bridges = [("Salma", 1, "to_ledger"), ("Rover", 3, "from_ledger")]
            .map(|(name, domain, way)| world.start_bridge(name, domain, way, "/cmd_vel", TYPE));
        let (mut robot, teleop) = graph_at("10.77.0.1");
        assert_eq!(robot.line().as_deref(), Some("matched"));
        hears_beyond(&world, &mut robot, 20);
        drop((robot, teleop));

        ip("address del 10.77.0.1/24 dev robot0");
        ip("address add 10.77.0.2/24 dev robot0");
        for name in ["Salma", "Rover"] {
            world.line(name, &["the addresses of this host have changed", "10.77.0.2"]).await;
        }
        let deadline = Instant::now() + Duration::from_secs(60);
        for name in ["Salma", "Rover"] {
            while world.said(name, " is ready: ROS domain") < 2 {
                assert!(Instant::now() < deadline, "{name} does not join again\n{}", world.logs());
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    });
}
