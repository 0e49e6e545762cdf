//! Configured nodes, from the first file to the first user.

use crate::support::network::free_address;
use crate::support::{Ctl, Process, eventually, programs};
use std::fs;
use std::path::Path;
use std::process::Output;
use tempfile::TempDir;

fn ledgerd(arguments: &[&str], place: &Path) -> Output {
    let mut command = programs::node();
    command.args(arguments).current_dir(place).env("LEDGERD_HOME", place);
    command.output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn check_names_every_fault_at_once_with_its_line_and_the_nearest_name() {
    let place = TempDir::new().unwrap();
    let file = place.path().join("ledgerd.toml");
    let faults = [
        ("listn = \"127.0.0.1:7450\"", "did you mean listen?"),
        ("data = 7", "data"),
        ("[limits]", ""),
        ("payload_byte_max = 4096", "payload_bytes_max"),
        ("in_flight_max = 0", "1000000"),
        ("[strorage]", "storage"),
        ("[order]", ""),
        ("tick_ms = \"fast\"", "tick_ms"),
        ("[log]", ""),
        ("level = \"loud\"", "debug"),
    ];
    let lines: Vec<_> = faults.iter().map(|(line, _)| *line).collect();
    fs::write(&file, lines.join("\n")).unwrap();
    let done = ledgerd(&["check", "--config", "ledgerd.toml"], place.path());
    assert_eq!(done.status.code(), Some(3), "{done:?}");
    let told = text(&done.stderr);
    for (number, (line, word)) in faults.iter().enumerate().filter(|(_, (_, word))| !word.is_empty()) {
        let place = format!("ledgerd.toml:{}:", number + 1);
        let fault = told.split("error: ").find(|fault| fault.contains(&place));
        let fault = fault.unwrap_or_else(|| panic!("no fault for {line:?} in:\n{told}"));
        assert!(fault.contains(word), "{word:?} is missing in: {fault}");
        assert!(fault.contains("LGR-7001"), "{fault}");
    }
    // The same faults keep a node from starting.
    let run = ledgerd(&["run", "--config", "ledgerd.toml"], place.path());
    assert_eq!((run.status.code(), text(&run.stderr)), (Some(3), told));
    println!("config: 7 faults in one file");
}

#[test]
fn check_names_every_fault_of_a_bridge_of_a_node_and_of_one_by_itself() {
    let faults = [
        ("domian_id = 7", "domain_id?"),
        ("report_s = 0", "from 1 to 86400"),
        ("shared_memory = 1", "true or false"),
        ("ROUTE", ""),
        ("service = \"Turtlebot4\"", "ROBOT/TOPIC"),
        ("direction = \"to_ledger\"", ""),
        ("type = \"Twist\"", "geometry_msgs/msg/Twist"),
    ];
    let place = TempDir::new().unwrap();
    let lines = faults.map(|(line, _)| line).join("\n");
    for (command, file, head, route) in [
        ("check", "ledgerd.toml", "[bridge]\n", "[[bridge.route]]"),
        ("run", "ledgerd.toml", "[bridge]\n", "[[bridge.route]]"),
        ("bridge", "bridge.toml", "node_name = \"door\"\n", "[[route]]"),
    ] {
        fs::write(place.path().join(file), format!("{head}{}", lines.replace("ROUTE", route))).unwrap();
        let done = ledgerd(&[command, "--config", file], place.path());
        assert_eq!(done.status.code(), Some(3), "{done:?}");
        let told = text(&done.stderr);
        assert_eq!(told.matches("error: ").count(), 5, "{told}");
        for (number, (line, word)) in (2..).zip(faults).filter(|(_, (_, word))| !word.is_empty()) {
            let fault = told.split("error: ").find(|fault| fault.contains(&format!("{file}:{number}:")));
            let fault = fault.unwrap_or_else(|| panic!("no fault for {line:?} in:\n{told}"));
            assert!(fault.contains(word), "{word:?} is missing in: {fault}");
        }
    }
}

#[test]
fn a_log_in_a_file_is_json_unless_somebody_wants_text() {
    let place = TempDir::new().unwrap();
    let route = "[[route]]\nservice = 'R/a'\ndirection = 'to_ledger'\ntype = 'geometry_msgs/msg/Twist'\n";
    let said = |log: &str, wanted: Option<&str>| {
        fs::write(place.path().join("bridge.toml"), format!("[admin]\nlisten = '127.0.0.1:0'\n{log}{route}")).unwrap();
        let mut bridge = programs::node();
        bridge.args(["bridge", "--config", "bridge.toml"]).current_dir(place.path()).env("LEDGERD_HOME", place.path());
        match wanted {
            Some(wanted) => bridge.env("LEDGERD_LOG_FORMAT", wanted),
            None => bridge.env_remove("LEDGERD_LOG_FORMAT"),
        };
        // Without a context it ends at once, and says so in words: that is no log.
        let done = bridge.output().unwrap();
        let told = text(&done.stderr);
        assert!(told.contains("\nerror: "), "{told}");
        told.lines().next().unwrap().to_owned()
    };
    let is_json = |line: &str| {
        let line = serde_json::from_str::<serde_json::Value>(line).ok()?;
        line["fields"]["message"].as_str().map(|message| message.starts_with("monitoring"))
    };
    assert_eq!(is_json(&said("", None)), Some(true));
    assert_eq!(is_json(&said("", Some("json"))), Some(true));
    assert_eq!(is_json(&said("[log]\nformat = 'json'\n", Some("text"))), Some(true));
    for (log, wanted) in [("", Some("text")), ("[log]\nformat = 'text'\n", None)] {
        let line = said(log, wanted);
        assert!(
            line.contains("INFO monitoring endpoint listening") && !line.contains('{') && !line.contains('\u{1b}'),
            "{line}"
        );
    }
}

#[test]
fn what_is_no_configuration_is_refused_and_what_is_one_is_fine() {
    let place = TempDir::new().unwrap();
    let file = place.path().join("ledgerd.toml");
    for (content, word) in
        [(&b"= ="[..], "ledgerd.toml:1"), (&[0xff, 0xfe, 0], "text"), (b"data = \"a", "ledgerd.toml:1")]
    {
        fs::write(&file, content).unwrap();
        let done = ledgerd(&["check", "--config", "ledgerd.toml"], place.path());
        assert_eq!(done.status.code(), Some(3), "{done:?}");
        assert!(text(&done.stderr).contains(word), "{done:?}");
    }
    let done = ledgerd(&["check", "--config", "nowhere.toml"], place.path());
    assert_eq!(done.status.code(), Some(3), "{done:?}");
    assert!(text(&done.stderr).contains("nowhere.toml"));
    fs::write(&file, include_str!("../../ledgerd.toml")).unwrap();
    let done = ledgerd(&["check", "--config", "ledgerd.toml"], place.path());
    assert!(done.status.success(), "{done:?}");
    let done = ledgerd(&["run", "--config", "ledgerd.toml"], place.path());
    assert!(text(&done.stderr).contains("ledgerd init"), "without a network: {done:?}");
    assert!(!done.status.success());
    println!("config: 5 files that are none");
}

#[test]
fn init_run_and_enrol_work_as_printed() {
    let place = TempDir::new().unwrap();
    let address = free_address();
    let init = ["init", "--organisation", "Acme", "--address", &address];
    let done = ledgerd(&init, place.path());
    assert!(done.status.success(), "{done:?}");
    let printed = text(&done.stdout);
    let command = |program: &str, word: &str| -> Vec<String> {
        let line = printed.lines().map(str::trim).find(|line| line.starts_with(program) && line.contains(word));
        line.unwrap_or_else(|| panic!("no {program} {word} in:\n{printed}"))
            .split(' ')
            .skip(1)
            .map(str::to_owned)
            .collect()
    };
    let mut node = programs::node();
    node.args(command("ledgerd", "run")).current_dir(place.path());
    let mut node = Process::start("node1", place.path(), node);

    let home = place.path().join("home");
    let enroll = command("ledgerctl", "enroll");
    eventually("the node takes the first admin", || {
        node.check();
        let ran = Ctl::at(&home).run(&enroll);
        (ran.code != 4).then(|| ran.ok())
    });
    let admin = Ctl::at(&home).as_("admin");
    assert_eq!(admin.json(&["whoami"])["role"], "admin");
    let register: Vec<_> = command("ledgerctl", "identity")
        .iter()
        .map(|word| word.replace("NAME", "Salma").replace("KEY=VALUE", "Go2=true"))
        .collect();
    assert_eq!(admin.json(&register)["attributes"]["Go2"], "true");
    // A secret is good once.
    Ctl::at(&place.path().join("other")).run(&enroll).refused(2, &["LGR-2007"]);
    // A second time nothing is founded, and nothing changes.
    let again = ledgerd(&init, place.path());
    assert!(!again.status.success(), "{again:?}");
    node.check();
    node.interrupt();
    println!("config: 2 commands repeated");
}

#[test]
fn a_file_without_its_option_is_shown_behind_it() {
    let place = TempDir::new().unwrap();
    for (command, file, tip) in [
        ("bridge", "salma.toml", "did you mean '--config salma.toml'?"),
        ("check", "my node.toml", "did you mean '--config 'my node.toml''?"),
    ] {
        let done = ledgerd(&[command, file], place.path());
        assert_eq!(done.status.code(), Some(64), "{done:?}");
        let told = text(&done.stderr);
        assert!(told.contains(tip) && !told.contains("'-- "), "{told}");
    }
}

#[test]
fn results_that_cannot_be_written_are_an_error() {
    let place = TempDir::new().unwrap();
    for arguments in [&["completions", "bash"][..], &["--help"], &["--version"]] {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        let done = programs::node().args(arguments).current_dir(place.path()).stdout(full).output().unwrap();
        let told = text(&done.stderr);
        assert_eq!(done.status.code(), Some(3), "{arguments:?}: {told}");
        assert!(told.contains("cannot write the results to standard output") && told.contains("LGR-7002"), "{told}");
    }
}

#[test]
fn a_command_that_is_printed_quotes_an_odd_path() {
    let place = TempDir::new().unwrap();
    let data = place.path().join("data of node 1");
    let file = place.path().join("node 1.toml");
    fs::write(&file, format!("data = {data:?}\n")).unwrap();
    let done = ledgerd(&["run", "--config", file.to_str().unwrap()], place.path());
    let told = text(&done.stderr);
    assert!(told.contains(&format!("--config '{}'", file.display())), "{told}");
}
