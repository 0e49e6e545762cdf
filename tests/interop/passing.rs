//! A grant with limits, and one that is passed on, at a robot that is driven at 50 Hz. CycloneDDS is at every end.

use crate::python::Python;
use crate::sharing::{Heard, Robot, drives, owner_of};
use crate::world::{self, World};
use crate::{call, expired, network};
use ledger::transaction::Transaction;
use ledger_api::Subscription;

const TYPE: &str = "geometry_msgs/msg/Twist";

/// The linear and the angular vector of a Twist in hexadecimal digits.
fn vectors(message: &str) -> [[f64; 3]; 2] {
    let body = hex::decode(message).unwrap().split_off(4);
    let double = |at: usize| f64::from_le_bytes(body[at * 8..at * 8 + 8].try_into().unwrap());
    [0, 3].map(|at| [double(at), double(at + 1), double(at + 2)])
}

fn length(vector: [f64; 3]) -> f64 {
    vector.iter().map(|number| number * number).sum::<f64>().sqrt()
}

#[test]
fn a_command_above_the_limit_of_a_policy_reaches_the_robot_slower_and_stays_on_the_ledger_as_it_was_sent() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let owner = owner_of(&world).await;
        let slowly = r#"@max_linear("0.5") permit (principal, action, resource);"#;
        crate::apply(&owner, &[("all", slowly)]).await;
        let mut on_ledger = owner.subscribe(Subscription {
            from_height: 1,
            chaincode: "abac".into(),
            names: vec!["message".into()],
            heartbeat: 200,
            ..Subscription::default()
        });
        let bridges = world.start_bridges("/cmd_vel", TYPE);
        let mut robot = Robot::listen();
        call(&world.salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        world.line("Salma", &["grant held"]).await;
        let mut salma = Python::start("twist_publisher.py", &["1", "rt/cmd_vel", "50", "50", "0", "1"]);
        assert_eq!(salma.line().unwrap(), "matched");
        let sent: Vec<_> = (0..50).map(|_| salma.line().unwrap()).collect();
        assert!(salma.finish());
        let (mut coming, mut passed) = (sent.iter(), Vec::new());
        while !coming.as_slice().is_empty() {
            // Silence: the last ones have expired.
            let Some(line) = robot.next_line() else { break };
            // It turns as it was told to: that has no limit.
            let (_, angular) = line.split_at(line.len() - 48);
            let before = coming.find(|message| message.ends_with(angular)).expect("they come in their order");
            let ([linear, _], [slower, _]) = (vectors(before), vectors(&line));
            assert!((0.499_999..=0.5).contains(&length(slower)), "{slower:?}");
            for (before, after) in linear.iter().zip(slower) {
                assert!((before / length(linear) - after / length(slower)).abs() < 1e-9, "{linear:?} {slower:?}");
            }
            passed.push(before.clone());
        }
        let mut kept = Vec::new();
        while kept.len() < passed.len() {
            for event in on_ledger.next().await.unwrap().events {
                let transaction = Transaction::decode(event.transaction).unwrap();
                kept.extend(transaction.body().args[3..].iter().map(hex::encode));
            }
        }
        assert_eq!(kept, passed);
        world.line("Rover", &["WARN", "the gate slowed a message down"]).await;
        let [salma, _, rover] = bridges.stop().map(|report| report["routes"][0].clone());
        let count = passed.len() as u64;
        assert_eq!((&rover["clamped"], &rover["published"]), (&count.into(), &count.into()), "{rover}");
        assert_eq!(count + expired(&salma), 50, "{salma}");
    });
}

/// Both publish all the time.
#[test]
fn a_robot_that_is_delegated_recalled_and_handed_over_at_50_hz_hears_no_stop_between_its_drivers() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let owner = owner_of(&world).await;
        call(&owner, "configure", &["Rover/cmd_vel", r#"{"sharing":{"delegable":true}}"#]).await;
        let bridges = world.start_bridges("/cmd_vel", TYPE);
        let mut robot = Robot::listen();
        call(&world.salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        world.line("Salma", &["grant held"]).await;
        let drivers = [drives("1", "1"), drives("2", "5001")];
        robot.hears_only(Heard::Salma, 25);

        call(&world.salma, "delegate", &["Rover/cmd_vel", "Org1/Farhad"]).await;
        robot.hears(Heard::Salma, Heard::Farhad);
        robot.hears_only(Heard::Farhad, 25);
        call(&world.salma, "recall", &["Rover/cmd_vel"]).await;
        robot.hears(Heard::Farhad, Heard::Salma);
        robot.hears_only(Heard::Salma, 25);
        call(&world.salma, "handover", &["Rover/cmd_vel", "Org1/Farhad"]).await;
        robot.hears(Heard::Salma, Heard::Farhad);
        robot.hears_only(Heard::Farhad, 25);

        call(&world.farhad, "release", &["Rover/cmd_vel"]).await;
        robot.hears(Heard::Farhad, Heard::Stop);
        drop(drivers);
        let rover = bridges.stop()[2]["routes"][0].clone();
        assert_eq!(rover["stops"], serde_json::json!({ "released": 1 }), "{rover}");
    });
}
