//! Plays the paper: Salma and Farhad of Org1, three robots of Org2.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, camera, farhad, owner, salma};
use ledger_abac::{Authorization, Caller, Grant, Mode, Reason, Released, RobotAsset};
use ledger_base::rejection::Code;
use ledger_storage::result::Event;
use serde_json::{Value, json};

#[test]
fn the_experiment_of_the_paper_runs_as_told() {
    let mut fleet = Fleet::of_the_paper();
    let (salma, farhad) = (salma(), farhad());

    // Farhad lacks the attribute of the Husky; both have the one of the Turtlebot4.
    let refusal = fleet.refused(&farhad, Code::MissingAttribute, "acquire", &["Husky"]);
    assert!(refusal.message.contains("Husky=true"), "{refusal}");
    let grant: Grant = fleet.get(&salma, "acquire", &["Turtlebot4"]);
    assert_eq!((grant.service.as_str(), grant.holder.as_str(), grant.epoch), (TURTLEBOT, "Org1/Salma", 1));
    assert_eq!(grant.mode, Mode::EXCLUSIVE);
    fleet.refused(&farhad, Code::Held, "acquire", &["Turtlebot4"]);

    // Both send; only the messages of Salma are published.
    for seq in 1..=10 {
        fleet.set(&salma, TURTLEBOT, 1, seq, 1).unwrap();
        fleet.set_refused(&farhad, Code::NotHolder, TURTLEBOT, 0, seq);
    }
    assert_eq!(fleet.events.iter().filter(|event| event.name == "message").count(), 10);

    // Two robots at once are fine for one user.
    fleet.ok(&salma, "acquire", &["Husky"]);
    fleet.ok(&salma, "release", &[TURTLEBOT]);
    assert_eq!(
        fleet.newest::<Released>("released"),
        Released {
            service: TURTLEBOT.into(),
            holder: "Org1/Salma".into(),
            epoch: 1,
            reason: Reason::Released.into(),
            by: None,
            goes_on: false,
        }
    );
    let grant: Grant = fleet.get(&farhad, "acquire", &["Turtlebot4"]);
    assert_eq!((grant.holder.as_str(), grant.epoch), ("Org1/Farhad", 2));
    fleet.set(&farhad, TURTLEBOT, 2, 1, 1).unwrap();
    let husky: RobotAsset = fleet.get(&farhad, "robot", &["Husky"]);
    assert_eq!(husky.operator, "Org1/Salma");

    // The paper's comparison: in open mode the messages of both are published.
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"mode":"open"}"#]);
    fleet.set(&salma, TURTLEBOT, 0, 1, 1).unwrap();
    fleet.set(&farhad, TURTLEBOT, 0, 1, 1).unwrap();
    assert_eq!(fleet.events.iter().filter(|event| event.name == "message").count(), 13);
}

#[test]
fn a_robot_reads_as_the_asset_of_the_paper() {
    let mut fleet = Fleet::of_the_paper();
    let fields = ["Name", "SubTopic", "PubTopic", "owner", "UnderOp"];
    let paper = |asset: &Value| Value::from_iter(fields.map(|field| (field.to_owned(), asset[field].clone())));

    let asset: Value = fleet.get(&salma(), "robot", &["Turtlebot4"]);
    let free = json!({"Name": "Turtlebot4", "SubTopic": "/cmd_vel", "PubTopic": "", "owner": "", "UnderOp": false});
    assert_eq!(paper(&asset), free);
    fleet.ok(&salma(), "acquire", &["Turtlebot4"]);
    let asset: Value = fleet.get(&salma(), "robot", &["Turtlebot4"]);
    assert_eq!((&asset["owner"], &asset["UnderOp"]), (&json!("Org1/Salma"), &json!(true)));
    assert_eq!(asset["organisation"], "Org2");
    assert_eq!(asset["trusted"], json!(["Org1", "Org2"]));
    assert_eq!(asset["services"][0]["type"], "geometry_msgs/msg/Twist");

    let camera: Value = fleet.get(&salma(), "robot", &["OptiTrack"]);
    let feed = json!({"Name": "OptiTrack", "SubTopic": "", "PubTopic": "/poses", "owner": "", "UnderOp": false});
    assert_eq!(paper(&camera), feed);
    let robots: Vec<RobotAsset> = fleet.get(&salma(), "robots", &[]);
    assert_eq!(robots.iter().map(|r| r.name.as_str()).collect::<Vec<_>>(), ["Husky", "OptiTrack", "Turtlebot4"]);
}

#[test]
fn the_camera_publishes_its_poses_and_users_with_the_attribute_read_them() {
    let mut fleet = Fleet::of_the_paper();
    fleet.set(&camera(), "OptiTrack/poses", 0, 1, 1).unwrap();
    let refusal = fleet.set_refused(&salma(), Code::DeniedByPolicy, "OptiTrack/poses", 0, 1);
    assert!(refusal.message.contains("feed"), "{refusal}");

    let message: Event = fleet.events.last().unwrap().clone();
    assert_eq!((message.name.as_str(), message.subject.as_str()), ("message", "OptiTrack/poses"));
    fleet.may_read(&salma(), &message).unwrap();
    fleet.may_read(&camera(), &message).unwrap();
    fleet.may_read(&owner(), &message).unwrap();
    assert_eq!(fleet.may_read(&farhad(), &message).unwrap_err().code, Code::MissingAttribute);

    // What is no message, every member may know.
    let registered = fleet.events.iter().find(|event| event.name == "robot").unwrap();
    fleet.may_read(&farhad(), registered).unwrap();
}

#[test]
fn authorize_decides_as_set_and_acquire_would() {
    let mut fleet = Fleet::of_the_paper();
    let ask = |fleet: &mut Fleet, who: &_, args: &[&str]| fleet.get::<Authorization>(who, "authorize", args);

    let before = ask(&mut fleet, &salma(), &[TURTLEBOT]);
    assert!(!before.allowed && before.name == "NOT_HOLDER" && !before.reason.is_empty(), "{before:?}");
    assert!(ask(&mut fleet, &salma(), &[TURTLEBOT, "acquire"]).allowed);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.set(&salma(), TURTLEBOT, 1, 7, 1).unwrap();
    let holder = ask(&mut fleet, &salma(), &[TURTLEBOT]);
    assert_eq!((holder.allowed, holder.code.as_str(), holder.epoch, holder.next_seq), (true, "LGR-0000", 1, 8));
    let other = ask(&mut fleet, &farhad(), &[TURTLEBOT, "acquire"]);
    assert_eq!((other.allowed, other.code.as_str(), other.name.as_str()), (false, "LGR-3005", "HELD"));
    assert!(ask(&mut fleet, &farhad(), &[TURTLEBOT, "subscribe"]).allowed);
    assert_eq!(ask(&mut fleet, &farhad(), &[HUSKY, "subscribe"]).name, "MISSING_ATTRIBUTE");
    assert_eq!(ask(&mut fleet, &farhad(), &[HUSKY]).name, "MISSING_ATTRIBUTE");
}

#[test]
fn a_caller_sees_who_they_are() {
    let mut fleet = Fleet::empty();
    let me: Caller = fleet.get(&farhad(), "GetSubmittingClientIdentity", &[]);
    assert_eq!((me.id.as_str(), me.organisation.as_str(), me.serial.as_str()), ("Org1/Farhad", "Org1", "02"));
    assert_eq!(me.attributes.get("Turtlebot4").map(String::as_str), Some("true"));
}
