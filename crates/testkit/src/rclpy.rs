//! A real ROS 2, for scripts of tests/ros: the one that is sourced, else rclpy with Fast DDS from PyPI, which `./test` installs.

use std::{env, ffi::OsString, process::Command};

use crate::python::{CYCLONE, Python, is_zenoh, source};

/// Names a Python that has rclpy.
const RCLPY: &str = "LEDGERD_TEST_RCLPY";

/// Is a ROS 2 sourced?
pub fn is_sourced() -> bool {
    env::var_os("ROS_DISTRO").is_some_and(|name| !name.is_empty())
}

/// The Python that has rclpy: none without a ROS 2.
pub fn interpreter(is_sourced: bool, named: Option<OsString>) -> Option<OsString> {
    if is_sourced { Some("python3".into()) } else { named.filter(|path| !path.is_empty()) }
}

/// The settings of a session of `rmw_zenoh_cpp`: the router carries everything.
const CLIENT: &str = "mode=\"client\";connect/endpoints=[\"tcp/127.0.0.1:7447\"];listen/endpoints=[]";

/// Does the ROS 2 that is sourced have `rmw_zenoh_cpp`?
fn has_rmw_zenoh() -> bool {
    let prefixes = env::var_os("AMENT_PREFIX_PATH").unwrap_or_default();
    env::split_paths(&prefixes).any(|prefix| prefix.join("lib/librmw_zenoh_cpp.so").exists())
}

/// Is there an rclpy? Otherwise it says why the test is skipped.
pub fn is_there() -> bool {
    if is_zenoh() && !has_rmw_zenoh() {
        println!("skipped: there is no rmw_zenoh_cpp. Source the setup of a ROS 2 that has it");
        return false;
    }
    let found = interpreter(is_sourced(), env::var_os(RCLPY));
    if found.is_none() {
        println!("skipped: there is no rclpy. Source the setup of a ROS 2, or let ./test install it and set {RCLPY}");
    }
    found.is_some()
}

/// Puts a program of ROS 2 into a domain of this host, whichever RMW it has.
pub fn in_domain(mut command: Command, domain: u16) -> Command {
    command.env("ROS_DOMAIN_ID", domain.to_string()).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    command.env("CYCLONEDDS_URI", CYCLONE);
    // Shared memory does not end at a network namespace: what killed processes left there would be found.
    command.env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4");
    if is_zenoh() {
        command.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp").env("ZENOH_CONFIG_OVERRIDE", CLIENT);
    }
    command
}

/// A script of tests/ros in a domain.
pub fn command(name: &str, domain: u16, args: &[&str]) -> Command {
    let mut command = Command::new(interpreter(is_sourced(), env::var_os(RCLPY)).unwrap_or_else(|| "python3".into()));
    command.arg(source(&format!("../ros/{name}"))).args(args);
    in_domain(command, domain)
}

/// Starts it.
pub fn script(name: &str, domain: u16, args: &[&str]) -> Python {
    Python::run(command(name, domain, args))
}
