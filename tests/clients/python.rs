//! The package in Python. Its tests against networks are written in Python, in `clients/python/tests`.

use crate::support::{Dev, programs};
use crate::two_networks::two_networks;
use crate::{blocks, python, ran, repository};
use ledger_api::Context;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

fn package() -> PathBuf {
    repository().join("clients/python")
}

/// The interpreter in the package, with the programs that were built for this test.
fn interpreter() -> Command {
    let mut command = Command::new(python());
    let paths = ["src", "tests"].map(|below| package().join(below).display().to_string());
    command.current_dir(package()).env("PYTHONPATH", paths.join(":")).env("PYTHONDONTWRITEBYTECODE", "1");
    command.env("LEDGERD", programs::ledgerd()).env("LEDGERCTL", programs::ledgerctl());
    command
}

/// Runs a file of tests.
#[track_caller]
fn tested(file: &str) {
    let output = ran(interpreter().args(["-m", "unittest", "-v"]).arg(Path::new("tests").join(file)));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    // A file without tests would pass as well.
    assert!(said.contains("\nOK") && !said.contains("Ran 0 tests"), "{said}");
}

#[test]
fn contexts_are_those_of_ledgerctl() {
    tested("test_contexts.py");
}

#[test]
fn robots_are_acquired_driven_heard_and_given_back_and_refusals_explain_themselves() {
    tested("test_grants.py");
}

#[test]
fn nothing_is_lost_or_repeated_while_nodes_are_killed() {
    tested("test_kills.py");
}

#[test]
fn enemies_and_broken_things_are_met() {
    tested("test_enemies.py");
}

#[test]
fn a_machine_that_is_short_of_files_or_space_ends_no_client() {
    tested("test_shortage.py");
}

#[test]
fn a_call_that_the_network_does_not_have_is_reported_with_what_to_do() {
    tested("test_branches.py");
}

#[test]
fn ros2_ledger_is_found_and_does_what_it_says() {
    tested("test_ros2.py");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_process_that_serves_several_networks_is_told_which_one_is_meant() {
    let place = TempDir::new().unwrap();
    let (_host, networks) = two_networks(place.path()).await;
    let home = place.path().join("home");
    for (label, (node, admin)) in ["first", "second"].into_iter().zip(networks) {
        let admin = Context { name: label.to_owned(), ..admin };
        admin.save(&home).unwrap();
        let program =
            format!("import ledgerd\nwith ledgerd.connect({label:?}) as one: print(one.status().network.hex())");
        let mut command = interpreter();
        command.args(["-c", &program]).env("LEDGERD_HOME", &home);
        let output = tokio::task::spawn_blocking(move || ran(&mut command)).await.unwrap();
        assert_eq!(String::from_utf8(output.stdout).unwrap().trim(), node.ledger().network().to_string());
        node.stop().await;
    }
}

#[test]
fn every_type_is_right() {
    let cache = TempDir::new().unwrap();
    ran(interpreter().args(["-m", "mypy", "--strict", "--cache-dir"]).arg(cache.path()));
}

#[test]
fn the_generated_code_is_that_of_the_proto_files() {
    let made = TempDir::new().unwrap();
    ran(Command::new("bash").arg(package().join("generate")).arg(made.path()).arg(python()));
    let files = |place: &Path| {
        let entries = fs::read_dir(place.join("ledgerd/v1")).unwrap().map(|entry| entry.unwrap().path());
        let generated = entries.filter(|path| path.to_string_lossy().contains("_pb2.py"));
        let mut found: Vec<_> =
            generated.map(|path| (path.file_name().unwrap().to_owned(), fs::read(&path).unwrap())).collect();
        found.sort();
        found
    };
    let (wanted, found) = (files(made.path()), files(&package().join("src")));
    assert_eq!(wanted.len(), 6, "code and types of three files");
    assert!(wanted == found, "the code is of other proto files: run clients/python/generate clients/python/src PYTHON");
}

/// The package built as a wheel, from a copy: building leaves traces beside the sources.
fn wheel(place: &Path) -> PathBuf {
    let source = place.join("source");
    ran(Command::new("cp").arg("-r").arg(package()).arg(&source));
    let build = ["-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir"];
    ran(Command::new(python()).args(build).arg(place).arg(&source));
    let built = fs::read_dir(place).unwrap().map(|entry| entry.unwrap().path());
    built.into_iter().find(|path| path.extension().is_some_and(|kind| kind == "whl")).expect("a wheel")
}

#[test]
fn the_wheel_is_pure_and_has_types_and_the_version_of_this_workspace() {
    let place = TempDir::new().unwrap();
    let built = wheel(place.path());
    let name = format!("ledgerd-{}-py3-none-any.whl", env!("CARGO_PKG_VERSION"));
    assert_eq!(built.file_name().unwrap().to_string_lossy(), name);
    let listed = ran(Command::new(python()).args(["-m", "zipfile", "-l"]).arg(&built)).stdout;
    let listed = String::from_utf8(listed).unwrap();
    for part in
        ["ledgerd/py.typed", "ledgerd/v1/gateway_pb2.py ", "ledgerd/v1/gateway_pb2.pyi", "ledgerd/ros2/verbs.py"]
    {
        assert!(listed.contains(part), "{part} in {listed}");
    }
    assert!(!listed.contains("tests/"), "{listed}");
}

#[test]
fn the_teleop_fits_twenty_lines() {
    let text = fs::read_to_string(package().join("examples/teleop.py")).unwrap();
    assert!(text.lines().count() <= 20, "{} lines", text.lines().count());
}

#[test]
fn the_five_minutes_of_the_readme_work_as_they_stand() {
    let dev = Dev::start();
    let readme = package().join("README.md");
    let register = dev.admin().json(&["identity", "register", "Salma", "--attr", "Turtlebot4"]);
    let place = TempDir::new().unwrap();
    let site = place.path().join("site");
    let install = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target"];
    ran(Command::new(python()).args(install).arg(&site).arg(wheel(place.path())));
    // What stands for the output of `identity register` in the document.
    let words = [
        ("127.0.0.1:7450", dev.fact("address")),
        ("FINGERPRINT", dev.fact("ca_fingerprint")),
        ("SECRET", register["secret"].as_str().unwrap()),
    ];
    let programs = blocks(&readme, "python");
    assert!(programs.len() >= 4, "enrol, drive, listen, asyncio");
    let mut printed = String::new();
    for program in programs {
        let program = words.iter().fold(program, |text, (word, value)| text.replace(word, value));
        let file = place.path().join("program.py");
        fs::write(&file, &program).unwrap();
        let mut command = Command::new(python());
        command.arg(&file).env("PYTHONPATH", &site).env("LEDGERD_HOME", dev.home.path()).current_dir(place.path());
        printed.push_str(&String::from_utf8(ran(&mut command).stdout).unwrap());
    }
    for line in blocks(&readme, "text").concat().lines() {
        assert!(printed.contains(line), "README says that a program prints {line:?}:\n{printed}");
    }
}
