//! One run of `ledgerctl`, as a user on a machine of their own, and of `ledgerd verify`, as an auditor.

use super::{eventually, programs};
use serde_json::Value;
use std::ffi::OsStr;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The code of a transaction that came too late.
const EXPIRED: &str = "LGR-1006";

/// A machine: a home directory for contexts.
#[derive(Clone)]
pub struct Ctl {
    home: PathBuf,
    context: Option<String>,
}

/// The output of one run.
#[derive(Debug)]
pub struct Ran {
    /// Its standard output.
    pub stdout: String,
    /// Its standard error.
    pub stderr: String,
    /// Its exit code, or -1 after a signal.
    pub code: i32,
    line: String,
}

impl Ctl {
    /// A user whose contexts are in this directory.
    pub fn at(home: &Path) -> Self {
        Self { home: home.to_owned(), context: None }
    }

    /// The same, acting as this context.
    pub fn as_(&self, context: &str) -> Self {
        Self { context: Some(context.to_owned()), ..self.clone() }
    }

    /// The command, not started yet.
    pub fn command<S: AsRef<OsStr>>(&self, arguments: &[S]) -> Command {
        let mut command = Command::new(programs::ledgerctl());
        command.env("LEDGERD_HOME", &self.home).env_remove("LEDGERCTL_CONTEXT").env_remove("RUST_LOG");
        if let Some(context) = &self.context {
            command.args(["--context", context]);
        }
        command.args(arguments);
        command
    }

    /// Runs it with an empty standard input.
    pub fn run<S: AsRef<OsStr>>(&self, arguments: &[S]) -> Ran {
        self.run_with(arguments, b"")
    }

    /// Runs it with this standard input.
    pub fn run_with<S: AsRef<OsStr>>(&self, arguments: &[S], input: &[u8]) -> Ran {
        let words: Vec<_> = arguments.iter().map(|word| word.as_ref().to_string_lossy()).collect();
        let line = format!("ledgerctl --context {:?} {}", self.context, words.join(" "));
        run(self.command(arguments), line, input)
    }

    /// Runs `publish`, again as long as the command has ended on its way: on a machine that stalls, it is older than it may be.
    pub fn publish(&self, words: &[&str]) -> Ran {
        self.publish_with(words, b"")
    }

    /// The same with this standard input.
    pub fn publish_with(&self, words: &[&str], input: &[u8]) -> Ran {
        let line = [&["publish"], words].concat();
        eventually("a command comes in time", || {
            let ran = self.run_with(&line, input);
            (!ran.stderr.contains(EXPIRED)).then_some(ran)
        })
    }

    /// Runs it with `-o json`; it must succeed with one value on standard output.
    pub fn json<S: AsRef<OsStr>>(&self, arguments: &[S]) -> Value {
        let mut words: Vec<&OsStr> = arguments.iter().map(AsRef::as_ref).collect();
        words.extend([OsStr::new("-o"), OsStr::new("json")]);
        self.run(&words).ok().json()
    }
}

/// `ledgerd verify DIR --json`, as an auditor runs it.
pub fn verify(directory: &Path) -> Ran {
    let mut command = programs::node();
    command.arg("verify").arg(directory).arg("--json");
    run(command, format!("ledgerd verify {}", directory.display()), b"")
}

fn run(mut command: Command, line: String, input: &[u8]) -> Ran {
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap_or_else(|error| panic!("{line}: {error}"));
    // It may end without reading.
    let _closed = child.stdin.take().expect("a pipe").write_all(input);
    let done = child.wait_with_output().expect("the program ends");
    Ran {
        stdout: String::from_utf8(done.stdout).expect("text"),
        stderr: String::from_utf8(done.stderr).expect("text"),
        code: done.status.code().unwrap_or(-1),
        line,
    }
}

impl Ran {
    /// It succeeded.
    #[track_caller]
    pub fn ok(self) -> Self {
        assert_eq!(self.code, 0, "{self:?}");
        self
    }

    /// It failed with this exit code, and its report has the code and all these words.
    #[track_caller]
    pub fn refused(self, exit: i32, words: &[&str]) -> Self {
        assert_eq!(self.code, exit, "{self:?}");
        for word in words {
            assert!(self.stderr.contains(word), "{word:?} is missing in: {self:?}");
        }
        assert!(!self.stderr.contains("panicked"), "{self:?}");
        self
    }

    /// Standard output as one JSON value.
    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("{}: {error}: {self:?}", self.line))
    }
}
