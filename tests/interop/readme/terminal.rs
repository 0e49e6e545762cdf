//! Runs the commands of a page and compares what they print.

use crate::python::CYCLONE;
use crate::support::programs;
use crate::support::wait::eventually;
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use tempfile::TempDir;

/// Commands that run until somebody ends them, each in a terminal of its own.
const SERVICES: [&str; 4] = ["ledgerd dev", "ledgerd run", "ledgerd bridge", "ros2 topic pub"];
/// Given to the test, which has programs already.
const BUILD: &str = "cargo build --release && export PATH=";
/// Words that stand for a span together with the number before them.
const UNITS: [&str; 8] = ["µs", "ms", "s", "s)", "min", "min)", "h", "days"];

/// A person's machine: a home directory, the programs, and what the page calls its values.
pub(super) struct Terminal {
    directory: TempDir,
    /// Words of the page that are others on this machine.
    values: BTreeMap<String, String>,
    running: Vec<Running>,
}

/// A command in a terminal of its own, with everything that it started.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _reaped = self.0.wait();
    }
}

impl Terminal {
    /// An empty home with the files that the page shows, and a stand-in for `ros2`.
    pub(super) fn open(files: &[(String, String)]) -> Self {
        let directory = tempfile::tempdir().unwrap();
        for (name, text) in files {
            fs::write(directory.path().join(name), text).unwrap();
        }
        let programs = directory.path().join("bin");
        fs::create_dir(&programs).unwrap();
        let python = std::env::var("LEDGERD_TEST_PYTHON").unwrap_or_else(|_| "python3".to_owned());
        let script = programs::repository().join("tests/interop/ros2.py");
        let ros2 = programs.join("ros2");
        fs::write(&ros2, format!("#!/bin/sh\nexec {python} {} \"$@\"\n", script.display())).unwrap();
        fs::set_permissions(&ros2, fs::Permissions::from_mode(0o755)).unwrap();
        Self { directory, values: BTreeMap::new(), running: Vec::new() }
    }

    /// Runs a command and compares what it prints.
    pub(super) fn run(&mut self, command: &str, printed: &[String]) {
        if command.starts_with(BUILD) {
            return;
        }
        let mut real = command.to_owned();
        for (shown, value) in &self.values {
            real = real.replace(shown, value);
        }
        let program = real.split(' ').skip_while(|word| word.contains('=')).collect::<Vec<_>>().join(" ");
        let out = match SERVICES.iter().any(|service| program.starts_with(service)) {
            true => self.serve(&real, printed),
            false => {
                let done = self.shell(&real).output().unwrap();
                String::from_utf8(done.stdout).unwrap()
            }
        };
        if let Err(fault) = self.compare(printed, &out) {
            panic!("$ {real}\n{fault}\n--- it printed:\n{out}\n--- the page says:\n{}", printed.join("\n"));
        }
    }

    /// Starts a command and waits until it has printed as much as the page shows.
    fn serve(&mut self, real: &str, printed: &[String]) -> String {
        let log = self.directory.path().join(format!("terminal{}.log", self.running.len()));
        // The program in the place of the shell: ending the one ends the other.
        let mut command = self.shell(&format!("exec env {real}"));
        command.stdout(fs::File::create(&log).unwrap());
        self.running.push(Running(command.spawn().unwrap()));
        let shown = printed.iter().rfind(|line| !line.trim().is_empty() && *line != "…").cloned().unwrap_or_default();
        eventually(&format!("{real} prints {shown:?}"), || {
            let ended = self.running.last_mut().unwrap().0.try_wait().unwrap();
            let out = fs::read_to_string(&log).unwrap_or_default();
            assert!(ended.is_none(), "{real} ended: {out}");
            let is_there = shown.is_empty() || out.lines().any(|line| alike(&shown, line).is_some());
            is_there.then_some(out)
        })
    }

    /// A shell whose output is both of a command's.
    fn shell(&self, line: &str) -> Command {
        let mut command = Command::new("bash");
        let ledgerd = programs::ledgerd();
        let ledgerctl = programs::ledgerctl();
        let directories = [self.directory.path().join("bin"), dir(ledgerd), dir(ledgerctl)];
        let path = std::env::join_paths(
            directories.into_iter().chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
        );
        command.args(["-c", &format!("exec 2>&1; {line}")]).current_dir(self.directory.path()).stdin(Stdio::null());
        command.env("PATH", path.unwrap()).env("HOME", self.directory.path()).env("TZ", "UTC");
        command.env("CYCLONEDDS_URI", CYCLONE).env("TMPDIR", self.directory.path());
        for unwanted in ["LEDGERD_HOME", "LEDGERCTL_CONTEXT", "RUST_LOG", "ROS_DOMAIN_ID", "XDG_CONFIG_HOME"] {
            command.env_remove(unwanted);
        }
        // As for a person with a terminal.
        command.env("LEDGERD_LOG_FORMAT", "text");
        command
    }

    /// Compares and remembers which words are others here.
    fn compare(&mut self, printed: &[String], out: &str) -> Result<(), String> {
        let mut lines = out.lines().filter(|line| !is_log(line));
        let mut skips = false;
        for wanted in printed {
            if wanted == "…" {
                skips = true;
                continue;
            }
            let found = loop {
                let Some(line) = lines.next() else { return Err(format!("the page has this line more: {wanted}")) };
                match alike(wanted, line) {
                    Some(values) => break values,
                    None if skips => {}
                    None => return Err(format!("the page: {wanted}\nfound:    {line}")),
                }
            };
            skips = false;
            self.values.extend(found);
        }
        match lines.next() {
            Some(line) if !skips && !printed.is_empty() => Err(format!("the page lacks this line: {line}")),
            _ => Ok(()),
        }
    }
}

/// A line of a log says something about the machine, such as that its disk is nearly full.
fn is_log(line: &str) -> bool {
    let mut words = line.split_whitespace();
    let time = words.next().is_some_and(|word| word.starts_with("20") && word.ends_with('Z'));
    time && words.next().is_some_and(|level| matches!(level, "INFO" | "WARN" | "ERROR"))
}

fn dir(program: &Path) -> std::path::PathBuf {
    program.parent().unwrap().to_owned()
}

/// Do both lines say the same, apart from times, numbers and ids? Then the words that are long enough to be named again, and
/// what they are here.
fn alike(shown: &str, real: &str) -> Option<Vec<(String, String)>> {
    let (shown, real): (Vec<_>, Vec<_>) = (shown.split_whitespace().collect(), real.split_whitespace().collect());
    if shown.len() != real.len() {
        return None;
    }
    let mut values = Vec::new();
    for (shown, real) in shown.into_iter().zip(real) {
        if shown == real || (UNITS.contains(&shown) && UNITS.contains(&real)) {
            continue;
        }
        if form(shown) != form(real) {
            return None;
        }
        // Shorter ones are counts and times, which no command names.
        if shown.len() >= 16 {
            values.push((shown.to_owned(), real.to_owned()));
        }
    }
    Some(values)
}

/// The form of a word: digits of ids and numbers are all the same, and so are paths below a temporary directory.
fn form(word: &str) -> String {
    if word.starts_with("/tmp/") || word.starts_with("/home/") {
        return "a path".to_owned();
    }
    let hex = |part: &str| part.len() >= 16 && part.chars().all(|c| c.is_ascii_hexdigit());
    if hex(word) {
        return format!("an id of {}", word.len());
    }
    let mut form = String::new();
    for c in word.chars() {
        match c.is_ascii_digit() {
            true if form.ends_with('#') => {}
            true => form.push('#'),
            false => form.push(c),
        }
    }
    form
}

#[test]
fn lines_are_alike_if_only_times_and_ids_differ() {
    let id = |digit: &str| digit.repeat(64);
    let (shown, real) = (format!("CA fingerprint  {}", id("a")), format!("CA fingerprint   {}", id("7")));
    assert_eq!(alike(&shown, &real).unwrap(), [(id("a"), id("7"))]);
    assert!(
        alike("expires 2026-11-21 02:41:38 +00:00 (in 1 min)", "expires 2027-01-02 22:01:00 +00:00 (in 59 s)")
            .is_some()
    );
    assert!(alike("holder Org1/Salma", "holder Org1/Farhad").is_none());
    assert!(alike("block 4, epoch 1", "block 12, epoch 1").is_some());
    assert!(alike("x: 0.5", "y: 0.5").is_none());
}
