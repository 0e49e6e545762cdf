//! Python processes with CycloneDDS or zenoh, the software on the other side that we did not write.

use std::{
    env,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, channel},
    time::Duration,
};

/// CycloneDDS on a loopback without multicast.
pub const CYCLONE: &str = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/>\
    </Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>\
    <MaxAutoParticipantIndex>11</MaxAutoParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>\
    </Domain></CycloneDDS>";

/// Set to `zenoh`, it runs tests of a bridge over zenoh: scripts and programs are others, the tests are the same.
pub const TRANSPORT: &str = "LEDGERD_TEST_TRANSPORT";

/// Do the tests of a bridge run over zenoh?
pub fn is_zenoh() -> bool {
    env::var(TRANSPORT).is_ok_and(|transport| transport == "zenoh")
}

/// A Python process with CycloneDDS, or with zenoh; ends with the test.
pub struct Python {
    /// The running interpreter.
    pub child: Child,
    lines: Receiver<String>,
}

impl Python {
    /// Starts a script of this directory. The interpreter is `LEDGERD_TEST_PYTHON` or `python3`; it must have the
    /// package `cyclonedds`.
    pub fn start(script: &str, args: &[&str]) -> Self {
        Self::start_within(&[], CYCLONE, script, args)
    }

    /// The same by another command, such as `nsenter`, and with that configuration of CycloneDDS.
    pub fn start_within(by: &[&str], cyclone: &str, script: &str, args: &[&str]) -> Self {
        let python = env::var_os("LEDGERD_TEST_PYTHON").unwrap_or_else(|| "python3".into());
        // `env` alone runs the interpreter.
        let mut command = Command::new(by.first().unwrap_or(&"env"));
        command.args(by.get(1..).unwrap_or_default()).arg(&python).arg(peer(script)).args(args);
        command.env("CYCLONEDDS_URI", cyclone);
        Self::run(command)
    }

    /// Starts any program, and takes the lines that it prints.
    pub fn run(mut command: Command) -> Self {
        let child = command.stdout(Stdio::piped()).spawn();
        let mut child =
            child.unwrap_or_else(|error| panic!("{command:?} does not start: {error}; set LEDGERD_TEST_PYTHON"));
        let output = BufReader::new(child.stdout.take().expect("stdout is piped"));
        // Read all the time: a script that fills its pipe would stand still.
        let (sender, lines) = channel();
        std::thread::spawn(move || output.lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
        Self { child, lines }
    }

    /// The next line that the script prints, or `None` at its end. Blocks for at most a minute.
    pub fn line(&mut self) -> Option<String> {
        self.lines.recv_timeout(Duration::from_secs(60)).ok()
    }

    /// A line that the script has printed already.
    pub fn try_line(&mut self) -> Option<String> {
        self.lines.try_recv().ok()
    }

    /// Waits for the end of the script and returns whether it succeeded.
    pub fn finish(mut self) -> bool {
        self.child.wait().expect("the script ends").success()
    }
}

/// The script of this name: that in `rmw_zenoh` where tests run over zenoh.
fn peer(script: &str) -> PathBuf {
    if is_zenoh() { source(&format!("rmw_zenoh/{script}")) } else { source(script) }
}

/// A file of this directory, for a test of any package.
pub fn source(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .map(|directory| directory.join("tests/interop").join(name))
        .find(|path| path.exists())
        .expect("the file is in tests/interop")
}

impl Drop for Python {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
