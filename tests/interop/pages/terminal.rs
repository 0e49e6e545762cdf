//! Types the commands of a page and compares what they print.

use super::readings::Reading;
use crate::python::CYCLONE;
use crate::support::programs;
use crate::support::wait::{PATIENCE, eventually};
use rustix::process::{Pid, Signal, kill_process};
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Commands that run until somebody ends them, each in a terminal of its own. So do those with `&` at their end.
const LASTING: [&str; 5] = ["ledgerd dev", "ledgerd run", "ledgerd bridge", "ledgerd lab", "ros2 topic pub"];
/// Given to the test, which has programs already.
const BUILD: &str = "cargo build --release && export PATH=";
/// Words that stand for a span together with the number before them.
const UNITS: [&str; 8] = ["µs", "ms", "s", "s)", "min", "min)", "h", "days"];
/// Exit code of `ledgerctl` where nobody answers: a person who has just started a node types the line again.
const NOBODY_ANSWERS: i32 = 4;
/// Between two tries.
const PAUSE: Duration = Duration::from_millis(200);
/// A shell knows its directory, variables and functions when a line begins, and keeps them when it ends.
const BEGIN: &str = r#"exec 2>&1; [ ! -f "$STATE" ] || . "$STATE""#;
const END: &str = r#"code=$?; { export -p; declare -f; printf 'cd %q\n' "$PWD"; } > "$STATE"; exit $code"#;

/// A person's machine: a home directory, the programs, and what the page calls its values.
pub(super) struct Terminal {
    // First: it ends before its files go.
    running: Vec<Running>,
    directory: TempDir,
    reading: &'static Reading,
    /// Words of the page that are others on this machine.
    values: BTreeMap<String, String>,
    /// Everything that was printed, with single spaces.
    printed: String,
    /// Where a program printed something else than the page.
    faults: Vec<String>,
}

/// A command in a terminal of its own, with everything that it started.
struct Running {
    line: String,
    child: Child,
    log: std::path::PathBuf,
}

impl Drop for Running {
    fn drop(&mut self) {
        // In order, so that a network ends its own nodes.
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            if let Some(id) = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw) {
                let _asked = kill_process(id, Signal::TERM);
            }
            let end = Instant::now() + PATIENCE;
            while Instant::now() < end && self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
                std::thread::sleep(PAUSE / 10);
            }
        }
        let _gone = self.child.kill();
        let _reaped = self.child.wait();
    }
}

impl Terminal {
    /// An empty home with the files that the page shows, and a stand-in for `ros2`.
    pub(super) fn open(reading: &'static Reading, files: &[(String, String)]) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let programs = directory.path().join("bin");
        fs::create_dir(&programs).unwrap();
        let python = std::env::var("LEDGERD_TEST_PYTHON").unwrap_or_else(|_| "python3".to_owned());
        let script = programs::repository().join("tests/interop/ros2.py");
        let ros2 = programs.join("ros2");
        fs::write(&ros2, format!("#!/bin/sh\nexec {python} {} \"$@\"\n", script.display())).unwrap();
        fs::set_permissions(&ros2, fs::Permissions::from_mode(0o755)).unwrap();
        let terminal = Self {
            directory,
            reading,
            values: BTreeMap::new(),
            printed: String::new(),
            faults: Vec::new(),
            running: Vec::new(),
        };
        files.iter().for_each(|(name, text)| terminal.file(name, text));
        terminal
    }

    /// Writes a file in the home directory.
    pub(super) fn file(&self, name: &str, text: &str) {
        fs::write(self.directory.path().join(name), text).unwrap();
    }

    /// Types a line that the page takes for granted. It must succeed.
    pub(super) fn given(&mut self, line: &str) {
        self.run(line, &[]);
    }

    /// Fails with all differences between the page and the programs.
    pub(super) fn check(&self) {
        assert!(self.faults.is_empty(), "{}\n{}", self.faults.join("\n"), self.logs());
    }

    /// Types a line of the page and compares what it prints.
    pub(super) fn run(&mut self, command: &str, printed: &[String]) {
        if command.starts_with(BUILD) || command.trim_start().starts_with('#') {
            return;
        }
        let real = self.real(command);
        let page = self.reading.page;
        let program = real.trim_end().trim_end_matches('&').trim_end();
        let out = match () {
            () if self.reading.until_interrupted.iter().any(|begin| command.starts_with(begin)) => {
                self.interrupt(program, printed)
            }
            () if self.lasts(command) => self.serve(program, printed),
            () => {
                let (status, out) = self.finish(&real);
                assert!(status.success(), "{page}\n$ {real}\n{status}: {out}\n{}", self.logs());
                out
            }
        };
        self.printed.push_str(&out.split_whitespace().collect::<Vec<_>>().join(" "));
        self.printed.push('\n');
        if let Err(fault) = self.compare(printed, &out) {
            let said = printed.join("\n");
            self.faults
                .push(format!("{page}\n$ {real}\n{fault}\n--- it printed:\n{out}\n--- the page says:\n{said}\n"));
        }
    }

    /// The line with the words of this machine.
    fn real(&self, command: &str) -> String {
        let mut real = command.to_owned();
        for (shown, value) in self.reading.words {
            real = real.replace(shown, value);
        }
        for (word, behind) in self.reading.captures.iter().filter(|(word, _)| command.contains(word)) {
            let found = self.printed.rsplit_once(behind).and_then(|(_, rest)| rest.split_whitespace().next());
            let found = found.unwrap_or_else(|| panic!("nothing printed {behind:?}:\n{}", self.printed));
            real = real.replace(word, found);
        }
        for (shown, value) in &self.values {
            real = real.replace(shown, value);
        }
        real
    }

    fn lasts(&self, command: &str) -> bool {
        let program = command.split(' ').skip_while(|word| word.contains('=')).collect::<Vec<_>>().join(" ");
        let is_known = LASTING.iter().any(|lasting| program.starts_with(lasting));
        is_known || command.ends_with(" &")
    }

    /// Starts a command and ends it by Ctrl-C once it listens for that. It must end in order; all that it has printed.
    fn interrupt(&mut self, real: &str, printed: &[String]) -> String {
        self.serve(real, printed);
        let mut running = self.running.pop().unwrap();
        eventually(&format!("{real} listens for Ctrl-C"), || {
            let ended = running.child.try_wait().unwrap();
            assert!(ended.is_none(), "{real} ended: {}", fs::read_to_string(&running.log).unwrap_or_default());
            catches_interrupts(running.child.id()).then_some(())
        });
        let id = i32::try_from(running.child.id()).ok().and_then(Pid::from_raw).unwrap();
        kill_process(id, Signal::INT).unwrap();
        let status = eventually(&format!("{real} ends"), || running.child.try_wait().unwrap());
        let out = fs::read_to_string(&running.log).unwrap_or_default();
        assert!(status.success(), "{real} ended by Ctrl-C with {status}: {out}");
        out
    }

    /// Types a line, again while nobody answers, and waits for its end.
    fn finish(&mut self, real: &str) -> (ExitStatus, String) {
        let end = Instant::now() + PATIENCE;
        loop {
            let done = self.shell(&format!("{BEGIN}\n{real}\n{END}")).output().unwrap();
            let out = String::from_utf8(done.stdout).unwrap();
            if done.status.code() != Some(NOBODY_ANSWERS) || Instant::now() > end {
                return (done.status, out);
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// Starts a command and waits until it has printed as much as the page shows, or that it is ready.
    fn serve(&mut self, real: &str, printed: &[String]) -> String {
        let log = self.directory.path().join(format!("terminal{}.log", self.running.len()));
        // The program in the place of the shell: ending the one ends the other.
        let mut command = self.shell(&format!("{BEGIN}\nexec env {real}"));
        command.stdout(fs::File::create(&log).unwrap());
        let child = command.spawn().unwrap();
        self.running.push(Running { line: real.to_owned(), child, log: log.clone() });
        let shown = printed.iter().rfind(|line| !line.trim().is_empty() && *line != "…").cloned().unwrap_or_default();
        eventually(&format!("{real} prints {shown:?}"), || {
            let ended = self.running.last_mut().unwrap().child.try_wait().unwrap();
            let out = fs::read_to_string(&log).unwrap_or_default();
            assert!(ended.is_none(), "{real} ended: {out}");
            let is_there = match shown.as_str() {
                "" => !real.starts_with("ledgerd ") || out.contains("ready"),
                shown => out.lines().any(|line| alike(shown, line).is_some()),
            };
            is_there.then_some(out)
        })
    }

    /// Nothing that goes on has failed meanwhile.
    pub(super) fn check_lasting(&mut self) {
        for running in &mut self.running {
            let ended = running.child.try_wait().unwrap();
            let log = fs::read_to_string(&running.log).unwrap_or_default();
            assert!(ended.is_none_or(|status| status.success()), "{} ended: {log}", running.line);
        }
    }

    /// The output of commands that go on, for a test that fails.
    fn logs(&self) -> String {
        let log = |running: &Running| {
            format!("--- {}:\n{}", running.line, fs::read_to_string(&running.log).unwrap_or_default())
        };
        self.running.iter().map(log).collect()
    }

    /// A shell whose output is both of a command's.
    fn shell(&self, script: &str) -> Command {
        let mut command = Command::new("bash");
        let ledgerd = programs::ledgerd();
        let ledgerctl = programs::ledgerctl();
        let directories = [self.directory.path().join("bin"), dir(ledgerd), dir(ledgerctl)];
        let path = std::env::join_paths(
            directories.into_iter().chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
        );
        command.args(["-c", script]).current_dir(self.directory.path()).stdin(Stdio::null());
        command.env("PATH", path.unwrap()).env("HOME", self.directory.path()).env("TZ", "UTC");
        command.env("CYCLONEDDS_URI", CYCLONE).env("TMPDIR", self.directory.path());
        command.env("STATE", self.directory.path().join("state"));
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
/// Has the process a handler for SIGINT? Its bit is the second of the mask that the kernel shows.
fn catches_interrupts(process: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 2 != 0)
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
        if shown == real || shown == "…" || (UNITS.contains(&shown) && UNITS.contains(&real)) {
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
    if let Some((variable, value)) = word.split_once('=').filter(|(_, value)| value.starts_with('/')) {
        return format!("{variable}={}", form(value));
    }
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
