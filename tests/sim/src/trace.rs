//! The course of events, one line each: a hash that always runs, and the text if somebody wants to read it.

use std::fmt::{self, Write as _};

/// The trace of one run. Two runs of one seed give the same one, byte for byte.
#[derive(Debug)]
pub struct Trace {
    hash: u64,
    lines: u64,
    text: Option<String>,
    line: String,
}

impl Trace {
    /// An empty trace; keeps the text if wanted.
    pub fn new(keep_text: bool) -> Self {
        Self { hash: 0xcbf2_9ce4_8422_2325, lines: 0, text: keep_text.then(String::new), line: String::new() }
    }

    /// Adds a line.
    pub fn note(&mut self, now: u64, what: fmt::Arguments<'_>) {
        self.line.clear();
        // Writing to a string does not fail.
        let _ = writeln!(self.line, "{} {what}", Seconds(now));
        for byte in self.line.bytes() {
            self.hash = (self.hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
        self.lines += 1;
        if let Some(text) = &mut self.text {
            text.push_str(&self.line);
        }
    }

    /// Hash over every line so far (FNV-1a).
    pub fn hash(&self) -> u64 {
        self.hash
    }

    /// How many lines there are.
    pub fn lines(&self) -> u64 {
        self.lines
    }

    /// The text, if it is kept.
    pub fn text(&self) -> Option<&str> {
        self.text.as_deref()
    }
}

/// Microseconds as seconds with six digits.
struct Seconds(u64);

impl fmt::Display for Seconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:>5}.{:06}", self.0 / 1_000_000, self.0 % 1_000_000)
    }
}
