//! The example `arena` on a small course: real nodes, bridges and DDS, a simulated robot.

use crate::network;
use crate::support::{programs, wait};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};

/// The planned orders of waypoints.
const IN_TURNS: [&str; 6] = ["A1", "A2", "A3", "B1", "B2", "B3"];
const INTERRUPTED: [&str; 6] = ["A1", "B1", "B2", "B3", "A2", "A3"];

fn arena(arguments: &[&str]) -> Command {
    let mut command = Command::new(programs::ledgerd().with_file_name("arena"));
    command.env("LEDGERD_LOG_FORMAT", "text").args(["--scale", "0.3"]).args(arguments);
    command
}

#[test]
fn the_arena_judges_its_claims_and_leaves_pictures_a_page_and_numbers() {
    if !network::isolated(&|| ()) {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("arena");
    let played = arena(&["--json", "--out", out.to_str().unwrap()]).output().unwrap();
    let (line, story) = (String::from_utf8(played.stdout).unwrap(), String::from_utf8(played.stderr).unwrap());
    let result: Value = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}\n{story}"));
    assert_eq!(line.lines().count(), 1, "{line}");

    let claims = result["claims"].as_array().unwrap();
    assert_eq!(claims.len(), 7, "{line}");
    let broken: Vec<_> = claims.iter().filter(|claim| claim["held"] != true).collect();
    assert_eq!(result["ok"], broken.is_empty(), "{line}");
    assert_eq!(played.status.code(), Some(if broken.is_empty() { 0 } else { 1 }), "{story}");
    // However busy the machine is: whose commands pass is no question of time, nor is the order of what was reached.
    for (run, planned) in [("controlled", IN_TURNS), ("preempted", INTERRUPTED), ("delayed", IN_TURNS)] {
        let commands = &result["runs"][run]["commands"];
        assert_eq!((commands["strays"].as_u64(), commands["late"].as_u64()), (Some(0), Some(0)), "{run}: {commands}");
        let reached: Vec<_> = result["runs"][run]["order"].as_array().unwrap().iter().collect();
        assert!(planned.starts_with(&reached.iter().map(|name| name.as_str().unwrap()).collect::<Vec<_>>()), "{story}");
        let refused = &commands["refused"]["Farhad"]["NOT_HOLDER"];
        let waited = run != "preempted" && reached.len() > 1;
        assert!(!waited || refused.as_u64().unwrap() > 10, "{run}: Farhad commands while he waits: {commands}");
    }
    assert!(result["runs"]["preempted"]["stop"]["commands"].as_u64().is_none_or(|commands| commands == 0), "{line}");
    assert!(result["runs"]["delayed"]["feedback_ms"]["p50"].as_f64().unwrap() > 250.0, "{line}");

    for name in ["overview", "trajectory", "orientation", "frequency", "latency", "latency-frequency"] {
        assert!(std::fs::read_to_string(out.join(format!("{name}.svg"))).unwrap().contains("</svg>"), "{name}.svg");
    }
    assert!(std::fs::read_to_string(out.join("index.html")).unwrap().contains("const runs = [{"));
    assert_eq!(std::fs::read_to_string(out.join("numbers.json")).unwrap(), line.trim_end());
    assert!(!story.contains('\x1b'), "nobody sees a moving line in a file:\n{story}");
}

#[test]
fn an_interrupted_arena_leaves_no_process_and_no_file() {
    if !network::isolated(&|| ()) {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let (out, temporary) = (directory.path().join("arena"), directory.path().join("tmp"));
    std::fs::create_dir(&temporary).unwrap();
    let mut played =
        arena(&["--out", out.to_str().unwrap()]).env("TMPDIR", &temporary).stderr(Stdio::piped()).spawn().unwrap();
    let is_empty = |path: &Path| std::fs::read_dir(path).unwrap().next().is_none();
    let mut story = std::io::BufRead::lines(std::io::BufReader::new(played.stderr.take().unwrap()));
    let driving = story.by_ref().map(Result::unwrap).any(|line| line.contains("Salma's task"));
    assert!(driving && !is_empty(&temporary), "the bridges run");
    let pid = rustix::process::Pid::from_raw(i32::try_from(played.id()).unwrap()).unwrap();
    rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
    assert!(!played.wait().unwrap().success());
    let gone = || processes_below(&temporary).is_empty() && is_empty(&temporary) && !out.exists();
    wait::eventually("all processes and files are gone", || gone().then_some(()));
}

/// The processes that have this directory in their arguments.
fn processes_below(directory: &Path) -> Vec<String> {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let called = processes.filter_map(|process| std::fs::read_to_string(process.path().join("cmdline")).ok());
    called.filter(|line| line.contains(directory.to_str().unwrap()) && line.contains("--config")).collect()
}
