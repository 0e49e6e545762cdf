//! `ledgerd policy prove` with the solver cvc5: by the variable CVC5, or by the Python package that `./test` installs.

use crate::support::programs::{node, repository};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

const GUESTS: &str = "\
permit (
    principal in Organisation::\"Org7\",
    action in [Action::\"acquire\", Action::\"publish\"],
    resource in Robot::\"Turtlebot4\"
) when { principal.hasTag(\"guest\") };
";
const NIGHT: &str = "\
forbid (principal, action in [Action::\"acquire\", Action::\"publish\"], resource)
when { principal.organisation == \"Org7\" && resource.robot == \"Turtlebot4\" };
";

struct Place(TempDir, Option<PathBuf>);

impl Place {
    fn new() -> Self {
        let place = tempfile::tempdir().unwrap();
        let solver = solver(place.path());
        Self(place, solver)
    }

    fn write(&self, name: &str, text: &str) {
        let path = self.0.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn prove(&self, line: &str) -> Output {
        let mut command = node();
        command.args(["policy", "prove"]).args(line.split_whitespace()).current_dir(self.0.path()).env_remove("CVC5");
        if let Some(solver) = &self.1 {
            command.env("CVC5", solver);
        }
        command.output().unwrap()
    }

    fn proved(&self, line: &str) {
        let output = self.prove(line);
        assert!(output.status.code() == Some(0) && text(&output).starts_with("proved: "), "{line}: {output:?}");
    }

    /// The counterexample, which holds all of these words.
    fn disproved(&self, line: &str, words: &[&str]) {
        let output = self.prove(line);
        let told = text(&output);
        assert_eq!(output.status.code(), Some(1), "{line}: {output:?}");
        assert!(words.iter().all(|word| told.contains(word)), "{line}: {told}");
    }
}

fn text(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// A program for the variable CVC5; none if there is no cvc5 here.
fn solver(place: &Path) -> Option<PathBuf> {
    if let Some(solver) = std::env::var_os("CVC5") {
        return Some(solver.into());
    }
    let python = std::env::var("LEDGERD_TEST_PYTHON").unwrap_or_else(|_| "python3".into());
    let script = repository().join("tests/node/solver.py");
    let has = Command::new(&python).args(["-c", "import cvc5"]).output().is_ok_and(|ran| ran.status.success());
    has.then(|| {
        let program = place.join("cvc5");
        let text = format!("#!/bin/sh\nexec '{python}' '{}' \"$@\"\n", script.display());
        fs::write(&program, text).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        program
    })
}

#[test]
fn what_nobody_can_do_is_proved_or_shown_with_who_does_what() {
    let place = Place::new();
    if place.1.is_none() {
        println!("skipped: needs cvc5");
        return;
    }
    place.write("guests.cedar", GUESTS);
    place.write("night.cedar", NIGHT);
    // The built-in policy, with what is known of the robot.
    let known = "--robot Turtlebot4 --requires Turtlebot4 --owner Org2 --trusted Org1";
    place.proved(
        "--can drive --nobody-without Turtlebot4=true --requires Turtlebot4 --owner Org2 --robot Turtlebot4/cmd_vel",
    );
    place.disproved(&format!("--can drive --nobody-without Husky {known}"), &["acquire", "Turtlebot4", "default"]);
    place.proved(&format!("--can override --nobody-of Org7 {known}"));
    place.disproved("--can stop --nobody-of Org7", &["Robot", "safety"]);
    // Own policies.
    place.disproved("guests.cedar --can drive --nobody-of Org7 --robot Turtlebot4", &["Org7", "guest", "guests"]);
    place.proved("guests.cedar --can drive --nobody-of Org1 --robot Turtlebot4");
    place.proved("guests.cedar --can drive --nobody-without guest");
    place.proved("guests.cedar night.cedar --can drive --nobody-of Org7 --robot Turtlebot4");
    // No permit names override, so none gives it.
    place.write("open.cedar", "permit (principal, action, resource) when { principal.organisation == \"Org7\" };");
    place.proved("open.cedar --can override --nobody-of Org7");
    place.disproved("open.cedar --can subscribe --nobody-of Org7", &["Org7"]);
}

#[test]
fn new_policies_permit_at_most_what_the_old_ones_do_or_a_request_shows_more() {
    let place = Place::new();
    if place.1.is_none() {
        println!("skipped: needs cvc5");
        return;
    }
    place.write("old/guests.cedar", GUESTS);
    place.write(
        "new/guests.cedar",
        &GUESTS.replace("hasTag(\"guest\")", "hasTag(\"guest\") && principal.role == \"member\""),
    );
    place.write("new/night.cedar", NIGHT);
    place.proved("new --at-most old");
    place.disproved("old --at-most new", &["the old ones do not", "Org7", "guests"]);
    // A limit that goes is more.
    let slow = format!("@max_linear(\"0.3\")\n{GUESTS}");
    place.write("slow/guests.cedar", &slow);
    place.proved("slow --at-most old");
    place.disproved("old --at-most slow", &["Org7"]);
    // So is a stop that is forbidden no longer to those who have it by rule.
    let stop = "forbid (principal, action == Action::\"stop\", resource);";
    place.write("stopless/stop.cedar", &format!("{GUESTS}{stop}"));
    place.proved("stopless --at-most old");
    place.disproved("old --at-most stopless", &["stop"]);
}

#[test]
fn without_a_solver_or_with_an_old_one_the_way_to_get_it_is_said() {
    let mut place = Place::new();
    let line = "--can drive --nobody-of Org7";
    place.1 = None;
    let refused = |place: &Place, found: &str| {
        let output = place.prove(line);
        let told = String::from_utf8(output.stderr.clone()).unwrap();
        assert_eq!(output.status.code(), Some(3), "{output:?}");
        for part in [found, "LGR-7002", "1.3.1", "https://github.com/cvc5/cvc5/releases"] {
            assert!(told.contains(part), "{part}: {told}");
        }
    };
    refused(&place, "the variable CVC5 is not set");
    for (script, found) in [
        ("echo 'This is cvc5 version 1.2.0 [git]'", "version 1.2.0"),
        ("echo 'Z3 version 4.13'", "reports no version of cvc5"),
    ] {
        let program = place.0.path().join("old");
        fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        place.1 = Some(program);
        refused(&place, found);
    }
    place.write("odd.cedar", "permit (principal, action, resource) when { principal has level };");
    let output = place.prove("odd.cedar --can drive --nobody-of Org7");
    assert!(String::from_utf8(output.stderr).unwrap().contains("LGR-3014"));
}
