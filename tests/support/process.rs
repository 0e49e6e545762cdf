//! A child process with its output in files, killed by its id at the end.

use super::wait::eventually;
use rustix::process::{Pid, Signal, kill_process};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};

/// A running program. Dropping it kills it.
pub struct Process {
    name: String,
    child: Child,
    stdout: PathBuf,
    stderr: PathBuf,
}

impl Process {
    /// Starts the command; its output goes to `<name>.out` and `<name>.err` in a directory.
    pub fn start(name: &str, logs: &Path, mut command: Command) -> Self {
        let (stdout, stderr) = (logs.join(format!("{name}.out")), logs.join(format!("{name}.err")));
        let append = |path: &Path| File::options().create(true).append(true).open(path).expect("a log file");
        // What an earlier process of this name printed is not this one's.
        let _none = std::fs::remove_file(&stdout);
        let child = command
            .stdin(Stdio::null())
            .stdout(append(&stdout))
            .stderr(append(&stderr))
            .spawn()
            .unwrap_or_else(|error| panic!("cannot start {name}: {error}"));
        Self { name: name.to_owned(), child, stdout, stderr }
    }

    /// The id of the process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Its output on standard output.
    pub fn stdout(&self) -> String {
        std::fs::read_to_string(&self.stdout).unwrap_or_default()
    }

    /// Its output, and that of processes of its name before it, on standard error.
    pub fn stderr(&self) -> String {
        std::fs::read_to_string(&self.stderr).unwrap_or_default()
    }

    /// Is it still running?
    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().expect("the process can be watched").is_none()
    }

    /// Fails the test if the process has ended by itself.
    pub fn check(&mut self) {
        assert!(self.is_running(), "{} ended by itself:\n{}", self.name, self.stderr());
    }

    /// The first line on standard output.
    pub fn first_line(&mut self) -> String {
        let name = self.name.clone();
        eventually(&format!("{name} prints a line"), || {
            self.check();
            let text = self.stdout();
            text.split_once('\n').map(|(line, _)| line.to_owned())
        })
    }

    /// `kill -9`, and waits until it is gone.
    pub fn kill(&mut self) {
        let _gone = self.child.kill();
        self.child.wait().expect("a killed process ends");
    }

    /// Sends a signal.
    pub fn send(&self, signal: Signal) {
        let id = i32::try_from(self.id()).ok().and_then(Pid::from_raw).expect("a process id");
        kill_process(id, signal).expect("the signal can be sent");
    }

    /// Sends a signal and waits for the process to end.
    pub fn signal(&mut self, signal: Signal) -> ExitStatus {
        self.send(signal);
        self.wait()
    }

    /// Waits until it has ended.
    pub fn wait(&mut self) -> ExitStatus {
        let name = self.name.clone();
        eventually(&format!("{name} ends"), || self.child.try_wait().expect("the process can be watched"))
    }

    /// Ctrl-C; it must end in order.
    pub fn interrupt(&mut self) {
        let status = self.signal(Signal::INT);
        assert!(status.success(), "{} after Ctrl-C: {status}\n{}", self.name, self.stderr());
        self.no_panic();
    }

    /// After anything that happened: nothing has panicked.
    pub fn no_panic(&self) {
        let log = self.stderr();
        assert!(!log.contains("panicked"), "{} panicked:\n{log}", self.name);
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            let _gone = self.child.kill();
            let _reaped = self.child.wait();
        }
        if std::thread::panicking() {
            eprintln!("--- {} said:\n{}", self.name, self.stderr());
        }
    }
}
