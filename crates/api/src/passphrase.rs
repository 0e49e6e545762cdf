//! Sources of secrets: a file, the environment, standard input or the terminal. All users of a machine can read arguments.

use ledger_base::rejection::{Code, Rejection};
use std::io::{self, BufRead, IsTerminal, Write};
use std::path::Path;

/// Where a passphrase may stand.
const VARIABLE: &str = "LEDGERD_PASSPHRASE";
/// Largest file of a passphrase, in bytes.
const FILE_BYTES_MAX: usize = 64 * 1024;

/// The first line of the file, else what the environment says, else what is typed on the terminal. One for a `new` copy is
/// asked for twice.
///
/// # Errors
/// [`Code::BadArgument`] if there is none, or what was typed differs; a file or a terminal that cannot be read.
pub fn passphrase(file: Option<&Path>, new: bool) -> Result<String, Rejection> {
    if let Some(path) = file {
        let text = ledger_base::durable::read(path, FILE_BYTES_MAX)?;
        return Ok(text_of(&text).lines().next().unwrap_or_default().to_owned());
    }
    if let Ok(passphrase) = std::env::var(VARIABLE) {
        return Ok(passphrase);
    }
    if !io::stdin().is_terminal() {
        return Err(Rejection::new(Code::BadArgument, "there is no passphrase")
            .found("no terminal for a prompt")
            .wanted(format!("--passphrase-file FILE, or {VARIABLE} in the environment")));
    }
    let passphrase = ask("passphrase: ")?;
    if new && ask("repeat: ")? != passphrase {
        return Err(Rejection::new(Code::BadArgument, "the two passphrases differ").next("run the command again"));
    }
    Ok(passphrase)
}

/// The secret that an argument names: `@FILE` is the first line of a file, `-` the first line of standard input, which is not shown if it
/// is typed. Any other argument is the secret itself.
///
/// # Errors
/// [`Code::BadArgument`] if the line is empty; a file, standard input or a terminal that cannot be read.
pub fn secret(argument: &str) -> Result<String, Rejection> {
    let line = match argument.strip_prefix('@') {
        Some(path) => {
            let text = ledger_base::durable::read(Path::new(path), FILE_BYTES_MAX)?;
            text_of(&text).lines().next().unwrap_or_default().to_owned()
        }
        None if argument != "-" => return Ok(argument.to_owned()),
        None if io::stdin().is_terminal() => ask("secret: ")?,
        None => first_line(io::stdin().lock())?,
    };
    match line.trim() {
        "" => Err(Rejection::new(Code::BadArgument, "there is no secret")
            .found(format!("an empty line from {}", if argument == "-" { "standard input" } else { argument }))
            .wanted("the secret in the first line")),
        line => Ok(line.to_owned()),
    }
}

/// The first line, of a bounded length.
fn first_line(input: impl BufRead) -> Result<String, Rejection> {
    let mut line = Vec::new();
    input
        .take(FILE_BYTES_MAX as u64)
        .read_until(b'\n', &mut line)
        .map_err(|error| Rejection::new(Code::BadFile, "standard input cannot be read").found(error.to_string()))?;
    Ok(text_of(&line))
}

/// The text of a file, without the mark of an editor; other bytes than text make a secret that fits nothing.
fn text_of(bytes: &[u8]) -> String {
    ledger_base::text::of_bytes(bytes).unwrap_or_else(|_| String::from_utf8_lossy(bytes).into_owned())
}

/// Asks on the terminal, without showing what is typed.
fn ask(prompt: &str) -> Result<String, Rejection> {
    use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};
    let failed = |error: io::Error| {
        Rejection::new(Code::BadFile, "the terminal cannot be used for a prompt").found(error.to_string())
    };
    let input = io::stdin();
    let shown = tcgetattr(&input).map_err(|error| failed(error.into()))?;
    let mut hidden = shown.clone();
    hidden.local_modes.remove(LocalModes::ECHO);
    let _asked = write!(io::stderr(), "{prompt}").and_then(|()| io::stderr().flush());
    tcsetattr(&input, OptionalActions::Flush, &hidden).map_err(|error| failed(error.into()))?;
    let mut line = String::new();
    let read = input.lock().read_line(&mut line);
    let restored = tcsetattr(&input, OptionalActions::Now, &shown);
    let _ended = writeln!(io::stderr());
    read.map_err(failed)?;
    restored.map_err(|error| failed(error.into()))?;
    Ok(line.trim_end_matches(['\r', '\n']).to_owned())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_the_argument_or_the_first_line_of_a_file() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("secret");
        std::fs::write(&file, "\u{feff} u7Qm-2fKx \nmore\n").unwrap();
        assert_eq!(secret("u7Qm-2fKx").unwrap(), "u7Qm-2fKx");
        assert_eq!(secret(&format!("@{}", file.display())).unwrap(), "u7Qm-2fKx");
        assert_eq!(first_line(&b"u7Qm\r\nmore"[..]).unwrap().trim(), "u7Qm");
        assert_eq!(first_line(&vec![b'x'; 2 * FILE_BYTES_MAX][..]).unwrap().len(), FILE_BYTES_MAX);
        std::fs::write(&file, "\n").unwrap();
        assert_eq!(secret(&format!("@{}", file.display())).unwrap_err().code, Code::BadArgument);
        assert!(secret(&format!("@{}", place.path().join("none").display())).is_err());
    }
}
