//! The output and exit code of `ledgerctl`, for everything that needs no node.

#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use ledger_api::Context;
use ledger_hash::Hash;
use ledger_identity::key::SigningKey;
use ledger_identity::msp::{Msp, Msps};
use rcgen::{BasicConstraints, CertificateParams, CustomExtension, DnType, IsCa, Issuer, KeyPair, KeyUsagePurpose};
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use tempfile::TempDir;

const FINGERPRINT: &str = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08";

/// A machine on which nobody has enrolled yet.
struct Machine {
    home: TempDir,
}

/// The output of one run.
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

    /// Stores a context as `enroll` would have: Org1 certified this name with the attribute Husky, and its node is
    /// said to be at that address.
    fn enrolled(&self, name: &str, node: &str) {
        let mut params = CertificateParams::default();
        params.distinguished_name.push(DnType::CommonName, "Org1 CA");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        let ca_key = KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap();
        let ca = params.self_signed(&ca_key).unwrap();

        let mut leaf = CertificateParams::default();
        leaf.distinguished_name.push(DnType::CommonName, name);
        leaf.distinguished_name.push(DnType::OrganizationalUnitName, "member");
        leaf.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        let attributes = br#"{"attrs":{"Husky":"true"}}"#.to_vec();
        leaf.custom_extensions = vec![CustomExtension::from_oid_content(&[1, 2, 3, 4, 5, 6, 7, 8, 1], attributes)];
        let key = KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap();
        let certificate = leaf.signed_by(&key, &Issuer::from_params(&params, &ca_key)).unwrap();

        let mut msps = Msps::new();
        msps.insert(Msp::new("Org1", &[ca.der()], &[] as &[&[u8]]).unwrap()).unwrap();
        let context = Context {
            name: name.to_owned(),
            organisation: "Org1".to_owned(),
            network: Hash::of(&[b"network"]),
            label: "fleet".to_owned(),
            nodes: vec![node.to_owned()],
            chain: vec![certificate.der().clone()],
            key: Arc::new(SigningKey::from_pkcs8_der(&key.serialize_der()).unwrap()),
            msps: Arc::new(msps),
            renew: ledger_api::context::RenewalRule::default(),
            memory: ledger_api::context::Memory::default(),
        };
        context.save(self.home.path()).unwrap();
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
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let output = Machine::new().command(&["explain", "HELD"]).stdout(full).output().unwrap();
    transcript(&output).refused(3, "LGR-7002", &["cannot write the results to standard output"]);
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
