//! The whole terminal: keys without Enter, and frames in the place of lines. The terminal is as it was when this ends.

use ledger_base::rejection::{Code, Rejection};
use rustix::termios::{OptionalActions, Termios, isatty, tcgetattr, tcgetwinsize, tcsetattr};
use std::io::{self, Write};
use tokio::io::{AsyncReadExt, Stdin, stdin};

/// Another screen, without a cursor; and back.
const ENTER: &str = "\x1b[?1049h\x1b[?25l";
const LEAVE: &str = "\x1b[?25h\x1b[?1049l";
/// Ctrl-C and Ctrl-D, where the terminal makes no signal of them.
pub(super) const CONTROL: [u8; 2] = [3, 4];
/// Most bytes that are read at a time.
const TYPED_MAX: usize = 16;

/// A key that means something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Key {
    Up,
    Down,
    Stop,
    Resume,
    Release,
    End,
    Other,
}

/// The bytes of one key, or of pasted text.
pub(super) struct Typed {
    bytes: [u8; TYPED_MAX],
    count: usize,
}

impl Typed {
    /// The bytes; none if the terminal is gone.
    pub(super) fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.count).unwrap_or_default()
    }

    /// The key, where keys are commands.
    pub(super) fn key(&self) -> Key {
        match self.bytes() {
            [] => Key::End,
            bytes => key(bytes),
        }
    }
}

/// The terminal while it is ours.
pub(super) struct Screen {
    before: Termios,
    keys: Stdin,
}

impl Screen {
    /// Takes the terminal.
    ///
    /// # Errors
    /// [`Code::BadArgument`] without one.
    pub(super) fn open() -> Result<Self, Rejection> {
        if !isatty(io::stdin()) || !isatty(io::stdout()) {
            return Err(Rejection::new(Code::BadArgument, "top needs a terminal")
                .found("standard input or output that is not a terminal")
                .wanted("a terminal for both")
                .next(
                    "for programs: ledgerctl watch -o json, ledgerctl status -o json, ledgerctl robot list -o json",
                ));
        }
        let before = tcgetattr(io::stdin()).map_err(unusable)?;
        let mut raw = before.clone();
        raw.make_raw();
        tcsetattr(io::stdin(), OptionalActions::Now, &raw).map_err(unusable)?;
        // From here on it is given back whatever happens.
        let mut screen = Self { before, keys: stdin() };
        screen.write(ENTER)?;
        Ok(screen)
    }

    /// Columns and rows.
    pub(super) fn size(&self) -> (usize, usize) {
        match tcgetwinsize(io::stdout()) {
            Ok(size) if size.ws_col > 0 && size.ws_row > 0 => (size.ws_col.into(), size.ws_row.into()),
            _ => (80, 24),
        }
    }

    /// Shows these lines, and nothing else.
    pub(super) fn draw(&mut self, lines: &[String]) -> Result<(), Rejection> {
        self.write(&format!("\x1b[H{}\x1b[K\x1b[J", lines.join("\x1b[K\r\n")))
    }

    fn write(&mut self, text: &str) -> Result<(), Rejection> {
        let mut out = io::stdout();
        out.write_all(text.as_bytes()).and_then(|()| out.flush()).map_err(unusable)
    }

    /// The next bytes that are typed. Safe to cancel.
    pub(super) async fn typed(&mut self) -> Typed {
        let mut bytes = [0; TYPED_MAX];
        let count = self.keys.read(&mut bytes).await.unwrap_or_default();
        Typed { bytes, count }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _left = self.write(LEAVE);
        let _given_back = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
    }
}

fn key(bytes: &[u8]) -> Key {
    match bytes {
        b"\x1b[A" | b"\x1bOA" | b"k" => Key::Up,
        b"\x1b[B" | b"\x1bOB" | b"j" => Key::Down,
        b"s" | b"S" => Key::Stop,
        b"u" | b"U" => Key::Resume,
        b"r" | b"R" => Key::Release,
        b"q" | b"Q" | b"\x1b" => Key::End,
        [byte] if CONTROL.contains(byte) => Key::End,
        _ => Key::Other,
    }
}

/// The refusal of a terminal that does not do what it should.
pub(super) fn unusable(error: impl std::fmt::Display) -> Rejection {
    Rejection::new(Code::BadFile, "the terminal cannot be used").found(error.to_string()).wanted("a terminal")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_told_by_their_bytes_and_pasted_text_stops_nothing() {
        for (bytes, wanted) in [
            (&b"\x1b[A"[..], Key::Up),
            (b"\x1bOB", Key::Down),
            (b"s", Key::Stop),
            (b"r", Key::Release),
            (b"u", Key::Resume),
            (b"q", Key::End),
            (b"\x03", Key::End),
            (b"ss", Key::Other),
            (b"stop it", Key::Other),
            (b"\x1b[C", Key::Other),
            (b"", Key::Other),
        ] {
            assert_eq!(key(bytes), wanted, "{bytes:?}");
        }
    }
}
