//! Attributes that somebody names wrongly, secrets for names that exist, and files as editors write them, with `ledgerctl` and a real node.

use crate::support::Dev;
use std::fs;

#[test]
fn two_attributes_in_one_and_a_value_in_a_name_are_rejected_with_what_was_meant() {
    let dev = Dev::start();
    let (admin, owner) = (dev.admin(), dev.owner());
    for (attribute, meant) in [
        ("Turtlebot4,Husky", "--attr Turtlebot4 --attr Husky"),
        ("Turtlebot4=true,Husky=true", "--attr Turtlebot4=true --attr Husky=true"),
        ("level 3", "did you mean level=3?"),
        ("level:3", "did you mean level=3?"),
    ] {
        let refused = admin.run(&["identity", "register", "Zoe", "--attr", attribute]);
        assert!(refused.code == 64 && refused.stderr.contains(meant), "{refused:?}");
        let shared = owner.run(&["share", "Husky", "--with", "Org1", "--attr", attribute, "--yes"]);
        assert!(shared.code == 64 && shared.stderr.contains(meant), "{shared:?}");
    }
    // Other programs call the ledger themselves.
    let secret = "00".repeat(32);
    let call = format!(
        r#"{{"name":"Zoe","role":"member","attributes":{{"level 3":"true"}},"secret":"{secret}","expires":{}}}"#,
        crate::support::network::now() + 60_000_000
    );
    let register = ["invoke", "msp", "register", &call];
    admin.run(&register).refused(3, &["LGR-1011", "this is not an attribute", "did you mean level=3?"]);
    // A registrar may give attributes by their names.
    dev.user("Farhad", &[], "ed25519");
    let registrar = ["identity", "registrar", "Farhad", "--affiliation", "sales", "--attr", "Turtlebot4,Husky"];
    admin.run(&registrar).refused(3, &["LGR-1011", "--attr Turtlebot4 --attr Husky"]);
    // A robot requires one attribute, and has several of its own.
    let robot = |settings: &[&str]| {
        let line = ["robot", "add", "Rover", "--trust", "Org1", "--service", "/cmd_vel=geometry_msgs/msg/Twist"];
        owner.run(&[&line[..], settings].concat())
    };
    robot(&["--attr-required", "Rover,Husky"]).refused(3, &["LGR-1011", "Rover and Husky", "one attribute"]);
    let own = robot(&["--attr-required", "Rover", "--attribute", "kind=rover,payload_kg=75"]);
    assert!(own.code == 64 && own.stderr.contains("payload_kg=75 looks like another attribute"), "{own:?}");
}

#[test]
fn the_line_of_a_new_secret_replaces_the_context_that_exists() {
    let dev = Dev::start();
    dev.user("Salma", &["Husky"], "ed25519");
    let reissued = dev.admin().json(&["identity", "register", "Salma", "--reissue", "--attr", "Turtlebot4"]);
    let line = reissued["command"].as_str().unwrap();
    assert!(line.ends_with(" --force"), "{line}");
    let words: Vec<&str> = line.split(' ').skip(1).collect();
    dev.ctl().run(&words).ok();
    let who = dev.ctl().as_("Salma").json(&["whoami"]);
    assert_eq!(who["attributes"]["Turtlebot4"], "true", "{who}");
    let first = dev.admin().json(&["identity", "register", "Zoe"]);
    assert!(!first["command"].as_str().unwrap().contains("--force"), "{first}");
}

#[test]
fn policies_with_the_mark_of_an_editor_are_read_and_other_files_are_named() {
    let dev = Dev::start();
    let owner = dev.owner();
    let place = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = place.path().join(name);
        fs::write(&path, bytes).unwrap();
        path.display().to_string()
    };
    let text = owner.run(&["policy", "show", "default"]).ok().stdout;
    let utf16: Vec<u8> = std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    let notepad = file("notepad.cedar", format!("\u{feff}{text}").as_bytes());
    let powershell = file("powershell.cedar", &utf16);
    for path in [&notepad, &powershell] {
        let checked = owner.run(&["policy", "check", path]).ok().stdout;
        assert!(checked.contains(": no errors"), "{checked}");
        owner.run(&["policy", "put", "default", &format!("@{path}")]).ok();
        assert_eq!(owner.run(&["policy", "show", "default"]).ok().stdout.trim(), text.trim());
    }
    owner.run(&["policy", "apply", &notepad]).ok();
    let fleet = file("fleet.toml", b"\xef\xbb\xbforganisation = \"Org2\"\n");
    owner.run(&["diff", &fleet]).ok();
    owner.run(&["policy", "apply", &fleet]).refused(3, &["contains no policies", "ledgerctl apply "]);
    let fleet = file("robots.toml", b"[robot.Husky]\ntrust = [\"Org1\", \"Org2\"]\n");
    owner.run(&["policy", "apply", &fleet]).refused(3, &["contains no policies", "ledgerctl apply "]);
    owner.run(&["apply", &notepad]).refused(3, &["ledgerctl policy apply "]);
    let spaces = file("guests (1).cedar", text.as_bytes());
    owner.run(&["policy", "apply", &spaces]).refused(3, &["mv ", "guests-1.cedar"]);
    let directory = place.path().display().to_string();
    owner.run(&["policy", "apply", &directory]).refused(3, &["is a directory", "/*.cedar"]);
}
