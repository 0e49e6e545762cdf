//! The solver: a program of its own, which the variable `CVC5` names.

use cedar_policy_symcc::solver::LocalSolver;
use ledger_base::rejection::{Code, Rejection};
use std::process::Command;

/// The variable with the path of the solver.
const VARIABLE: &str = "CVC5";
/// The oldest version that answers all that is asked.
const OLDEST: [u32; 3] = [1, 3, 1];
/// How long it may think about one question, milliseconds.
const LIMIT_MS: u32 = 60_000;

/// A solver that was found and is new enough.
pub(super) struct Cvc5(String);

impl Cvc5 {
    /// The solver that the variable names.
    ///
    /// # Errors
    /// [`Code::BadFile`]: there is none, it does not start, or it is too old.
    pub(super) fn find() -> Result<Self, Rejection> {
        let path = std::env::var(VARIABLE).map_err(|_| unusable("the variable CVC5 is not set"))?;
        let told =
            Command::new(&path).arg("--version").output().map_err(|error| unusable(format!("{path}: {error}")))?;
        let text = String::from_utf8_lossy(&told.stdout);
        let version = version(&text).ok_or_else(|| unusable(format!("{path}, which reports no version of cvc5")))?;
        if version < OLDEST {
            let [major, minor, patch] = version;
            return Err(unusable(format!("{path}, version {major}.{minor}.{patch}")));
        }
        Ok(Self(path))
    }

    /// Starts it. Must be called inside a tokio runtime.
    pub(super) fn start(&self) -> Result<LocalSolver, Rejection> {
        let mut command = tokio::process::Command::new(&self.0);
        command.args(["--lang", "smt", &format!("--tlimit-per={LIMIT_MS}")]).kill_on_drop(true);
        LocalSolver::from_command(&mut command).map_err(|error| unusable(format!("{}: {error}", self.0)))
    }
}

/// The version in `This is cvc5 version 1.3.1 [git …]`.
fn version(text: &str) -> Option<[u32; 3]> {
    let (_, behind) = text.split_once("cvc5 version ")?;
    let mut numbers = behind.split(|c: char| !c.is_ascii_digit()).map(str::parse);
    let mut next = || numbers.next()?.ok();
    Some([next()?, next()?, next().unwrap_or(0)])
}

fn unusable(found: impl Into<String>) -> Rejection {
    Rejection::new(Code::BadFile, "no solver is available")
        .found(found)
        .wanted("cvc5 1.3.1 or newer; Debian has none")
        .next("download it from https://github.com/cvc5/cvc5/releases, and set CVC5=/path/to/cvc5")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_read_and_compared_as_numbers() {
        for (text, wanted) in [
            ("This is cvc5 version 1.3.1 [git tag]\nmore", Some([1, 3, 1])),
            ("This is cvc5 version 1.10.0-dev", Some([1, 10, 0])),
            ("This is cvc5 version 2.0", Some([2, 0, 0])),
            ("Z3 version 4.8", None),
            ("cvc5 version next", None),
        ] {
            assert_eq!(version(text), wanted, "{text}");
        }
        assert!([1, 10, 0] > OLDEST && [1, 3, 0] < OLDEST);
    }
}
