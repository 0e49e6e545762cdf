//! Where the passphrase of a secret copy comes from: a file, the environment, or the terminal.

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
        let text = String::from_utf8_lossy(&text);
        return Ok(text.lines().next().unwrap_or_default().to_owned());
    }
    if let Ok(passphrase) = std::env::var(VARIABLE) {
        return Ok(passphrase);
    }
    if !io::stdin().is_terminal() {
        return Err(Rejection::new(Code::BadArgument, "there is no passphrase")
            .found("no terminal to ask for it")
            .wanted(format!("--passphrase-file FILE, or {VARIABLE} in the environment")));
    }
    let passphrase = ask("passphrase: ")?;
    if new && ask("once more: ")? != passphrase {
        return Err(Rejection::new(Code::BadArgument, "the two passphrases differ").next("type the command again"));
    }
    Ok(passphrase)
}

/// Asks on the terminal, without showing what is typed.
fn ask(prompt: &str) -> Result<String, Rejection> {
    use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};
    let failed =
        |error: io::Error| Rejection::new(Code::BadFile, "the terminal cannot be asked").found(error.to_string());
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
