//! A network of its own for a test: only `lo`, no multicast, no neighbours.
//!
//! DDS talks to everything that it finds. So a test that uses it runs itself again, in a new network namespace, and
//! reports what happened there. Needs `unshare` (util-linux) and `ip` (iproute2).
//!
//! ```ignore
//! #[test]
//! fn samples_arrive() {
//!     if !network::isolated("samples_arrive") { return; }
//!     // from here on we are alone
//! }
//! ```

use std::{
    env,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
};

/// Set inside the namespace to the name of the test.
const INSIDE: &str = "LEDGERD_TEST_NAMESPACE";
/// CycloneDDS on a loopback without multicast.
const CYCLONE: &str = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/>\
    </Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>\
    <MaxAutoParticipantIndex>11</MaxAutoParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>\
    </Domain></CycloneDDS>";

/// Runs the test `name` (its full path in this binary) again in a network of its own, and passes its failure on.
/// Returns `true` inside, where the test goes on, and `false` outside, where it is done.
pub fn isolated(name: &str) -> bool {
    if env::var_os(INSIDE).is_some_and(|inside| inside == name) {
        return true;
    }
    let namespace = if runs(&["-n", "true"]) { "-n" } else { "-rn" };
    assert!(
        runs(&[namespace, "ip", "link", "set", "lo", "up"]),
        "this test needs a network namespace: run it as root or allow user namespaces, with `ip` of iproute2"
    );
    let status = Command::new("unshare")
        .args([namespace, "sh", "-c", "ip link set lo up && exec \"$0\" \"$@\""])
        .arg(env::current_exe().expect("the test binary has a path"))
        .args(["--exact", name, "--nocapture", "--test-threads=1"])
        .env(INSIDE, name)
        .status()
        .expect("unshare starts");
    assert!(status.success(), "{name} failed in its own network: {status}");
    false
}

/// A Python process with CycloneDDS; ends with the test.
pub struct Python {
    child: Child,
    output: BufReader<std::process::ChildStdout>,
}

impl Python {
    /// Starts a script of this directory. The interpreter is `LEDGERD_TEST_PYTHON` or `python3`; it must have the
    /// package `cyclonedds`.
    pub fn start(script: &str, args: &[&str]) -> Self {
        let python = env::var_os("LEDGERD_TEST_PYTHON").unwrap_or_else(|| "python3".into());
        let script = Path::new(env!("CARGO_MANIFEST_DIR"))
            .ancestors()
            .map(|directory| directory.join("tests/interop").join(script))
            .find(|script| script.exists())
            .expect("the script is in tests/interop");
        let mut child = Command::new(&python)
            .arg(script)
            .args(args)
            .env("CYCLONEDDS_URI", CYCLONE)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{python:?} does not start: {error}; set LEDGERD_TEST_PYTHON"));
        let output = BufReader::new(child.stdout.take().expect("stdout is piped"));
        Self { child, output }
    }

    /// The next line that the script prints, or `None` at its end.
    pub fn line(&mut self) -> Option<String> {
        let mut line = String::new();
        let read = self.output.read_line(&mut line).expect("the script prints text");
        (read > 0).then(|| line.trim_end().to_owned())
    }

    /// Waits for the end of the script and returns whether it succeeded.
    pub fn finish(mut self) -> bool {
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

fn runs(args: &[&str]) -> bool {
    Command::new("unshare").args(args).stderr(Stdio::null()).status().is_ok_and(|status| status.success())
}
