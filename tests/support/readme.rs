//! Blocks of commands in documents, run as they stand.
//!
//! A line that begins with `$ ` is typed. Words in capitals stand for the output of an earlier command, always the
//! newest. `TOKEN` is the word of `ledgerctl network invite`, `FINGERPRINT` and `SECRET` stand behind
//! `--ca-fingerprint` and `--secret`, and `ID` behind `network approve`. A command with `&` goes on beside. A command
//! that finds nobody who answers (exit code 4) is typed again, as a person does who has just started a node.

use super::process::Process;
use super::programs;
use super::wait::PATIENCE;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

/// Exit code of `ledgerctl` where nobody answers.
const NOBODY_ANSWERS: i32 = 4;
/// Between two tries.
const PAUSE: Duration = Duration::from_millis(200);

/// The first block of commands in a section of a document.
pub fn console(document: &str, heading: &str) -> Vec<String> {
    let path = programs::repository().join(document);
    let text = std::fs::read_to_string(path).expect("the document");
    let section = text.split_once(&format!("\n{heading}\n")).unwrap_or_else(|| panic!("no section {heading:?}")).1;
    let block = section.split_once("```console\n").and_then(|(_, rest)| rest.split_once("\n```")).expect("a block").0;
    block.lines().filter_map(|line| line.strip_prefix("$ ")).map(str::to_owned).collect()
}

/// A terminal in a directory of its own.
pub struct Terminal {
    directory: PathBuf,
    /// Everything that was printed, for the words in capitals.
    printed: String,
    /// The processes beside, by their commands.
    pub beside: Vec<(String, Process)>,
}

impl Terminal {
    /// In this directory, with contexts below it.
    pub fn at(directory: &Path) -> Self {
        Self { directory: directory.to_owned(), printed: String::new(), beside: Vec::new() }
    }

    /// The home of the contexts.
    pub fn home(&self) -> PathBuf {
        self.directory.join("home")
    }

    /// Types a line; answers with what it printed. A command that fails fails the test.
    #[track_caller]
    pub fn type_line(&mut self, line: &str) -> String {
        let (code, text) = self.try_line(line);
        assert_eq!(code, 0, "{line}\n{text}");
        text
    }

    /// Types a line; answers with its exit code and all that it printed.
    pub fn try_line(&mut self, line: &str) -> (i32, String) {
        let line = line.split(" #").next().unwrap_or(line).trim();
        if let Some(command) = line.strip_suffix('&') {
            self.start(command.trim());
            return (0, String::new());
        }
        let deadline = Instant::now() + PATIENCE;
        loop {
            let done = self.run(line);
            let text = [done.stdout, done.stderr].map(|bytes| String::from_utf8(bytes).expect("text")).concat();
            let code = done.status.code().unwrap_or(-1);
            if code == NOBODY_ANSWERS && Instant::now() < deadline {
                std::thread::sleep(PAUSE);
                continue;
            }
            self.printed.push_str(&text);
            return (code, text);
        }
    }

    /// Types a line once; a node that cannot start says why.
    pub fn run(&self, line: &str) -> Output {
        self.command(line).output().unwrap_or_else(|error| panic!("{line}: {error}"))
    }

    /// Starts what goes on beside.
    pub fn start(&mut self, line: &str) {
        let name = format!("beside-{}", self.beside.len());
        let process = Process::start(&name, &self.directory, self.command(line));
        self.beside.push((line.to_owned(), process));
    }

    /// The process of a command, the newest.
    pub fn process(&mut self, line: &str) -> &mut Process {
        let found = self.beside.iter_mut().rev().find(|(command, _)| command == line);
        &mut found.unwrap_or_else(|| panic!("{line} was not started")).1
    }

    fn command(&self, line: &str) -> Command {
        let words: Vec<String> = line.split_whitespace().map(|word| self.word(word)).collect();
        let (program, arguments) = words.split_first().expect("a command");
        let mut command = Command::new(match program.as_str() {
            "ledgerd" => programs::ledgerd(),
            "ledgerctl" => programs::ledgerctl(),
            other => panic!("{other} is none of our programs"),
        });
        command.args(arguments).current_dir(&self.directory).env("LEDGERD_HOME", self.home());
        command.env_remove("LEDGERCTL_CONTEXT").env_remove("RUST_LOG").env("LEDGERD_LOG_FORMAT", "text");
        command
    }

    /// The value of a word in capitals.
    fn word(&self, word: &str) -> String {
        let after = |text: &str| {
            let found = self.printed.rsplit_once(text).and_then(|(_, rest)| rest.split_whitespace().next());
            found.unwrap_or_else(|| panic!("nothing printed {text:?}:\n{}", self.printed)).to_owned()
        };
        match word {
            "TOKEN" => after("ledgerd join "),
            "FINGERPRINT" => after("--ca-fingerprint "),
            "SECRET" => after("--secret "),
            "ID" => after("network approve "),
            word => word.to_owned(),
        }
    }
}

/// The commands that a text says to type next: its lines with nothing else on them.
pub fn next_commands(text: &str) -> Vec<String> {
    let lines =
        text.lines().map(str::trim).filter(|line| line.starts_with("ledgerd ") || line.starts_with("ledgerctl "));
    lines.map(str::to_owned).collect()
}
