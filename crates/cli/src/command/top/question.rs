//! The question before a robot is resumed: why?

use super::screen::CONTROL;

/// Most characters of a reason.
const REASON_CHARS_MAX: usize = 200;

/// A robot that is to be resumed, and the reason as far as it is typed.
pub(super) struct Question {
    robot: String,
    reason: String,
}

/// The state of a question after a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Progress {
    Open,
    Answered,
    Cancelled,
}

impl Question {
    pub(super) fn about(robot: String) -> Self {
        Self { robot, reason: String::new() }
    }

    /// The robot, and the reason.
    pub(super) fn answer(self) -> (String, String) {
        (self.robot, self.reason.trim().to_owned())
    }

    /// Takes a key, or pasted text. Only Enter alone answers, behind a reason: neither a paste nor a repeated key resumes.
    pub(super) fn typed(&mut self, bytes: &[u8]) -> Progress {
        match bytes {
            [] | b"\x1b" => return Progress::Cancelled,
            [byte] if CONTROL.contains(byte) => return Progress::Cancelled,
            b"\r" | b"\n" if !self.reason.trim().is_empty() => return Progress::Answered,
            b"\x7f" | b"\x08" => drop(self.reason.pop()),
            [b'\x1b', ..] => {}
            bytes => {
                let room = REASON_CHARS_MAX.saturating_sub(self.reason.chars().count());
                let text = String::from_utf8_lossy(bytes);
                self.reason.extend(text.chars().filter(|letter| !letter.is_control()).take(room));
            }
        }
        Progress::Open
    }

    /// The line on the screen.
    pub(super) fn line(&self) -> String {
        format!("resume {}: why? {}_   (Enter resumes, Esc cancels)", self.robot, self.reason)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(keys: &[&[u8]]) -> (Progress, String) {
        let mut question = Question::about("T".to_owned());
        let mut progress = Progress::Open;
        for bytes in keys {
            progress = question.typed(bytes);
        }
        (progress, question.answer().1)
    }

    #[test]
    fn enter_behind_a_reason_resumes_and_nothing_else_does() {
        assert_eq!(after(&[b"cell is empty", b"\r"]), (Progress::Answered, "cell is empty".to_owned()));
        for keys in [
            &[&b"\r"[..], b"\r"][..],
            &[b" ", b"\r"],
            &[b"pasted\r\n"],
            &[b"u", b"u", b"s"],
            &[b"why", b"\x1b[A"],
            &[b"w", b"\x7f", b"\r"],
        ] {
            assert_eq!(after(keys).0, Progress::Open, "{keys:?}");
        }
        for keys in [&[&b"why"[..], b"\x1b"][..], &[b"why", b"\x03"], &[b"why", b""]] {
            assert_eq!(after(keys).0, Progress::Cancelled, "{keys:?}");
        }
    }

    #[test]
    fn a_reason_is_text_of_bounded_length() {
        assert_eq!(after(&[b"a\x1bb\x07c"]).1, "abc");
        assert_eq!(after(&[&[b'x'; 16][..]; 20]).1.len(), REASON_CHARS_MAX);
    }
}
