//! A confidential service driven at 50 Hz through two bridges, while readers come and one is revoked. CycloneDDS is at every end.

use crate::python::Python;
use crate::sharing::owner_of;
use crate::world::{self, World};
use crate::{call, network};
use ledger_api::{Client, Context};
use std::fs;
use std::path::Path;

const TYPE: &str = "geometry_msgs/msg/Twist";
const SERVICE: &str = "Rover/cmd_vel";
const COUNT: usize = 150;

/// Is the body of a message, in hexadecimal digits with its header, in a file below the directory?
fn lies_below(directory: &Path, message: &str) -> bool {
    let wanted = hex::decode(message).unwrap().split_off(4);
    fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).any(|path| {
        if path.is_dir() {
            return lies_below(&path, message);
        }
        let bytes = fs::read(&path).unwrap_or_default();
        bytes.windows(wanted.len()).any(|part| part == wanted)
    })
}

/// A key for which nobody has the secret half: it is only there so that the readers change.
const SOMEBODYS_KEY: &str = "0900000000000000000000000000000000000000000000000000000000000000";

#[test]
fn commands_of_a_confidential_service_reach_the_robot_as_they_were_and_no_disk_has_them() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let owner = owner_of(&world).await;
        call(&owner, "configure", &[SERVICE, r#"{"sharing":{"confidential":true}}"#]).await;
        let _rover = world.start_bridge("Rover", 3, "from_ledger", "/cmd_vel", TYPE);
        world.line("Rover", &["entered as a reader of a confidential service"]).await;
        call(&world.salma, "acquire", &[SERVICE, "600000"]).await;
        let salma = world.start_bridge("Salma", 1, "to_ledger", "/cmd_vel", TYPE);
        world.line("Salma", &["content key shared"]).await;

        let count = COUNT.to_string();
        let mut robot = Python::start("twist_subscriber.py", &["3", "rt/cmd_vel", "0", "0", "0", "60"]);
        assert_eq!((robot.line().unwrap(), robot.line().unwrap()), ("ready".to_owned(), "matched".to_owned()));
        let mut operator = Python::start("twist_publisher.py", &["1", "rt/cmd_vel", &count, "50", "0", "1"]);
        assert_eq!(operator.line().unwrap(), "matched");
        let mut sent = Vec::new();
        for number in 0..COUNT {
            if number == COUNT / 2 {
                call(&owner, "reader", &[SERVICE, SOMEBODYS_KEY]).await;
            }
            sent.push(operator.line().unwrap());
        }
        let mut heard = Vec::new();
        while heard.last() != sent.last() {
            heard.push(robot.line().unwrap_or_else(|| panic!("only {} of {COUNT}\n{}", heard.len(), world.logs())));
        }
        assert!(heard.iter().all(|line| sent.contains(line)), "nothing but what was sent");
        // Those that were under way while the readers changed are refused: few, unless the machine stalls just then.
        let (moves, report) = (heard.len(), salma.report());
        let refused = report["routes"][0]["refused"].as_object().unwrap();
        assert!(refused.keys().all(|code| code == "READERS_CHANGED"), "{report}");
        let refused = refused.values().map(|count| usize::try_from(count.as_u64().unwrap()).unwrap()).sum::<usize>();
        assert!(
            moves + refused > COUNT - 20 && moves > COUNT / 3,
            "{moves} and {refused} of {COUNT}\n{}",
            world.logs()
        );
        for message in [&sent[0], &sent[COUNT - 1]] {
            assert!(!lies_below(&world.path("net"), message), "a node has {message}");
        }
    });
}

#[test]
fn a_revoked_reader_of_a_confidential_feed_hears_nothing_more_and_the_others_go_on() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let owner = owner_of(&world).await;
        let admin =
            Client::connect(&Context::load(&world.path("home"), Some("dev-org1-admin")).unwrap()).await.unwrap();
        let settings = r#"{"direction":"feed","mode":"open","sharing":{"confidential":true}}"#;
        call(&owner, "configure", &[SERVICE, settings]).await;
        call(&owner, "reader", &[SERVICE, SOMEBODYS_KEY]).await;
        let _rover = world.start_bridge("Rover", 3, "to_ledger", "/cmd_vel", TYPE);
        let _bridges = [("Salma", 1), ("Farhad", 2)]
            .map(|(name, domain)| world.start_bridge(name, domain, "from_ledger", "/cmd_vel", TYPE));
        for name in ["Salma", "Farhad"] {
            world.line(name, &["entered as a reader of a confidential service"]).await;
        }
        let mut sensor = Python::start("twist_publisher.py", &["3", "rt/cmd_vel", "3000", "20", "0", "1"]);
        assert_eq!(sensor.line().unwrap(), "matched");
        let mut listeners = ["1", "2"].map(|domain| {
            let mut listener = Python::start("twist_subscriber.py", &[domain, "rt/cmd_vel", "0", "0", "0", "240"]);
            assert_eq!(
                (listener.line().unwrap(), listener.line().unwrap()),
                ("ready".to_owned(), "matched".to_owned())
            );
            listener.line().expect("both hear the robot");
            listener
        });
        let shared = world.lines("Rover", "content key shared");
        admin.revoke_identity("Farhad", "").await.unwrap();
        world.line("Farhad", &["the ledger has ended the subscription"]).await;
        let [salma, farhad] = &mut listeners;
        let late = Python::start("twist_subscriber.py", &["2", "rt/cmd_vel", "1", "0", "0", "3"]);
        assert!(!late.finish(), "nothing comes on Farhad's side any more");
        while farhad.try_line().is_some() {}
        for _ in 0..60 {
            salma.line().expect("Salma goes on");
        }
        assert!(farhad.try_line().is_none() && world.lines("Rover", "content key shared") > shared, "{}", world.logs());
    });
}
