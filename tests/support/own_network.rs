//! A network of its own for a test: only `lo`, no multicast, no neighbours.
//!
//! DDS talks to everything that it finds, and who tests partitions needs routes to cut. So such a test runs itself
//! again, in a new network namespace, and reports what happened there. Needs `unshare` (util-linux) and `ip` (iproute2).
//!
//! ```ignore
//! #[test]
//! fn samples_arrive() {
//!     if !network::isolated("samples_arrive") { return; }
//!     // from here on we are alone
//! }
//! ```

#![expect(clippy::expect_used, reason = "a test without its network has failed")]

use std::{
    env,
    process::{Command, Stdio},
};

/// Set inside the namespace to the name of the test.
const INSIDE: &str = "LEDGERD_TEST_NAMESPACE";

/// Runs the test `name` (its full path in this binary) again in a network of its own, and passes its failure on.
/// Returns `true` inside, where the test goes on, and `false` outside, where it is done.
pub(crate) fn isolated(name: &str) -> bool {
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

fn runs(args: &[&str]) -> bool {
    Command::new("unshare").args(args).stderr(Stdio::null()).status().is_ok_and(|status| status.success())
}
