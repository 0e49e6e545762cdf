//! Recordings: made of what really went over a ledger, read by software that we did not write, and replayed to CycloneDDS.

use crate::python::Python;
use crate::support::small_disk::{SmallDisk, fill};
use crate::support::{Ctl, Dev, Process, eventually};
use crate::world::{self, World};
use crate::{call, network};
use rustix::process::Signal;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const TWIST: &str = "geometry_msgs/msg/Twist";

/// A recording as Python reads it.
fn read(file: &Path, words: &[&str]) -> Value {
    let file = file.display().to_string();
    let mut python = Python::start("read_recording.py", &[&[file.as_str()], words].concat());
    let line = python.line().expect("the recording is read");
    assert!(python.finish());
    serde_json::from_str(&line).unwrap()
}

/// Publishes a twist that drives so fast, and gives the ledger's answer.
fn drive(user: &Ctl, speed: f64) -> Value {
    user.publish(&["Turtlebot4", &format!("{{linear: {{x: {speed}}}}}"), "-o", "json"]).ok().json()
}

/// The bytes of that twist, in hexadecimal digits.
fn twist(speed: f64) -> String {
    format!("00010000{}{}", hex::encode(speed.to_le_bytes()), "00".repeat(40))
}

/// The messages of a topic.
fn on<'a>(found: &'a Value, topic: &str) -> Vec<&'a Value> {
    found["messages"].as_array().unwrap().iter().filter(|message| message["topic"] == topic).collect()
}

/// The metadata of a name.
fn about<'a>(found: &'a Value, name: &str) -> Vec<&'a Value> {
    found["metadata"].as_array().unwrap().iter().filter(|facts| facts["name"] == name).collect()
}

#[test]
fn a_recording_tells_others_every_message_with_its_sender_and_its_place_on_the_ledger() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let service = "/grip=arm_msgs/msg/Grip,mode=open";
    dev.owner()
        .run(&["robot", "add", "arm-7", "--attr-required", "Turtlebot4", "--trust", "Org1", "--service", service])
        .ok();
    let granted = salma.json(&["acquire", "Turtlebot4", "--for", "60s"]);
    let sent: Vec<_> = [0.5, -0.25, 0.0].map(|speed| drive(&salma, speed)).into();
    salma.publish(&["arm-7", "--hex", "0001000007"]).ok();
    salma.run(&["release", "Turtlebot4"]).ok();
    let file = dev.home.path().join("run.mcap");
    let recorded =
        salma.json(&["record", "Turtlebot4/cmd_vel", "arm-7", "--since", "0", "--to", &file.display().to_string()]);
    assert_eq!((&recorded["messages"], &recorded["ended"]), (&json!(4), &json!("reached")), "{recorded}");

    let found = read(&file, &[]);
    assert_eq!(found["profile"], "ros2");
    assert!(found["channels"].as_object().unwrap().values().all(|channel| channel["encoding"] == "cdr"), "{found}");
    let channel = &found["channels"]["/Turtlebot4/cmd_vel"];
    assert_eq!((&channel["type"], &channel["schema_encoding"]), (&json!(TWIST), &json!("ros2msg")));
    assert_eq!(channel["about"]["service"], "Turtlebot4/cmd_vel");
    assert!(channel["about"]["topic_type_hash"].as_str().unwrap().starts_with("RIHS01_"), "rosbags has compared it");
    let unknown = &found["channels"]["/arm_7/grip"];
    assert_eq!((&unknown["type"], &unknown["schema_encoding"]), (&json!("arm_msgs/msg/Grip"), &json!("")));
    assert_eq!(on(&found, "/arm_7/grip")[0]["data"], "0001000007");

    // Byte for byte, at the time of their blocks.
    let messages = on(&found, "/Turtlebot4/cmd_vel");
    let records = found["decoded"]["/ledger/records"].as_array().unwrap();
    let records: Vec<_> =
        records.iter().map(|row| &row["message"]).filter(|row| row["topic"] == "/Turtlebot4/cmd_vel").collect();
    assert_eq!((messages.len(), records.len()), (3, 3));
    for (((message, record), sent), speed) in messages.iter().zip(&records).zip(&sent).zip([0.5, -0.25, 0.0]) {
        assert_eq!(message["data"], json!(twist(speed)));
        let time = sent["time"].as_u64().unwrap();
        assert_eq!(message["log_time"], json!(time * 1000));
        let signed = message["publish_time"].as_u64().unwrap();
        assert!(signed <= time * 1000 && time * 1000 - signed < 60_000_000_000, "{message}");
        let told = ["service", "epoch", "height", "transaction"].map(|name| &record[name]);
        assert_eq!(told, ["service", "epoch", "height", "transaction"].map(|name| &sent[name]), "{record}");
        assert_eq!((&record["identity"], &record["sequence"]), (&json!("Org1/Salma"), &sent["seq"]));
        assert_eq!((&record["verdict"], &record["number"]), (&json!("OK"), &message["sequence"]));
        assert_eq!(record["stamp"]["sec"], json!(time / 1_000_000));
    }
    assert_eq!(found["decoded"]["/Turtlebot4/cmd_vel"][1]["message"]["linear"]["x"], -0.25);

    // Foxglove's own decoder reads the same by the definitions in the file.
    for topic in ["/Turtlebot4/cmd_vel", "/ledger/records", "/ledger/events"] {
        let [rosbags, foxglove] = ["decoded", "foxglove"].map(|reader| found[reader][topic].as_array().unwrap());
        let rosbags: Vec<_> = rosbags.iter().map(|row| &row["message"]).collect();
        assert!(!rosbags.is_empty() && foxglove.iter().eq(rosbags), "{topic}: {foxglove:?}");
    }

    // Who held the robot.
    let events = found["decoded"]["/ledger/events"].as_array().unwrap();
    let of_robot = events.iter().map(|row| &row["message"]).filter(|row| row["subject"] == "Turtlebot4/cmd_vel");
    let story: Vec<_> =
        of_robot.map(|row| (row["name"].as_str().unwrap(), row["identity"].as_str().unwrap())).collect();
    assert_eq!(story.first(), Some(&("granted", "Org1/Salma")), "{events:?}");
    assert_eq!(story.last(), Some(&("released", "Org1/Salma")), "{events:?}");
    let payload: Value = serde_json::from_str(
        events.iter().find(|row| row["message"]["name"] == "granted").unwrap()["message"]["payload"].as_str().unwrap(),
    )
    .unwrap();
    assert_eq!(payload["epoch"], granted["epoch"]);

    // Where all that comes from.
    let status = salma.json(&["status"]);
    assert_eq!(about(&found, "ledger")[0]["network"], status["network"]);
    assert_eq!(about(&found, "ledger")[0]["recorder"], "Org1/Salma");
    assert_eq!(about(&found, "ledger.service").len(), 2);
    let certificates = about(&found, "ledger.certificate");
    assert!(certificates.iter().any(|facts| facts["identity"] == "Org1/Salma"), "{certificates:?}");
    for facts in certificates {
        let certificate = hex::decode(facts["certificate"].as_str().unwrap()).unwrap();
        assert_eq!(
            ledger_base::hash::Hash::of(&[certificate.as_slice()]).to_string(),
            facts["fingerprint"].as_str().unwrap()
        );
    }
    assert_eq!(about(&found, "ledger.range")[0]["messages"], "4");
}

#[test]
fn a_recording_has_exactly_the_blocks_between_two_moments() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    salma.run(&["acquire", "Turtlebot4", "--for", "60s"]).ok();
    let sent: Vec<_> = (0..6).map(|speed| drive(&salma, f64::from(speed))).collect();
    let heights: Vec<_> = sent.iter().map(|sent| sent["height"].to_string()).collect();
    let moment = |index: usize| {
        let micros = i64::try_from(sent[index]["time"].as_u64().unwrap()).unwrap();
        let (seconds, rest) = (micros.div_euclid(1_000_000), micros.rem_euclid(1_000_000));
        let date = std::process::Command::new("date")
            .args(["-u", "-d", &format!("@{seconds}"), "+%Y-%m-%dT%H:%M:%S"])
            .output();
        format!("{}.{rest:06}Z", String::from_utf8(date.unwrap().stdout).unwrap().trim())
    };
    let record = |name: &str, words: &[&str]| {
        let file = dev.home.path().join(name);
        let to = file.display().to_string();
        let told = salma.json(&[&["record", "Turtlebot4", "--to", &to], words].concat());
        let found = read(&file, &[]);
        assert_eq!(json!(on(&found, "/Turtlebot4/cmd_vel").len()), told["messages"]);
        on(&found, "/Turtlebot4/cmd_vel")
            .iter()
            .map(|message| message["data"].as_str().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    let wanted =
        |speeds: std::ops::RangeInclusive<u32>| speeds.map(|speed| twist(f64::from(speed))).collect::<Vec<_>>();
    assert_eq!(record("heights.mcap", &["--since", &heights[1], "--until", &heights[3]]), wanted(1..=3));
    assert_eq!(record("times.mcap", &["--since", &moment(2), "--until", &moment(4)]), wanted(2..=4));
    assert_eq!(record("rest.mcap", &["--since", &moment(3)]), wanted(3..=5));
    assert_eq!(record("span.mcap", &["--since", "10m", "--until", &heights[0]]), wanted(0..=0));
    // The node has nothing behind its last block.
    let refused = |words: &[&str]| {
        let to = dev.home.path().join("no.mcap").display().to_string();
        let said = salma.run(&[&["record", "Turtlebot4", "--to", &to], words].concat());
        assert!(!Path::new(&to).exists(), "a refusal leaves no file: {said:?}");
        said
    };
    refused(&["--since", &moment(4), "--until", &moment(2)]).refused(3, &["LGR-1011", "would end before it begins"]);
    refused(&["--until", "10m"]).refused(3, &["LGR-1011", "give --since"]);
    refused(&["--since", "2999-01-01T00:00:00Z"]).refused(3, &["LGR-1011", "is in the future"]);
    refused(&["--since", "100000"]).refused(3, &["LGR-1011", "does not exist yet", "--follow"]);
}

/// A recorder that runs, of a robot that Salma drives.
struct Recorder {
    process: Process,
    file: PathBuf,
}

impl Recorder {
    fn start(salma: &Ctl, directory: &Path, words: &[&str]) -> Self {
        let file = directory.join("live.mcap");
        let to = file.display().to_string();
        let command = salma.command(&[&["record", "Turtlebot4", "--to", &to, "--output", "json"], words].concat());
        let process = Process::start("recorder", directory, command);
        let mut recorder = Self { process, file };
        eventually("the recording has begun", || {
            recorder.process.check();
            recorder.file.exists().then_some(())
        });
        recorder
    }

    /// Waits until these messages are in the file, which is being written.
    fn has(&mut self, speeds: &[f64]) {
        eventually("what was published is in the file", || {
            self.process.check();
            let bytes = std::fs::read(&self.file).unwrap();
            speeds
                .iter()
                .all(|speed| {
                    let wanted = hex::decode(twist(*speed)).unwrap();
                    bytes.windows(wanted.len()).any(|window| window == wanted)
                })
                .then_some(())
        });
    }

    /// Ends it, and answers with what it said.
    fn end(mut self, signal: Signal) -> (Option<i32>, Value) {
        let code = self.process.signal(signal).code();
        (code, serde_json::from_str(self.process.stdout().trim()).unwrap_or_default())
    }
}

#[test]
fn a_live_recording_begins_with_who_holds_the_robot_and_ends_with_an_index() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    salma.run(&["acquire", "Turtlebot4", "--for", "60s"]).ok();
    drive(&salma, 1.0);
    let mut recorder = Recorder::start(&salma, dev.home.path(), &[]);
    let file = recorder.file.clone();
    drive(&salma, 2.0);
    drive(&salma, 3.0);
    recorder.has(&[2.0, 3.0]);
    let (code, told) = recorder.end(Signal::INT);
    assert_eq!((code, &told["ended"], &told["messages"]), (Some(0), &json!("interrupted"), &json!(2)), "{told}");
    let found = read(&file, &[]);
    let data: Vec<_> = on(&found, "/Turtlebot4/cmd_vel").iter().map(|message| message["data"].clone()).collect();
    assert_eq!(data, [twist(2.0), twist(3.0)], "what was sent before is no part of it");
    let first = &found["decoded"]["/ledger/events"][0]["message"];
    assert_eq!((&first["name"], &first["identity"]), (&json!("held"), &json!("Org1/Salma")), "{first}");

    // From the past into the present, and the end of a service unit.
    std::fs::remove_file(&file).unwrap();
    let mut recorder = Recorder::start(&salma, dev.home.path(), &["--since", "0", "--follow"]);
    recorder.has(&[1.0, 2.0, 3.0]);
    drive(&salma, 4.0);
    recorder.has(&[4.0]);
    let (code, told) = recorder.end(Signal::TERM);
    assert_eq!((code, &told["messages"]), (Some(0), &json!(4)), "{told}");
}

#[test]
fn a_killed_recorder_leaves_what_it_had_flushed_and_no_name_is_taken_twice() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    salma.run(&["acquire", "Turtlebot4", "--for", "60s"]).ok();
    let mut recorder = Recorder::start(&salma, dev.home.path(), &[]);
    let file = recorder.file.clone();
    for speed in 1..=5 {
        drive(&salma, f64::from(speed));
    }
    recorder.has(&[1.0, 2.0, 3.0, 4.0, 5.0]);
    recorder.process.kill();
    let found = read(&file, &["cut"]);
    assert_ne!(found["ended"], "whole");
    let data: Vec<_> = on(&found, "/Turtlebot4/cmd_vel").iter().map(|message| message["data"].clone()).collect();
    assert_eq!(data, [1, 2, 3, 4, 5].map(|speed| twist(f64::from(speed))));
    assert_eq!(on(&found, "/ledger/records").len(), 5);

    let to = file.display().to_string();
    let again = ["record", "Turtlebot4", "--since", "0", "-o", &to];
    let before = std::fs::read(&file).unwrap();
    salma.run(&again).refused(3, &["LGR-3011", "exists already", "--force"]);
    assert_eq!(std::fs::read(&file).unwrap(), before);
    let told = salma.run(&[&again[..], &["--force"]].concat()).ok().stdout;
    assert!(told.starts_with("recorded 5 messages and "), "{told}");
}

#[test]
fn a_recording_that_may_not_be_or_finds_nothing_leaves_no_file() {
    let dev = Dev::start();
    let mallory = dev.user("Mallory", &[], "ed25519");
    let file = dev.home.path().join("no.mcap");
    let to = file.display().to_string();
    mallory.run(&["record", "Turtlebot4", "-o", &to]).refused(2, &["Turtlebot4"]);
    mallory.run(&["record", "Turtlebo4", "-o", &to]).refused(3, &["LGR-3003", "did you mean"]);
    mallory.run(&["record", "Turtlebot4/pose", "-o", &to]).refused(3, &["LGR-3004"]);
    mallory.run(&["record", "Turtlebot4"]).refused(3, &["LGR-1011", "-o FILE.mcap"]);
    mallory.run(&["record", "Turtlebot4", "-o", "run.bag"]).refused(64, &["FILE.mcap"]);
    mallory.run(&["status", "-o", &to]).refused(64, &["possible values: table, json"]);
    assert!(!file.exists());
    let nowhere = mallory.run(&["record", "Husky", "Turtlebot4", "-o", "/nowhere/x.mcap"]);
    assert_ne!(nowhere.code, 0, "{nowhere:?}");
}

#[test]
fn a_full_disk_ends_a_recording_behind_its_last_whole_chunk() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    salma.run(&["acquire", "Turtlebot4", "--for", "60s"]).ok();
    let directory = dev.home.path().join("small");
    std::fs::create_dir(&directory).unwrap();
    let disk = SmallDisk::over(&directory, dev.home.path());
    let file = directory.join("live.mcap");
    let command = salma.command(&["record", "Turtlebot4", "-o", &file.display().to_string()]);
    let mut recorder = Process::start("recorder", dev.home.path(), disk.enter(&command));
    drive(&salma, 1.0);
    let seen = disk.seen(&file);
    let has = |speed: f64| {
        let wanted = hex::decode(twist(speed)).unwrap();
        std::fs::read(&seen).is_ok_and(|bytes| bytes.windows(wanted.len()).any(|window| window == wanted))
    };
    let mut speed = 1.0;
    eventually("a message is in the file", || {
        // One that came before the recorder was there is not.
        speed += 1.0;
        drive(&salma, speed);
        (2..=speed as u32).any(|speed| has(f64::from(speed))).then_some(())
    });
    fill(&disk.seen(&directory.join("ballast")));
    eventually("the recorder meets the full disk", || {
        speed += 1.0;
        drive(&salma, speed);
        (!recorder.is_running()).then_some(())
    });
    let said = recorder.stderr();
    assert!(said.contains("LGR-7002") && said.contains("No space left") && said.contains("mcap recover"), "{said}");
    assert!(!said.contains("panicked"), "{said}");
    // What is there ends with a whole chunk.
    let kept = dev.home.path().join("kept.mcap");
    std::fs::copy(&seen, &kept).unwrap();
    let found = read(&kept, &["cut"]);
    assert!(!on(&found, "/Turtlebot4/cmd_vel").is_empty(), "{found}");
    assert_eq!(on(&found, "/Turtlebot4/cmd_vel").len(), on(&found, "/ledger/records").len());
}

#[test]
fn a_replay_gives_others_the_recorded_bytes_in_the_recorded_order() {
    if !network::isolated(&|| ()) {
        return;
    }
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    salma.run(&["acquire", "Turtlebot4", "--for", "60s"]).ok();
    for speed in 1..=8 {
        drive(&salma, f64::from(speed));
    }
    let file = dev.home.path().join("run.mcap").display().to_string();
    salma.run(&["record", "Turtlebot4", "--since", "0", "-o", &file]).ok();
    let mut robot = Python::start("twist_subscriber.py", &["5", "rt/sim/cmd_vel", "8", "0", "0", "60"]);
    assert_eq!(robot.line().unwrap(), "ready");
    let remap = "/Turtlebot4/cmd_vel:=/sim/cmd_vel";
    let told = dev.ctl().run(&["replay", &file, "--domain", "5", "--rate", "4", "--topic", remap]).ok();
    assert!(
        told.stderr.contains("ROS domain 5 (local processes only): /sim/cmd_vel [geometry_msgs/msg/Twist]"),
        "{told:?}"
    );
    assert_eq!(robot.line().unwrap(), "matched");
    for speed in 1..=8 {
        assert_eq!(robot.line().unwrap(), twist(f64::from(speed)));
    }
    assert!(robot.finish());
    // A file without an end is replayed as far as it goes; another one not at all.
    let bytes = std::fs::read(&file).unwrap();
    let short = dev.home.path().join("short.mcap");
    std::fs::write(&short, &bytes[..bytes.len() - 20]).unwrap();
    let told = dev.ctl().json(&["replay", &short.display().to_string(), "--domain", "5", "--rate", "1000"]);
    assert_eq!((&told["topics"][0]["published"], &told["topics"][0]["recorded"]), (&json!(8), &json!(8)), "{told}");
    let none = dev.home.path().join("none.mcap");
    std::fs::write(&none, "no recording").unwrap();
    let none = none.display().to_string();
    dev.ctl().run(&["replay", &none, "--domain", "5"]).refused(3, &["LGR-7002", "an MCAP file"]);
    dev.ctl().run(&["replay", &file]).refused(64, &["--domain"]);
    let wrong = ["replay", &file, "--domain", "5", "--topic", "/Turtlebot4/cmdvel:=/a"];
    dev.ctl().run(&wrong).refused(3, &["LGR-1011", "did you mean \"/Turtlebot4/cmd_vel\"?"]);
}

#[test]
fn a_replay_ends_where_a_bridge_has_the_topic_and_no_bridge_takes_it_to_the_ledger() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TWIST).await;
        call(&world.salma, "acquire", &["Rover/cmd_vel", "60000"]).await;
        let salma = Ctl::at(&world.path("home")).as_("Salma");
        for speed in 1..=4 {
            salma.publish(&["Rover", &format!("{{linear: {{x: {speed}.0}}}}")]).ok();
        }
        let file = world.path("run.mcap").display().to_string();
        salma.run(&["record", "Rover", "--since", "0", "--plain-topics", "-o", &file]).ok();
        let bridges = world.start_bridges("/cmd_vel", TWIST);
        world.line("Salma", &["ready"]).await;
        world.line("Rover", &["ready"]).await;
        // Before a user's bridge, and beside the robot's.
        for (domain, words) in [("1", "subscribes there"), ("3", "publishes there")] {
            // So slowly that nothing else ends it.
            let said = salma.run(&["replay", &file, "--domain", domain, "--rate", "0.001"]);
            said.refused(3, &["LGR-1011", "/cmd_vel", "belongs to a bridge", words, "--topic FROM:=TO"]);
        }
        // A topic of another name is nobody's business.
        let other = ["replay", &file, "--domain", "1", "--rate", "1000", "--topic", "/cmd_vel:=/other"];
        assert_eq!(salma.json(&other)["topics"][0]["published"], 4);

        // A bridge that comes while a replay runs ends it, and takes nothing of it in.
        drop(bridges.stop());
        // Her bridge may have left it to her.
        let _held = world.salma.invoke("abac", "acquire", vec!["Rover/cmd_vel".into(), "60000".into()]).await;
        let command = salma.command(&["replay", &file, "--domain", "1", "--rate", "0.001"]);
        let mut replay = Process::start("replay", &world.path("."), command);
        eventually("the replay says where it publishes", || replay.stderr().contains("ROS domain 1").then_some(()));
        let _bridge = world.start_bridge("Salma", 1, "to_ledger", "/cmd_vel", TWIST);
        let ended = replay.wait();
        assert_eq!(ended.code(), Some(3), "{}", replay.stderr());
        assert!(replay.stderr().contains("belongs to a bridge"), "{}", replay.stderr());
        let after = world.path("after.mcap").display().to_string();
        let told = salma.json(&["record", "Rover", "--since", "0", "--to", &after]);
        assert_eq!(told["messages"], 4, "nothing of the replay came to the ledger: {told}");
    });
}
