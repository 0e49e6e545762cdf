//! Services of the robot, called from a user's graph through the ledger; and the robot's grant from there. CycloneDDS is client
//! and server.

use crate::python::Python;
use crate::sharing::owner_of;
use crate::world::{self, Process, World};
use crate::{call, network};
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_abac::Grant;
use ledger_api::{Client, Subscription};
use ledger_base::rejection::Code;
use std::time::{Duration, Instant};

const TYPE: &str = "std_srvs/srv/SetBool";

/// A network whose robot has the service, in this mode, beside the one for its replies.
pub(crate) async fn with_light(mode: &str) -> (World, Client) {
    let world = World::start("/cmd_vel", "geometry_msgs/msg/Twist").await;
    let owner = owner_of(&world).await;
    let service = |topic: &str, direction: &str, mode: &str| serde_json::json!({ "topic": topic, "type": TYPE, "direction": direction, "mode": mode, "max_age_ms": 5000 });
    let services = [service("/light", "command", mode), service("/light/_reply", "feed", "open")];
    let spec = serde_json::json!({ "name": "Rover", "attribute_required": "Rover", "trusted": ["Org1", "Org2"], "services": services });
    call(&owner, "replace", &[&spec.to_string()]).await;
    (world, owner)
}

pub(crate) fn bridge(world: &World, name: &str, domain: u16, direction: &str, more: &str) -> Process {
    let route = format!("[[route]]\nservice = 'Rover/light'\ndirection = '{direction}'\ntype = '{TYPE}'\n{more}\n");
    world.start_bridge_as(name, &format!("domain_id = {domain}\nshared_memory = false\n{route}"), &[])
}

/// The robot's own server.
fn server(more: &[&str]) -> Python {
    let mut server = Python::start("calls.py", &[&["serve", "3", "/light", "SetBool"], more].concat());
    assert_eq!(server.line().unwrap(), "ready");
    server
}

/// A client in a user's domain, which calls once for each value.
fn client(domain: &str, name: &str, kind: &str, wait: &str, values: &[&str]) -> Python {
    let mut client = Python::start("calls.py", &[&["call", domain, name, kind, wait], values].concat());
    assert_eq!(client.line().unwrap(), "matched");
    client
}

/// Calls the light until the robot's bridge has found its server.
fn first_call(domain: &str) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while client(domain, "/light", "SetBool", "2", &["true"]).line().unwrap() == "none" {
        assert!(Instant::now() < deadline, "the server is never called");
    }
}

/// The requests that a server has got, up to and with one that is made now.
fn requests_until_now(server: &mut Python, domain: &str) -> usize {
    assert_eq!(client(domain, "/light", "SetBool", "20", &["false"]).line().unwrap(), "False from /light");
    (1..).find(|_| server.line().unwrap() == "request False").unwrap()
}

#[test]
fn the_holder_alone_calls_a_service_of_the_robot_and_gets_its_replies() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = with_light("exclusive").await;
        let salma = bridge(&world, "Salma", 1, "service_server", "");
        let farhad = bridge(&world, "Farhad", 2, "service_server", "");
        let robot = bridge(&world, "Rover", 3, "service_client", "");
        let mut server = server(&[]);
        call(&world.salma, "acquire", &["Rover/light", "600000"]).await;
        world.line("Salma", &["grant held"]).await;
        first_call("1");
        requests_until_now(&mut server, "1");

        // Two callers at once, each of whom gets the replies to its own requests.
        let values = ["true", "false", "true", "true", "false"];
        let both = [(); 2].map(|()| client("1", "/light", "SetBool", "20", &values));
        for mut client in both {
            for value in values {
                let wanted = if value == "true" { "True from /light" } else { "False from /light" };
                assert_eq!(client.line().unwrap(), wanted, "{}", world.logs());
            }
            assert!(client.finish());
        }
        for _ in 0..2 * values.len() {
            assert!(server.line().unwrap().starts_with("request"));
        }

        // One who does not hold it gets no reply, and the robot hears nothing of it.
        assert_eq!(client("2", "/light", "SetBool", "3", &["true"]).line().unwrap(), "none");
        world.line("Farhad", &["the ledger refuses samples"]).await;
        assert_eq!(requests_until_now(&mut server, "1"), 1, "only that of the holder");

        // So it is for who has lost it.
        call(&world.salma, "release", &["Rover/light"]).await;
        world.line("Salma", &["grant ended"]).await;
        assert_eq!(client("1", "/light", "SetBool", "3", &["true"]).line().unwrap(), "none");
        call(&world.farhad, "acquire", &["Rover/light", "600000"]).await;
        world.line("Farhad", &["grant held"]).await;
        assert_eq!(requests_until_now(&mut server, "2"), 1, "only that of the new holder");

        let [salma, farhad, robot] = [salma, farhad, robot].map(|bridge| bridge.report()["routes"][0].clone());
        assert_eq!((&salma["refused"]["NOT_HOLDER"], &farhad["refused"]["NOT_HOLDER"]), (&1.into(), &1.into()));
        let replied = |report: &serde_json::Value| report["published"].as_u64().unwrap();
        assert_eq!(replied(&robot), replied(&salma) + replied(&farhad), "{robot}\n{salma}\n{farhad}");
    });
}

#[test]
fn a_caller_without_a_reply_is_forgotten_and_a_server_that_came_back_is_called() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = with_light("open").await;
        let salma = bridge(&world, "Salma", 1, "service_server", "reply_timeout_ms = 500");
        let robot = bridge(&world, "Rover", 3, "service_client", "server_timeout_ms = 300");
        let mut silent = server(&["silent"]);
        let deadline = Instant::now() + Duration::from_secs(60);
        let mut patient = Vec::new();
        // Until the robot's bridge has found the server.
        while world.has_not_said("Rover", "the server has not replied in time") {
            assert!(Instant::now() < deadline, "{}", world.logs());
            patient.push(client("1", "/light", "SetBool", "1", &["true"]).line().unwrap());
        }
        assert!(patient.iter().all(|reply| reply == "none"), "{patient:?}");
        assert_eq!(silent.line().unwrap(), "request True");
        world.line("Salma", &["the robot has not replied in time"]).await;
        drop(silent);

        let _server = server(&[]);
        first_call("1");
        let [salma, robot] = [salma, robot].map(|bridge| bridge.report()["routes"][0].clone());
        assert!(salma["gate"]["no_reply"].as_u64().unwrap() > 0, "{salma}");
        assert!(robot["gate"]["no_reply"].as_u64().unwrap() > 0, "{robot}");
    });
}

#[test]
fn a_reply_that_another_than_the_robot_has_signed_reaches_nobody() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, owner) = with_light("open").await;
        let salma = bridge(&world, "Salma", 1, "service_server", "");
        let mut requests = owner.subscribe(Subscription {
            from_height: owner.status().await.unwrap().height + 1,
            chaincode: "abac".into(),
            subjects: vec!["Rover/light".into()],
            names: vec!["message".into()],
            ..Subscription::default()
        });
        let mut caller = client("1", "/light", "SetBool", "6", &["true"]);
        let event = loop {
            let delivery = requests.next().await.unwrap();
            if let Some(event) = delivery.events.first() {
                break event.clone();
            }
        };
        let id = Transaction::decode(event.transaction.clone()).unwrap().id();
        // The CDR of a reply: success, and the text "yes".
        let reply = [&[0, 1, 0, 0][..], &id.0, &[1, 0, 0, 0, 4, 0, 0, 0], b"yes\0"].concat();
        let args = |seq: u64| {
            let head = ["Rover/light/_reply".to_owned(), "0".to_owned(), seq.to_string()];
            head.into_iter().map(Bytes::from).chain([Bytes::from(reply.clone())]).collect::<Vec<_>>()
        };
        // An admin of the owner may publish there, but is not the robot. Another member may not even do that.
        owner.invoke("abac", "set", args(1)).await.unwrap();
        let refused = world.farhad.invoke("abac", "set", args(1)).await.unwrap_err();
        assert_eq!(refused.code, Code::DeniedByPolicy);
        world.line("Salma", &["not_the_robot"]).await;
        assert_eq!(caller.line().unwrap(), "none", "{}", world.logs());
        let report = salma.report()["routes"][0].clone();
        assert_eq!((&report["gate"]["not_the_robot"], &report["published"]), (&1.into(), &0.into()), "{report}");
    });
}

/// The answer of a user's bridge to a request about the robot's grant.
fn asked(domain: &str, act: &str) -> String {
    client(domain, &format!("/Rover/{act}"), "Trigger", "20", &["0"]).line().unwrap()
}

async fn grant(client: &Client) -> Option<Grant> {
    let grants = client.query("abac", "grants", vec!["Rover/cmd_vel".into()]).await.unwrap();
    let grants: Vec<Grant> = serde_json::from_slice(&grants.response).unwrap();
    grants.into_iter().next()
}

/// The lease of a robot whose grant is had from ROS: no machine stalls for so long.
const LEASE_MS: u64 = 20_000;

/// Waits until the grant is this one's, and was renewed.
async fn kept(client: &Client, holder: &str) {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        let is_renewed =
            |grant: Grant| grant.holder == holder && grant.expires > grant.acquired_at + LEASE_MS * 1000 + 1_000_000;
        if grant(client).await.is_some_and(is_renewed) {
            return;
        }
        assert!(Instant::now() < deadline, "the grant of {holder} is not renewed");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

#[test]
fn the_grant_is_had_from_ros_and_every_answer_tells_the_truth() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", "geometry_msgs/msg/Twist").await;
        let owner = owner_of(&world).await;
        call(&owner, "configure", &["Rover/cmd_vel", &format!("{{\"lease_ms\":{LEASE_MS}}}")]).await;
        let settings = |domain: u16| {
            let route = world::route("to_ledger", "/cmd_vel", "geometry_msgs/msg/Twist");
            format!("domain_id = {domain}\nshared_memory = false\ngrant_services = true\n{route}")
        };
        let _salma = world.start_bridge_as("Salma", &settings(1), &[]);
        let _farhad = world.start_bridge_as("Farhad", &settings(2), &[]);

        // What nobody holds is had, and kept beyond its lease without any command.
        let nothing = asked("1", "release");
        assert!(nothing.starts_with("False Org1/Salma holds no grant of Rover/cmd_vel"), "{nothing}");
        let granted = asked("1", "acquire");
        assert!(granted.starts_with("True Rover/cmd_vel is yours, epoch 1; until /Rover/release"), "{granted}");
        kept(&owner, "Org1/Salma").await;

        // Another one hears who holds it, and since when.
        let held = asked("2", "acquire");
        assert!(held.starts_with("False Rover/cmd_vel is held by Org1/Salma until"), "{held}");
        for part in ["found   Org1/Salma has held Rover/cmd_vel for", "try     acquire it after that time"] {
            assert!(held.contains(part), "{part:?} in {held}");
        }

        // In line, until the turn comes; then that grant is kept.
        call(&owner, "configure", &["Rover/cmd_vel", r#"{"sharing":{"on_conflict":"queue"}}"#]).await;
        let queued = asked("2", "acquire");
        assert!(queued.starts_with("False Rover/cmd_vel is not yours yet: queued at position 1"), "{queued}");
        assert!(queued.contains("Org1/Salma has held Rover/cmd_vel for"), "{queued}");
        let released = asked("1", "release");
        assert_eq!(released, "True Rover/cmd_vel is released");
        kept(&owner, "Org1/Farhad").await;

        // A stop is for those who may.
        let refused = asked("1", "stop");
        assert!(refused.starts_with("False "), "{refused}");
        assert!(grant(&owner).await.is_some(), "a refused stop ends nothing");
        // The holder may.
        let stopped = asked("2", "stop");
        assert!(stopped.starts_with("True Rover is stopped, 1 grants have ended"), "{stopped}");
        assert_eq!(grant(&owner).await, None);
        let refused = asked("1", "acquire");
        assert!(refused.starts_with("False ") && refused.contains("stopped"), "{refused}");
    });
}
