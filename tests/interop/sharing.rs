//! The driver changes in the middle of a drive at 50 Hz: by preemption, by a turn in line, by an emergency stop. CycloneDDS
//! is at every end.

use crate::python::Python;
use crate::world::{self, World};
use crate::{call, network, stop_message};
use ledger_api::Client;
use std::time::{Duration, Instant};

const TYPE: &str = "geometry_msgs/msg/Twist";
/// Farhad's messages begin with this number, Salma's with 1.
const FARHADS: f64 = 5_000.0;
/// More than anybody waits for.
const MANY: &str = "3000";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Heard {
    Salma,
    Farhad,
    Stop,
}

/// The robot's controller.
pub(crate) struct Robot(Python);

impl Robot {
    pub(crate) fn listen() -> Self {
        let mut robot = Python::start("twist_subscriber.py", &["3", "rt/cmd_vel", "0", "0", "0", "240"]);
        assert_eq!((robot.line().unwrap(), robot.line().unwrap()), ("ready".to_owned(), "matched".to_owned()));
        Self(robot)
    }

    /// The next message in hexadecimal digits, with its header.
    pub(crate) fn line(&mut self) -> String {
        self.next_line().expect("the robot hears something within a minute")
    }

    /// The same, or nothing after a minute of silence.
    pub(crate) fn next_line(&mut self) -> Option<String> {
        self.0.line()
    }

    fn hear(&mut self) -> Heard {
        let line = self.line();
        if line == stop_message() {
            return Heard::Stop;
        }
        if number_in(&line) >= FARHADS { Heard::Farhad } else { Heard::Salma }
    }

    /// Hears whatever it is until the message with this number, or a later one.
    pub(crate) fn hears_number(&mut self, number: f64) {
        while number_in(&self.line()) < number {}
    }

    /// Hears nobody but `before` until `then`.
    pub(crate) fn hears(&mut self, before: Heard, then: Heard) {
        loop {
            match self.hear() {
                heard if heard == then => return,
                heard => assert_eq!(heard, before, "before {then:?}"),
            }
        }
    }

    /// Hears so many messages of this one and of nobody else. On a busy machine a robot that silence stops is stopped in between.
    pub(crate) fn hears_driving(&mut self, who: Heard, count: usize) {
        let commands = std::iter::from_fn(|| Some(self.hear())).filter(|heard| *heard != Heard::Stop);
        commands.take(count).for_each(|heard| assert_eq!(heard, who));
    }

    /// Hears this one and nobody else for as many messages.
    pub(crate) fn hears_only(&mut self, who: Heard, count: usize) {
        (0..count).for_each(|_| assert_eq!(self.hear(), who));
    }
}

/// The number of a message; 0 for a stop.
fn number_in(line: &str) -> f64 {
    f64::from_le_bytes(hex::decode(line).unwrap()[4..12].try_into().unwrap())
}

pub(crate) fn drives(domain: &str, first: &str) -> Python {
    let mut publisher = Python::start("twist_publisher.py", &[domain, "rt/cmd_vel", MANY, "50", "0", first]);
    assert_eq!(publisher.line().unwrap(), "matched");
    publisher
}

pub(crate) async fn owner_of(world: &World) -> Client {
    let context = ledger_api::Context::load(&world.path("home"), Some("dev-org2-admin")).unwrap();
    Client::connect(&context).await.unwrap()
}

/// Both publish all the time; the ledger decides whose messages reach the robot.
#[test]
fn who_drives_changes_by_priority_by_a_turn_and_by_a_stop_and_no_older_message_passes_after() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let owner = owner_of(&world).await;
        let permit = "@priority(\"0\") permit (principal, action, resource);
            @priority(\"5\") permit (principal == User::\"Org1/Farhad\", action, resource);";
        crate::apply(&owner, &[("all", permit)]).await;
        let preempt = r#"{"sharing":{"on_conflict":"preempt","queue_max":4,"priority":"policy"}}"#;
        call(&owner, "configure", &["Rover/cmd_vel", preempt]).await;
        let _bridges = world.start_bridges("/cmd_vel", TYPE);
        let mut robot = Robot::listen();
        call(&world.salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        world.line("Salma", &["grant held"]).await;
        let _drivers = [drives("1", "1"), drives("2", "5001")];
        robot.hears_only(Heard::Salma, 25);

        // Farhad has the higher priority: the robot stops for Salma's end, and hears only him then.
        call(&world.farhad, "acquire", &["Rover/cmd_vel", "600000"]).await;
        robot.hears(Heard::Salma, Heard::Stop);
        robot.hears_only(Heard::Farhad, 25);

        // Salma waits in line, and has her turn when he lets go.
        call(&world.salma, "acquire", &["Rover/cmd_vel", r#"{"lease_ms":600000}"#]).await;
        robot.hears_only(Heard::Farhad, 10);
        call(&world.farhad, "release", &["Rover/cmd_vel"]).await;
        robot.hears(Heard::Farhad, Heard::Stop);
        robot.hears_only(Heard::Salma, 25);

        // An emergency stop: the robot stops, and stays so though both go on publishing.
        call(&owner, "stop", &["Rover", "person in the cell"]).await;
        robot.hears(Heard::Salma, Heard::Stop);
        let refused = world.farhad.invoke("abac", "acquire", vec!["Rover/cmd_vel".into()]).await.unwrap_err();
        assert_eq!(refused.code, ledger_base::rejection::Code::Stopped);
        tokio::time::sleep(Duration::from_secs(1)).await;
        call(&owner, "resume", &["Rover"]).await;
        call(&world.farhad, "acquire", &["Rover/cmd_vel", "600000"]).await;
        robot.hears(Heard::Stop, Heard::Farhad);
        robot.hears_only(Heard::Farhad, 10);
    });
}

#[test]
fn a_stop_reaches_a_robot_that_anybody_may_command() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start_with_mode("/cmd_vel", TYPE, "open").await;
        let owner = owner_of(&world).await;
        let _bridges = world.start_bridges("/cmd_vel", TYPE);
        let mut robot = Robot::listen();
        let _driver = drives("1", "1");
        robot.hears_only(Heard::Salma, 25);
        call(&owner, "stop", &["*"]).await;
        robot.hears(Heard::Salma, Heard::Stop);
        let stopped = Instant::now();
        tokio::time::sleep(Duration::from_secs(1)).await;
        call(&owner, "resume", &["*"]).await;
        robot.hears(Heard::Stop, Heard::Salma);
        assert!(stopped.elapsed() >= Duration::from_secs(1), "it heard nothing while it was stopped");
    });
}
