//! The output and exit code of `ledgerctl`, for everything that needs no node.

use crate::machine::{Machine, closed_address, transcript};
use std::process::Stdio;

const FINGERPRINT: &str = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08";

#[test]
fn version_and_help_go_to_standard_output_with_0() {
    let machine = Machine::new();
    let version = machine.run(&["--version"]);
    assert_eq!((version.code, version.stderr.as_str()), (0, ""));
    assert_eq!(version.stdout, concat!("ledgerctl ", env!("CARGO_PKG_VERSION"), "\n"));
    let help = machine.run(&["--help"]);
    assert_eq!((help.code, help.stderr.as_str()), (0, ""));
    for word in ["enroll", "acquire", "echo", "explain", "Exit codes", "--context", "LEDGERCTL_CONTEXT"] {
        assert!(help.stdout.contains(word), "{word} in {}", help.stdout);
    }
}

#[test]
fn a_wrong_command_line_ends_with_64_and_says_what_is_meant() {
    let machine = Machine::new();
    for (args, part) in [
        (vec![], "Usage"),
        (vec!["aquire", "Turtlebot4"], "acquire"),
        (vec!["acquire"], "ROBOT[/TOPIC]"),
        (vec!["acquire", "Turtlebot4", "--for", "30"], "did you mean 30s?"),
        (vec!["enroll", "Salma"], "--ca-fingerprint"),
        (vec!["publish", "Turtlebot4/cmd_vel"], "--hex"),
        (vec!["robot", "add", "T", "--attr-required", "T", "--service", "/c=a/msg/B,modus=open"], "did you mean mode?"),
        (vec!["status", "-o", "yaml"], "json"),
        (vec!["network", "invite"], "--organisation"),
        (vec!["network", "invite", "--node", "a", "--organisation", "B"], "cannot be used with"),
        (vec!["network", "invite", "--organisation", "B", "--for", "7w"], "1h"),
        (vec!["network", "promote"], "NODE"),
        (vec!["network", "aprove", "12345678"], "approve"),
    ] {
        let said = machine.run(&args);
        assert_eq!((said.code, said.stdout.as_str()), (64, ""), "{args:?}");
        assert!(said.stderr.contains(part), "{part:?} in {}", said.stderr);
    }
}

#[test]
fn explain_prints_the_paragraph_of_a_code() {
    let machine = Machine::new();
    let by_name = machine.run(&["explain", "HELD"]);
    assert_eq!((by_name.code, by_name.stderr.as_str()), (0, ""));
    assert!(by_name.stdout.starts_with("LGR-3005 HELD (exit code 5)\n\n- Meaning: another user holds"));
    assert_eq!(by_name.stdout, machine.run(&["explain", "LGR-3005"]).stdout);
    let json: serde_json::Value =
        serde_json::from_str(&machine.run(&["explain", "3005", "-o", "json"]).stdout).unwrap();
    assert_eq!((&json["code"], &json["name"], &json["exit_code"]), (&"LGR-3005".into(), &"HELD".into(), &5.into()));
}

#[test]
fn explain_of_an_unknown_code_names_the_near_one() {
    Machine::new().run(&["explain", "HELDD"]).refused(3, "LGR-1013", &["found   \"HELDD\"", "did you mean LGR-3005"]);
}

#[test]
fn completions_exist_for_the_usual_shells() {
    let machine = Machine::new();
    for shell in ["bash", "zsh", "fish"] {
        let said = machine.run(&["completions", shell]);
        assert_eq!((said.code, said.stderr.as_str()), (0, ""));
        assert!(said.stdout.contains("LEDGERCTL_COMPLETE") && said.stdout.contains("ledgerctl"), "{shell}");
    }
}

#[test]
fn without_a_context_people_are_told_how_to_get_one() {
    let machine = Machine::new();
    for args in [&["status"][..], &["whoami"], &["acquire", "Turtlebot4"], &["network", "status"], &["context", "show"]]
    {
        machine.run(args).refused(3, "LGR-7003", &["no context is selected", "ledgerctl enroll NAME"]);
    }
    let list = machine.run(&["context", "list"]);
    assert_eq!((list.code, list.stdout.as_str()), (0, "no contexts; `ledgerctl enroll` creates one\n"));
    assert_eq!(machine.run(&["context", "list", "-o", "json"]).stdout, "[]\n");
}

#[test]
fn an_unknown_context_is_refused_by_flag_and_by_variable() {
    let machine = Machine::new();
    machine.run(&["whoami", "--context", "Salma"]).refused(3, "LGR-7003", &["Salma"]);
    let output = machine.command(&["status"]).env("LEDGERCTL_CONTEXT", "Farhad").output().unwrap();
    transcript(&output).refused(3, "LGR-7003", &["Farhad"]);
    machine.run(&["context", "use", "Salma"]).refused(3, "LGR-7003", &["Salma"]);
    machine.run(&["context", "delete", "Salma"]).refused(3, "LGR-7003", &["Salma"]);
}

#[test]
fn errors_in_json_are_one_object_on_standard_error() {
    let said = Machine::new().run(&["-o", "json", "status", "--context", "Salma"]);
    assert_eq!((said.code, said.stdout.as_str()), (3, ""));
    assert_eq!(said.stderr.lines().count(), 1);
    let error: serde_json::Value = serde_json::from_str(&said.stderr).unwrap();
    assert_eq!((&error["code"], &error["name"]), (&"LGR-7003".into(), &"NO_CONTEXT".into()));
    for key in ["message", "found", "wanted", "try"] {
        assert!(error[key].is_string(), "{key} in {error}");
    }
}

#[test]
fn enrolling_at_an_address_where_nobody_listens_ends_with_4() {
    let address = closed_address();
    let args = ["enroll", "Salma", "--node", &address, "--ca-fingerprint", FINGERPRINT, "--secret", "s"];
    Machine::new().run(&args).refused(4, "LGR-4001", &[&address, "  try     "]);
}

#[test]
fn enrolling_with_a_fingerprint_that_is_none_ends_with_3() {
    let args = ["enroll", "Salma", "--node", "127.0.0.1:1", "--ca-fingerprint", "abc", "--secret", "s"];
    Machine::new().run(&args).refused(3, "LGR-1011", &["found   \"abc\"", "64 hexadecimal digits"]);
}

#[test]
fn archiving_what_is_no_data_directory_ends_with_3_and_makes_nothing() {
    let machine = Machine::new();
    let to = machine.home.path().join("archive");
    let words = ["ledger", "archive", "/nowhere/ledger", "--to", &to.to_string_lossy()];
    machine.run(&words).refused(3, "LGR-7002", &["/nowhere/ledger", "genesis.json"]);
    assert!(!to.exists());
}

#[test]
fn arguments_are_read_before_anybody_is_asked() {
    let machine = Machine::new();
    machine.run(&["publish", "T/c", "--hex", "0g"]).refused(3, "LGR-1011", &["'g'"]);
    machine.run(&["publish", "T/c", "--file", "/nowhere/f"]).refused(3, "LGR-7002", &["/nowhere/f"]);
    machine.run(&["invoke", "c", "f", "@/nowhere/f"]).refused(3, "LGR-7002", &["/nowhere/f"]);
    machine.run(&["tx", "12"]).refused(3, "LGR-1011", &["64 hexadecimal digits"]);
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let mut child =
        Machine::new().command(&["completions", "bash"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let said = transcript(&child.wait_with_output().unwrap());
    assert_eq!((said.code, said.stderr.as_str()), (0, ""));
}

#[test]
fn output_that_cannot_be_written_is_an_error() {
    for args in
        [&["explain", "HELD"][..], &["completions", "bash"], &["--help"], &["--version"], &["acquire", "--help"]]
    {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = Machine::new().command(args).stdout(full).output().unwrap();
        transcript(&output).refused(3, "LGR-7002", &["cannot write the results to standard output"]);
    }
}

#[test]
fn a_node_that_does_not_answer_ends_every_command_with_4() {
    let (machine, address) = (Machine::new(), closed_address());
    machine.enrolled("Salma", &address);
    for args in [
        &["status"][..],
        &["acquire", "Turtlebot4", "--for", "30s"],
        &["robot", "list"],
        &["identity", "register", "Farhad", "--attr", "Turtlebot4"],
        &["publish", "T/c", "--hex", "00010000"],
        &["echo", "T/c"],
        &["invoke", "abac", "robots"],
        &["policy", "list"],
        &["denials"],
    ] {
        machine.run(args).refused(4, "LGR-4001", &[&address, "  try     "]);
    }
}

#[test]
fn whoami_works_without_a_node() {
    let (machine, address) = (Machine::new(), closed_address());
    machine.enrolled("Salma", &address);
    let said = machine.run(&["whoami"]);
    assert_eq!((said.code, said.stderr.as_str()), (0, ""));
    for part in ["Org1/Salma", "member", "Husky=true", "fleet", &address, "online       unknown: ", "[LGR-4001]"] {
        assert!(said.stdout.contains(part), "{part:?} in {}", said.stdout);
    }
    let json: serde_json::Value = serde_json::from_str(&machine.run(&["whoami", "-o", "json"]).stdout).unwrap();
    assert_eq!((&json["id"], &json["role"]), (&"Org1/Salma".into(), &"member".into()));
    assert_eq!((&json["attributes"]["Husky"], &json["online"]["state"]), (&"true".into(), &"unreachable".into()));
}

#[test]
fn contexts_are_listed_chosen_shown_and_deleted() {
    let machine = Machine::new();
    machine.enrolled("Salma", "127.0.0.1:1");
    machine.enrolled("Farhad", "127.0.0.1:1");
    let list = machine.run(&["context", "list"]);
    assert_eq!(
        list.stdout,
        "   NAME    IDENTITY     NETWORK  NODES\n   Farhad  Org1/Farhad  fleet    127.0.0.1:1\n*  Salma   \
         Org1/Salma   fleet    127.0.0.1:1\n"
    );
    assert_eq!(machine.run(&["context", "use", "Farhad"]).stdout, "context Farhad is in use\n");
    let shown: serde_json::Value =
        serde_json::from_str(&machine.run(&["-o", "json", "context", "show"]).stdout).unwrap();
    assert_eq!(shown["id"], "Org1/Farhad");
    let other = machine.command(&["context", "show"]).env("LEDGERCTL_CONTEXT", "Salma").output().unwrap();
    assert!(transcript(&other).stdout.contains("Org1/Salma"), "the variable wins over the selected one");
    let flag = machine.command(&["--context", "Farhad", "context", "show"]).env("LEDGERCTL_CONTEXT", "Salma").output();
    assert!(transcript(&flag.unwrap()).stdout.contains("Org1/Farhad"), "the flag wins over the variable");
    assert_eq!(machine.run(&["context", "delete", "Farhad"]).stdout, "context Farhad is deleted\n");
    machine.run(&["whoami"]).refused(3, "LGR-7003", &["no context is selected", "Salma"]);
}

#[test]
fn a_slip_in_a_context_name_is_answered_with_the_near_one() {
    let machine = Machine::new();
    machine.enrolled("Salma", "127.0.0.1:1");
    machine.run(&["whoami", "--context", "Slama"]).refused(3, "LGR-7003", &["did you mean \"Salma\"?"]);
}

#[test]
fn enrolling_never_replaces_a_context_unasked() {
    let (machine, address) = (Machine::new(), closed_address());
    machine.enrolled("Salma", &address);
    let args = ["enroll", "Org1/Salma", "--node", &address, "--ca-fingerprint", FINGERPRINT, "--secret", "s"];
    machine.run(&args).refused(3, "LGR-3011", &["Salma", "--force", "--context"]);
    for more in [&["--force"][..], &["--context", "Salma2"]] {
        machine.run(&[&args[..], more].concat()).refused(4, "LGR-4001", &[&address]);
    }
    // The variable chooses whom to act as, not where a new identity goes.
    let output = machine.command(&args).env("LEDGERCTL_CONTEXT", "other").output().unwrap();
    transcript(&output).refused(3, "LGR-3011", &["Salma"]);
}

#[test]
fn a_damaged_context_is_listed_with_its_fault_and_not_used() {
    let machine = Machine::new();
    machine.enrolled("Salma", "127.0.0.1:1");
    std::fs::write(machine.home.path().join("contexts/Salma/context.toml"), "nodes = 7").unwrap();
    let list = machine.run(&["context", "list"]);
    assert_eq!(list.code, 0);
    assert!(list.stdout.contains("damaged: "), "{}", list.stdout);
    machine.run(&["whoami"]).refused(3, "LGR-7002", &["context.toml"]);
}

#[test]
fn a_wrong_command_line_is_json_for_who_asked_for_json() {
    let machine = Machine::new();
    for (args, message, part) in [
        (&["-o", "json", "aquire", "T"][..], "unrecognized subcommand 'aquire'", "did you mean"),
        (&["acquire", "-o", "json"], "the following required arguments were not provided", "--help"),
        (&["status", "-o", "yaml", "-o=json@1"], "invalid value 'yaml'", "--help"),
        (&["acquire", "T", "--for", "30", "--output=json"], "invalid value '30'", "--help"),
        (&["status", "-o", "json@2"], "invalid value 'json@2'", "did you mean json?"),
    ] {
        let said = machine.run(args);
        assert_eq!((said.code, said.stdout.as_str(), said.stderr.lines().count()), (64, "", 1), "{said:?}");
        let told: serde_json::Value = serde_json::from_str(&said.stderr).unwrap();
        assert_eq!((&told["code"], &told["name"]), (&"LGR-USAGE".into(), &"USAGE".into()));
        assert!(told["message"].as_str().unwrap().starts_with(message), "{told}");
        assert!(told["try"].as_str().unwrap().contains(part), "{told}");
        assert!(told["found"].is_string() && told["wanted"].is_string(), "{told}");
    }
}

#[test]
fn json_of_the_version_that_a_program_knows_is_the_json_of_now() {
    let machine = Machine::new();
    let [now, first] = ["json", "json@1"].map(|format| machine.run(&["explain", "HELD", "-o", format]));
    assert_eq!((now.code, first.code, &now.stdout), (0, 0, &first.stdout));
}

#[test]
fn comma_separated_values_have_the_fields_of_the_json_as_columns() {
    let machine = Machine::new();
    machine.enrolled("Salma", "127.0.0.1:1");
    let said = machine.run(&["context", "list", "-o", "csv"]);
    assert_eq!((said.code, said.stderr.as_str()), (0, ""));
    assert_eq!(said.stdout, "name,in_use,id,label,nodes,fault\nSalma,true,Org1/Salma,fleet,127.0.0.1:1,\n");
    let shown = machine.run(&["context", "show", "-o", "csv"]).stdout;
    let head = shown.lines().next().unwrap();
    assert!(head.starts_with("name,id,not_after,not_after_utc,"), "{head}");
}

#[test]
fn manual_pages_are_written_for_every_command() {
    let machine = Machine::new();
    let to = machine.home.path().join("man1");
    std::fs::create_dir(&to).unwrap();
    let said = machine.run(&["man", &to.to_string_lossy()]);
    assert_eq!((said.code, said.stdout.as_str()), (0, ""));
    for page in ["ledgerctl.1", "ledgerctl-acquire.1", "ledgerctl-robot-list.1", "ledgerctl-doctor.1"] {
        let text = std::fs::read_to_string(to.join(page)).unwrap();
        assert!(text.contains(".SH NAME") && text.contains("Example:"), "{page}");
    }
    machine.run(&["man", "/nowhere/man1"]).refused(3, "LGR-7002", &["/nowhere/man1"]);
}

#[test]
fn names_of_this_machine_are_completed_and_silence_of_the_network_is_no_error() {
    let (machine, address) = (Machine::new(), closed_address());
    machine.enrolled("Salma", &address);
    let completed = |words: &[&str]| {
        let words = [&["--", "ledgerctl"][..], words].concat();
        let said = transcript(&machine.command(&words).env("LEDGERCTL_COMPLETE", "fish").output().unwrap());
        assert_eq!((said.code, said.stderr.as_str()), (0, ""), "{words:?}");
        said.stdout
    };
    assert!(completed(&["context", "use", ""]).starts_with("Salma\n"));
    assert!(completed(&["explain", "LGR-300"]).contains("LGR-3005\tHELD"));
    assert!(completed(&["identity", "register", "x", "--role", ""]).contains("robot"));
    assert!(completed(&["ident"]).contains("identity"));
    assert!(!completed(&["acquire", "Tur"]).contains("Tur"), "nobody answers");
}

#[test]
fn top_needs_a_terminal_and_says_what_programs_use() {
    let (machine, address) = (Machine::new(), closed_address());
    machine.enrolled("Salma", &address);
    machine.run(&["top"]).refused(4, "LGR-4001", &[&address]);
}
