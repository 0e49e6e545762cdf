//! Where the programs are that a test starts.

use std::env::{consts::EXE_SUFFIX, current_exe};
use std::path::PathBuf;

/// The directory of the profile that this test was built with, such as `target/tests`.
///
/// # Panics
/// If the test binary is not where Cargo puts it.
pub fn profile() -> PathBuf {
    let this = current_exe().unwrap_or_else(|error| panic!("the test binary has no path: {error}"));
    // target/PROFILE/deps/NAME-HASH
    let profile = this.ancestors().nth(2).map(PathBuf::from);
    profile.unwrap_or_else(|| panic!("{} is not in the directory of a profile", this.display()))
}

/// A program of this workspace, built with the same profile. A test of another package than the program's does not build it;
/// `./test` builds all programs before it runs tests.
///
/// # Panics
/// If it was not built.
pub fn program(name: &str) -> PathBuf {
    let directory = profile();
    let program = directory.join(format!("{name}{EXE_SUFFIX}"));
    let wanted = match directory.file_name().and_then(|name| name.to_str()) {
        Some("debug") | None => "dev",
        Some(name) => name,
    };
    assert!(
        program.is_file(),
        "{} is not there\n  wanted  the programs of this workspace, built with the profile of this test\n  try     \
         cargo build --workspace --bins --profile {wanted}, or ./test, which does it",
        program.display()
    );
    program
}

/// A directory for what tests build, which the next run finds again: `target/tmp`.
///
/// # Panics
/// If it cannot be made.
pub fn scratch() -> PathBuf {
    let profile = profile();
    let directory = profile.parent().unwrap_or(&profile).join("tmp");
    std::fs::create_dir_all(&directory).unwrap_or_else(|error| panic!("{}: {error}", directory.display()));
    directory
}
