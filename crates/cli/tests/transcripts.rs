//! What `ledgerctl` says and with which exit code, for everything that needs no node.

#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

const FINGERPRINT: &str = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08";

/// A machine on which nobody has enrolled yet.
struct Machine {
    home: TempDir,
}

/// What one run said.
#[derive(Debug)]
struct Transcript {
    stdout: String,
    stderr: String,
    code: i32,
}

impl Machine {
    fn new() -> Self {
        Self { home: tempfile::tempdir().unwrap() }
    }

    fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ledgerctl"));
        command.args(args).env("LEDGERD_HOME", self.home.path()).env("TZ", "UTC").env_remove("LEDGERCTL_CONTEXT");
        command.stdin(Stdio::null());
        command
    }

    fn run(&self, args: &[&str]) -> Transcript {
        transcript(&self.command(args).output().unwrap())
    }
}

fn transcript(output: &Output) -> Transcript {
    Transcript {
        stdout: String::from_utf8(output.stdout.clone()).unwrap(),
        stderr: String::from_utf8(output.stderr.clone()).unwrap(),
        code: output.status.code().unwrap(),
    }
}

impl Transcript {
    /// The four lines, each of which must be there and in this order.
    #[track_caller]
    fn refused(&self, code: i32, lgr: &str, parts: &[&str]) {
        assert_eq!(self.code, code, "{self:?}");
        assert_eq!(self.stdout, "", "an error leaves standard output alone");
        let first = self.stderr.lines().next().unwrap_or_default();
        assert!(first.starts_with("error: ") && first.ends_with(&format!("[{lgr}]")), "{}", self.stderr);
        for part in parts {
            assert!(self.stderr.contains(part), "{part:?} in {}", self.stderr);
        }
    }
}

/// An address of this machine where nobody listens.
fn closed_address() -> String {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().to_string()
}

#[test]
fn version_and_help_go_to_standard_output_with_0() {
    let machine = Machine::new();
    let version = machine.run(&["--version"]);
    assert_eq!((version.code, version.stderr.as_str()), (0, ""));
    assert_eq!(version.stdout, concat!("ledgerctl ", env!("CARGO_PKG_VERSION"), "\n"));
    let help = machine.run(&["--help"]);
    assert_eq!((help.code, help.stderr.as_str()), (0, ""));
    for word in ["enroll", "acquire", "echo", "verify", "Exit codes", "--context", "LEDGERCTL_CONTEXT"] {
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
        assert!(said.stdout.contains("acquire") && said.stdout.contains("ca-fingerprint"), "{shell}");
    }
}

#[test]
fn without_a_context_people_are_told_how_to_get_one() {
    let machine = Machine::new();
    for args in [&["status"][..], &["whoami"], &["acquire", "Turtlebot4"], &["context", "show"]] {
        machine.run(args).refused(3, "LGR-7003", &["no context is selected", "ledgerctl identity register"]);
    }
    let list = machine.run(&["context", "list"]);
    assert_eq!((list.code, list.stdout.as_str()), (0, "no context yet; `ledgerctl enroll` makes one\n"));
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
fn verifying_what_is_no_directory_ends_with_3() {
    Machine::new().run(&["verify", "/nowhere/ledger"]).refused(3, "LGR-7002", &["/nowhere/ledger"]);
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
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let output = Machine::new().command(&["explain", "HELD"]).stdout(full).output().unwrap();
    transcript(&output).refused(1, "LGR-5001", &["cannot write the output"]);
}
