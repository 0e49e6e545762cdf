//! Clients in other languages, with the gRPC libraries that their programmers use: grpc-go and grpcio.

use crate::support::programs::{python, ran, repository};
use crate::support::{Dev, eventually};
use serde_json::Value;
use std::process::{Command, Output};
use tempfile::TempDir;

const SERVICE: &str = "Turtlebot4/cmd_vel";

/// A call that the clients make; the gRPC code as Go and as Python spell it; the name of our code; and a text among the
/// metadata.
type Refusal = (&'static str, [&'static str; 2], &'static str, (&'static str, &'static str));

const REFUSALS: [Refusal; 6] = [
    ("block", ["NotFound", "NOT_FOUND"], "NOT_FOUND", ("wanted", "a height from 0 to")),
    ("no certificate", ["Unauthenticated", "UNAUTHENTICATED"], "CERTIFICATE_REQUIRED", ("try", "ledgerctl enroll")),
    ("not admin", ["PermissionDenied", "PERMISSION_DENIED"], "NOT_ADMIN", ("found", "role member")),
    ("behind", ["Unavailable", "UNAVAILABLE"], "BEHIND", ("wanted", "height 1099511627776")),
    ("id", ["InvalidArgument", "INVALID_ARGUMENT"], "BAD_ARGUMENT", ("found", "5 bytes")),
    ("subscription", ["PermissionDenied", "PERMISSION_DENIED"], "MISSING_ATTRIBUTE", ("wanted", "Turtlebot4=true")),
];

/// Generated Python code, and a `PYTHONPATH` with it and the example.
fn python_code() -> (TempDir, String) {
    let place = tempfile::tempdir().unwrap();
    let files = ["transaction", "gateway", "enrolment"].map(|name| format!("ledgerd/v1/{name}.proto"));
    let out = place.path().display();
    ran(Command::new(python())
        .args(["-m", "grpc_tools.protoc", "-I"])
        .arg(repository().join("crates/api/proto"))
        .args([format!("--python_out={out}"), format!("--grpc_python_out={out}")])
        .args(files));
    let path = format!("{out}:{}", repository().join("examples/python-client").display());
    (place, path)
}

/// Are these the refusals, as a library with this spelling of gRPC's codes shows them?
fn check(output: &Output, spelling: usize) {
    let printed = String::from_utf8(output.stdout.clone()).unwrap();
    let lines: Vec<Value> = printed.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), REFUSALS.len(), "{printed}");
    for (line, (call, grpc, reason, (name, part))) in lines.iter().zip(REFUSALS) {
        assert_eq!(line["call"], call);
        assert_eq!((&line["grpc"], &line["reason"]), (&grpc[spelling].into(), &reason.into()), "{line}");
        assert_eq!(line["domain"], "ledgerd");
        let metadata = &line["metadata"];
        assert!(metadata["code"].as_str().unwrap().starts_with("LGR-"), "{line}");
        assert!(metadata[name].as_str().unwrap().contains(part), "{line}");
        let text = line["text"].as_str().unwrap();
        assert!(text.contains(metadata["code"].as_str().unwrap()) && text.contains(part), "{line}");
    }
}

#[test]
fn refusals_are_what_they_are_to_programs_in_go() {
    let dev = Dev::start();
    dev.user("Mallory", &[], "ed25519");
    let built = tempfile::tempdir().unwrap();
    ran(Command::new(repository().join("tests/interop/go-client/build")).arg(built.path()).arg(python()));
    let context = dev.home.path().join("contexts/Mallory");
    check(&ran(Command::new(built.path().join("go-client")).arg(context).arg(SERVICE)), 0);
}

#[test]
fn refusals_are_what_they_are_to_programs_in_python() {
    let dev = Dev::start();
    dev.user("Mallory", &[], "p256");
    let (_code, path) = python_code();
    let script = repository().join("tests/interop/refusals.py");
    let context = dev.home.path().join("contexts/Mallory");
    check(&ran(Command::new(python()).arg(script).arg(context).arg(SERVICE).env("PYTHONPATH", path)), 1);
}

#[test]
fn the_readers_in_python_believe_voters_and_not_the_node_that_answers() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let (_code, path) = python_code();
    let examples = repository().join("examples/python-client");
    let file = dev.home.path().join("fleet.checkpoint").display().to_string();
    salma.run(&["light", "Turtlebot4", "--checkpoint", &file]).ok();
    let newest = dev.data().join("certificates/newest.proof");
    eventually("the newest proof is kept", || newest.exists().then_some(()));
    let printed = |command: &mut Command| String::from_utf8(ran(command.env("PYTHONPATH", &path)).stdout).unwrap();
    let verify = |network: &str| {
        let mut command = Command::new(python());
        command.arg(examples.join("verify.py")).arg(network).arg(&file).arg(&newest);
        command
    };
    let verified = printed(&mut verify(dev.fact("network")));
    assert_eq!(verified.matches("signed by Org1/node1").count(), 2, "{verified}");
    assert!(verified.contains("  verdict "), "{verified}");
    let elsewhere = verify(&"00".repeat(32)).output().unwrap();
    assert!(elsewhere.status.code() == Some(1) && elsewhere.stderr.starts_with(b"refused: "), "{elsewhere:?}");
    let context = dev.home.path().join("contexts/Salma");
    let followed = printed(Command::new(python()).arg(examples.join("follow.py")).arg(context));
    assert!(followed.contains(dev.fact("network")) && followed.contains("node/00000000000000000001"), "{followed}");
    assert!(followed.contains("  certificates are not strict\n"), "there is one voter: {followed}");
}

#[test]
fn the_example_in_python_takes_a_robot_drives_it_and_hears_itself() {
    let dev = Dev::start();
    dev.user("Salma", &["Turtlebot4"], "ed25519");
    let (_code, path) = python_code();
    let script = repository().join("examples/python-client/client.py");
    let context = dev.home.path().join("contexts/Salma");
    let output = ran(Command::new(python()).arg(script).arg(context).arg(SERVICE).env("PYTHONPATH", path));
    let printed = String::from_utf8(output.stdout).unwrap();
    for part in ["held with epoch 1", "published in block", "heard 00010000"] {
        assert!(printed.contains(part), "{part:?} in {printed}");
    }
}
