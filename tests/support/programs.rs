//! Where the programs are that the tests start.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

/// The node, built for this test. Where tests run over zenoh, it is the program that has it.
pub fn ledgerd() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    let name = if testkit::python::is_zenoh() { "ledgerd-bridge-zenoh" } else { "ledgerd" };
    PROGRAM.get_or_init(|| testkit::program(name))
}

/// A command of the node, whose log is text although no terminal is there, at the configured level.
pub fn node() -> Command {
    let mut command = Command::new(ledgerd());
    command.env("LEDGERD_LOG_FORMAT", "text").env_remove("RUST_LOG");
    command
}

/// The command line, built for this test.
pub fn ledgerctl() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| testkit::program("ledgerctl"))
}

/// The interpreter, with what the tests need, as `./test` prepares it.
pub fn python() -> PathBuf {
    std::env::var_os("LEDGERD_TEST_PYTHON").map_or_else(|| "python3".into(), PathBuf::from)
}

/// The top of the repository.
pub fn repository() -> &'static Path {
    static TOP: OnceLock<PathBuf> = OnceLock::new();
    TOP.get_or_init(|| {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        here.ancestors().nth(2).expect("this crate is tests/support").to_owned()
    })
}

/// Runs a command that must succeed.
#[track_caller]
pub fn ran(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?} does not start: {error}; run ./test"));
    let [said, told] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(output.status.success(), "{command:?} (./test installs what it needs): {}\n{said}\n{told}", output.status);
    output
}

/// A run of `ledgerd` beside a node, or in its place, with the node's configuration.
pub fn run_ledgerd(arguments: &[&str], config: &Path) -> Output {
    let mut command = node();
    let command = command.args(arguments).arg("--config").arg(config).stdin(Stdio::null());
    command.output().expect("ledgerd starts")
}

/// The words of a program that must have succeeded.
#[track_caller]
pub fn said(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The report of a program that must have failed; it has these words.
#[track_caller]
pub fn refused(output: &Output, words: &[&str]) -> String {
    assert!(!output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    for word in words {
        assert!(told.contains(word), "{word:?} is missing in {told}");
    }
    told
}
