//! A network of its own for a bench: only `lo`, no multicast, no neighbours. DDS talks to everything that it finds.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use std::env;
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};

/// Set inside.
const INSIDE: &str = "LEDGERD_BENCH_NAMESPACE";

/// Puts this program, started again with the same arguments, into a network of its own. True once it is there; false if
/// the machine does not allow it. Needs `unshare` (util-linux) and `ip` (iproute2).
pub(crate) fn enter() -> bool {
    if is_own() {
        return true;
    }
    let namespace = if runs(&["-n", "true"]) { "-n" } else { "-rn" };
    if !runs(&[namespace, "ip", "link", "set", "lo", "up"]) {
        return false;
    }
    let failed = Command::new("unshare")
        .args([namespace, "sh", "-c", "ip link set lo up && exec \"$0\" \"$@\""])
        .arg(env::current_exe().unwrap())
        .args(env::args_os().skip(1))
        .env(INSIDE, "1")
        .exec();
    panic!("unshare does not start: {failed}");
}

/// Are we in a network of our own?
pub(crate) fn is_own() -> bool {
    env::var_os(INSIDE).is_some()
}

fn runs(args: &[&str]) -> bool {
    Command::new("unshare").args(args).stderr(Stdio::null()).status().is_ok_and(|status| status.success())
}
