//! Asking before something is done that cannot be undone.

use ledger_base::rejection::{Code, Rejection};
use std::io::{self, BufRead, IsTerminal, Write};

/// Asks whether it is meant, on a terminal; without one it has to be said in the command. `lost` says what would be lost, a
/// sentence each; nothing to lose is not asked.
///
/// # Errors
/// [`Code::LastOne`] if it is not meant.
pub(crate) fn confirm(what: &str, lost: &[String], i_mean_it: bool) -> Result<(), Rejection> {
    if lost.is_empty() || i_mean_it {
        return Ok(());
    }
    let refused = |found: &str| {
        Rejection::new(Code::LastOne, format!("{what} was not done"))
            .found(lost.join("; "))
            .wanted(found)
            .next("to do it anyway: the same command with --i-mean-it")
    };
    ask(lost, refused)
}

/// Asks whether a change that was shown is to be made, on a terminal; without one it has to be said in the command.
///
/// # Errors
/// [`Code::LastOne`] if it is not to be made.
pub(crate) fn agree(what: &str, yes: bool) -> Result<(), Rejection> {
    if yes {
        return Ok(());
    }
    ask(&[], |wanted| {
        Rejection::new(Code::LastOne, format!("{what} was not put in force"))
            .wanted(wanted)
            .next("to skip this question: the same command with --yes")
    })
}

fn ask(sentences: &[String], refused: impl Fn(&str) -> Rejection) -> Result<(), Rejection> {
    let mut answer = String::new();
    if !io::stdin().is_terminal() {
        return Err(refused("a terminal for the confirmation"));
    }
    let mut screen = io::stderr();
    for sentence in sentences {
        let _shown = writeln!(screen, "{sentence}");
    }
    let _asked = write!(screen, "type yes to confirm: ").and_then(|()| screen.flush());
    let _nothing = io::stdin().lock().read_line(&mut answer);
    if answer.trim() == "yes" { Ok(()) } else { Err(refused("yes")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_loses_nothing_or_is_meant_is_not_asked() {
        assert!(confirm("removing", &[], false).is_ok());
        assert!(confirm("removing", &["the last node".into()], true).is_ok());
    }
}
