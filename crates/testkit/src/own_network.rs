//! A network of its own for a test: only `lo`, no multicast, no neighbours; and shared memory of its own.
//!
//! DDS talks to everything that it finds, and a test of partitions needs routes to cut. So such a test runs itself again,
//! in new namespaces for network and mounts, and reports what happened there. Fast DDS and iceoryx2 would otherwise meet
//! the other tests in shared memory. Needs `unshare`, `mount` (util-linux) and `ip` (iproute2).
//!
//! ```ignore
//! #[test]
//! fn samples_arrive() {
//!     if !network::isolated(&|| ()) { return; }
//!     // from here on we are alone
//! }
//! ```

use std::{
    any::type_name,
    env,
    process::{Command, Stdio},
};

/// Brings up the network and hides the shared memory of others; then becomes the command that follows.
const ALONE: &str = "mount -t tmpfs tmpfs /dev/shm && mkdir -p /tmp/ledgerd-test-session \
    && mount -t tmpfs -o mode=700 tmpfs /tmp/ledgerd-test-session && export XDG_RUNTIME_DIR=/tmp/ledgerd-test-session \
    && ip link set lo up && exec \"$0\" \"$@\"";
/// Set inside the namespace to the name of the test.
const INSIDE: &str = "LEDGERD_TEST_NAMESPACE";

/// Runs the test that `_here` is a closure of again, in a network of its own, and passes its failure on. Returns `true`
/// inside, where the test goes on, and `false` outside, where it is done.
///
/// # Panics
/// If the test fails there, or if anything else than this one test ran.
pub fn isolated<Here>(_here: &Here) -> bool {
    let name = test_of(type_name::<Here>());
    if env::var_os(INSIDE).is_some_and(|inside| inside == name) {
        return true;
    }
    let namespaces = if runs(&["-mn", "true"]) { "-mn" } else { "-rmn" };
    assert!(
        runs(&[namespaces, "sh", "-c", ALONE, "true"]),
        "this test needs namespaces for network and mounts: run it as root or allow user namespaces, with `ip` of iproute2"
    );
    let done = Command::new("unshare")
        .args([namespaces, "sh", "-c", ALONE])
        .arg(env::current_exe().expect("the test binary has a path"))
        .args(["--exact", name, "--nocapture", "--test-threads=1"])
        .env(INSIDE, name)
        .stderr(Stdio::inherit())
        .output()
        .expect("unshare starts");
    let told = String::from_utf8_lossy(&done.stdout);
    println!("{told}");
    assert!(done.status.success(), "{name} failed in its own network: {}", done.status);
    assert!(ran_one(&told), "wanted one test, {name}, to run in its own network");
    false
}

/// The full name of the test in this binary whose closure has this type. It is without the crate before it, and without
/// the closures after it (a test that is `async` is a closure itself).
fn test_of(closure: &str) -> &str {
    let test = closure.split("::{{closure}}").next().unwrap_or(closure);
    test.split_once("::").map_or(test, |(_, name)| name)
}

/// Has the test binary run exactly one test, which passed?
fn ran_one(told: &str) -> bool {
    told.lines().any(|line| line.starts_with("test result: ok. 1 passed; 0 failed; 0 ignored"))
}

fn runs(args: &[&str]) -> bool {
    Command::new("unshare").args(args).stderr(Stdio::null()).status().is_ok_and(|status| status.success())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_running_test_is_named_by_its_closure() {
        let name = test_of(std::any::type_name_of_val(&|| ()));
        assert!(name.ends_with("::tests::the_running_test_is_named_by_its_closure"), "{name}");
        assert_eq!(test_of("node::three::a_leader_dies::{{closure}}::{{closure}}"), "three::a_leader_dies");
    }

    #[test]
    fn a_run_of_no_test_or_of_two_is_not_taken_for_one() {
        let summary = |passed| format!("running\n\ntest result: ok. {passed} passed; 0 failed; 0 ignored; 0 measured");
        assert!(ran_one(&summary(1)));
        assert!(!ran_one(&summary(0)) && !ran_one(&summary(2)) && !ran_one(&summary(11)) && !ran_one(""));
    }
}
