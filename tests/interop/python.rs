//! Python processes with CycloneDDS, the software on the other side that we did not write.

use std::{
    env,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, channel},
    time::Duration,
};

/// CycloneDDS on a loopback without multicast.
pub(crate) const CYCLONE: &str = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/>\
    </Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>\
    <MaxAutoParticipantIndex>11</MaxAutoParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>\
    </Domain></CycloneDDS>";

/// A Python process with CycloneDDS; ends with the test.
pub(crate) struct Python {
    /// The running interpreter.
    pub(crate) child: Child,
    lines: Receiver<String>,
}

impl Python {
    /// Starts a script of this directory. The interpreter is `LEDGERD_TEST_PYTHON` or `python3`; it must have the
    /// package `cyclonedds`.
    pub(crate) fn start(script: &str, args: &[&str]) -> Self {
        Self::start_within(&[], CYCLONE, script, args)
    }

    /// The same by another command, such as `nsenter`, and with that configuration of CycloneDDS.
    pub(crate) fn start_within(by: &[&str], cyclone: &str, script: &str, args: &[&str]) -> Self {
        let python = env::var_os("LEDGERD_TEST_PYTHON").unwrap_or_else(|| "python3".into());
        let script = Path::new(env!("CARGO_MANIFEST_DIR"))
            .ancestors()
            .map(|directory| directory.join("tests/interop").join(script))
            .find(|script| script.exists())
            .expect("the script is in tests/interop");
        // `env` alone runs the interpreter.
        let mut child = Command::new(by.first().unwrap_or(&"env"))
            .args(by.get(1..).unwrap_or_default())
            .arg(&python)
            .arg(script)
            .args(args)
            .env("CYCLONEDDS_URI", cyclone)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{python:?} does not start: {error}; set LEDGERD_TEST_PYTHON"));
        let output = BufReader::new(child.stdout.take().expect("stdout is piped"));
        // Read all the time: a script that fills its pipe would stand still.
        let (sender, lines) = channel();
        std::thread::spawn(move || output.lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
        Self { child, lines }
    }

    /// The next line that the script prints, or `None` at its end. Blocks for at most a minute.
    pub(crate) fn line(&mut self) -> Option<String> {
        self.lines.recv_timeout(Duration::from_secs(60)).ok()
    }

    /// Waits for the end of the script and returns whether it succeeded.
    pub(crate) fn finish(mut self) -> bool {
        self.child.wait().expect("the script ends").success()
    }
}

impl Drop for Python {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
