//! Where the programs are that the tests start.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// The node, built for this test.
pub fn ledgerd() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_ledgerd"))
}

/// The command line, which is another package's: `cargo test --workspace` puts it beside the node. Where somebody runs
/// this test alone, it is built once.
pub fn ledgerctl() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let program = ledgerd().with_file_name(format!("ledgerctl{}", std::env::consts::EXE_SUFFIX));
        if !program.is_file() {
            build(ledgerd().parent().expect("a directory of the profile"));
        }
        assert!(program.is_file(), "cargo build -p ledgerctl has made no {}", program.display());
        program
    })
}

/// Builds `ledgerctl` into the directory of a profile (`target/debug`, `target/release`).
fn build(profile: &Path) {
    let mut cargo = Command::new(env!("CARGO"));
    // Together with the node: the same features of what both use, so that nothing is built twice.
    cargo.args(["build", "--package", "ledgerctl", "--package", "ledgerd", "--manifest-path"]);
    cargo.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml"));
    cargo.arg("--target-dir").arg(profile.parent().expect("a target directory"));
    match profile.file_name().and_then(|name| name.to_str()) {
        Some("debug") | None => {}
        Some(profile) => {
            cargo.args(["--profile", profile]);
        }
    }
    let status = cargo.status().expect("cargo can be started");
    assert!(status.success(), "cargo build -p ledgerctl: {status}");
}
