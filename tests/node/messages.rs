//! Messages as people write and read them: YAML and JSON by the type of the service, as `ros2 topic` has them.

use crate::support::{Dev, Process, eventually};
use serde_json::{Value, json};

/// The content of one line of `echo -o json`.
fn lines(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn a_twist_is_published_as_yaml_and_echoed_as_ros2_topic_echo_does() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    salma.run(&["acquire", "Turtlebot4", "--for", "60s"]).ok();
    let publish = |message: &str| salma.publish(&["Turtlebot4", message, "-o", "json"]);
    let sent = publish("{linear: {x: 0.5}, angular: {z: 0.1}}").ok().json();
    assert_eq!((&sent["service"], &sent["bytes"]), (&"Turtlebot4/cmd_vel".into(), &52.into()));
    publish(r#"{"linear": {"x": -1}}"#).ok();

    let from = sent["height"].to_string();
    let echo = salma.run(&["echo", "Turtlebot4/cmd_vel", "--from", &from, "--count", "1"]).ok().stdout;
    let (heading, message) = echo.split_once('\n').unwrap();
    assert!(heading.starts_with(&format!("# block {from}, ")) && heading.contains("Org1/Salma, epoch 1"), "{echo}");
    let wanted = "linear:\n  x: 0.5\n  y: 0.0\n  z: 0.0\nangular:\n  x: 0.0\n  y: 0.0\n  z: 0.1\n---\n";
    assert_eq!(message, wanted);
    // What echo prints can be published again as it stands.
    publish(&echo).ok();

    let echo = ["echo", "Turtlebot4/cmd_vel", "--from", &from, "--count", "3", "-o", "json"];
    let heard = lines(&salma.run(&echo).ok().stdout);
    let vector = |x: f64, z: f64| json!({"x": x, "y": 0.0, "z": z});
    assert_eq!(heard[0]["message"], json!({"linear": vector(0.5, 0.0), "angular": vector(0.0, 0.1)}));
    assert_eq!(heard[0]["type"], "geometry_msgs/msg/Twist");
    assert_eq!(heard[1]["message"]["linear"], vector(-1.0, 0.0));
    assert_eq!((&heard[2]["message"], &heard[2]["payload"]), (&heard[0]["message"], &heard[0]["payload"]));
    let hex = salma.run(&["echo", "Turtlebot4/cmd_vel", "--from", &from, "--count", "1", "--hex"]).ok().stdout;
    assert!(hex.lines().count() == 1 && hex.contains(heard[0]["payload"].as_str().unwrap()), "{hex}");
}

#[test]
fn what_the_type_does_not_admit_is_refused_before_it_costs_anything() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    salma.run(&["acquire", "Turtlebot4", "--for", "60s"]).ok();
    let height = || salma.json(&["status"])["height"].as_u64().unwrap();
    let before = height();
    let publish = |words: &[&str]| salma.run(&[&["publish", "Turtlebot4"], words].concat());
    for (message, words) in [
        ("{linaer: {x: 0.5}}", ["LGR-6003", "did you mean \"linear\"?"]),
        ("{linear: {w: 0.5}}", ["linear: geometry_msgs/msg/Vector3 has no field w", "x, y, z"]),
        ("{linear: {x: 0,5}}", ["has no field 5", "write decimals with a point: 0.5"]),
        ("{linear: {x: fast}}", ["linear.x: this is no float64", "\"fast\""]),
        ("{linear: 1}", ["geometry_msgs/msg/Vector3", "{x: …, y: …, z: …}"]),
        ("{linear: {x: 0.5}", ["not understood as YAML", "quotes"]),
        ("", ["the message is empty", "{} is a message with default values"]),
        ("0.5", ["this is no geometry_msgs/msg/Twist", "{linear: {x: 0.0"]),
    ] {
        publish(&[message]).refused(3, &words);
    }
    // Bytes of another length, and bytes without the header.
    publish(&["--hex", &format!("00010000{}", "00".repeat(24))]).refused(3, &["LGR-6003", "geometry_msgs/msg/Twist"]);
    publish(&["--hex", &format!("00010000{}", "00".repeat(49))])
        .refused(3, &["longer than its type", "wanted  48 bytes"]);
    publish(&["--hex", &"9a".repeat(48)]).refused(3, &["LGR-6003", "00 01 00 00"]);
    // The node says things of its own, in a block or two.
    assert!(height() < before + 10, "none of the ten messages was ordered");
}

#[test]
fn a_type_of_ones_own_is_hex_until_its_definition_is_given() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Husky"], "ed25519");
    let service = "/grip=arm_msgs/msg/Grip,mode=open";
    dev.owner().run(&["robot", "add", "Arm", "--attr-required", "Husky", "--trust", "Org1", "--service", service]).ok();
    salma.run(&["publish", "Arm", "{force: 1}"]).refused(3, &["LGR-6003", "--msg arm_msgs/msg/Grip=FILE.msg"]);
    let directory = dev.home.path().join("arm_msgs/msg");
    std::fs::create_dir_all(&directory).unwrap();
    let file = directory.join("Grip.msg");
    std::fs::write(&file, "# how hard\nfloat32 force 2.5\nstring<=8 tool\nuint8[] raw\n").unwrap();
    let (path, file) = (file.display().to_string(), format!("arm_msgs/msg/Grip={}", file.display()));
    let sent = salma.publish(&["Arm", "{tool: hook, raw: [1, 0xff]}", "--msg", &path, "-o", "json"]).ok().json();
    salma.run(&["publish", "Arm", "{tool: far too long}", "--msg", &path]).refused(3, &["tool", "at most 8"]);
    let from = sent["height"].to_string();
    let echo = ["echo", "Arm", "--from", &from, "--count", "1"];
    let bytes = salma.run(&echo).ok();
    assert!(
        bytes
            .stdout
            .trim_end()
            .ends_with("000100000000204005000000686f6f6b00000000020000000 1ff".replace(' ', "").as_str()),
        "{bytes:?}"
    );
    assert!(bytes.stderr.contains("--msg arm_msgs/msg/Grip=FILE.msg"), "{bytes:?}");
    let echoed = salma.run(&[&echo[..], &["--msg", &file]].concat()).ok();
    assert!(echoed.stdout.ends_with("\nforce: 2.5\ntool: hook\nraw:\n- 1\n- 255\n---\n"), "{echoed:?}");
    let again = salma.run(&[&echo[..], &["--msg", &path, "--msg", "/nowhere/a_msgs/msg/B.msg"]].concat());
    again.refused(3, &["LGR-7002", "/nowhere/a_msgs/msg/B.msg"]);
}

#[test]
fn hz_and_bw_count_what_arrives_and_need_the_right_to_read() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let mallory = dev.user("Mallory", &[], "ed25519");
    salma.run(&["acquire", "Turtlebot4", "--for", "60s"]).ok();
    for name in ["hz", "bw"] {
        mallory.run(&[name, "Turtlebot4/cmd_vel"]).refused(2, &["LGR-3001"]);
        salma.run(&[name, "Turtlebot4/nope"]).refused(3, &["LGR-3004"]);
        let silent = salma.run(&[name, "Turtlebot4", "--every", "50ms", "--count", "2"]).ok().stdout;
        assert_eq!(silent, "no messages\nno messages\n");
    }
    let measure = |name| {
        let words = [name, "Turtlebot4/cmd_vel", "--every", "100ms", "-o", "json"];
        Process::start(name, dev.home.path(), salma.command(&words))
    };
    let (mut hz, mut bw) = (measure("hz"), measure("bw"));
    let last = |measured: &Process| {
        let text = measured.stdout();
        let (complete, _) = text.rsplit_once('\n')?;
        lines(complete).pop()
    };
    let (rate, bandwidth) = eventually("both have counted three messages", || {
        hz.check();
        bw.check();
        salma.publish(&["Turtlebot4", "{linear: {x: 0.5}}"]).ok();
        let (rate, bandwidth) = (last(&hz)?, last(&bw)?);
        let has_three = |line: &Value| line["messages"].as_u64() > Some(2);
        (has_three(&rate) && has_three(&bandwidth)).then_some((rate, bandwidth))
    });
    assert!(rate["rate_hz"].as_f64() > Some(0.0) && rate["service"] == "Turtlebot4/cmd_vel", "{rate}");
    assert!(rate["interval_min_us"].as_u64() <= rate["interval_max_us"].as_u64(), "{rate}");
    // A Twist is 52 bytes.
    let sizes = ["size_min_bytes", "size_mean_bytes", "size_max_bytes"].map(|name| bandwidth[name].as_u64());
    assert_eq!(sizes, [Some(52); 3], "{bandwidth}");
    assert!(bandwidth["bytes_per_s"].as_f64() > Some(0.0), "{bandwidth}");
    hz.interrupt();
    bw.interrupt();
}
