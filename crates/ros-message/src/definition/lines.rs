//! Lines and white space as Python has them, in which rosidl is written.

/// White space: Unicode's, and four separators that only Python counts as such.
fn is_space(c: char) -> bool {
    c.is_whitespace() || matches!(c, '\u{1c}'..='\u{1f}')
}

/// Without white space at both ends.
pub(super) fn trim(text: &str) -> &str {
    text.trim_matches(is_space)
}

/// Without white space in front.
pub(super) fn trim_start(text: &str) -> &str {
    text.trim_start_matches(is_space)
}

/// Without white space behind.
pub(super) fn trim_end(text: &str) -> &str {
    text.trim_end_matches(is_space)
}

/// The lines of a text. They end at more characters than LF.
pub(crate) fn lines(text: &str) -> Vec<&str> {
    let is_end = |c: char| matches!(c, '\n'..='\r' | '\u{1c}'..='\u{1e}' | '\u{85}' | '\u{2028}' | '\u{2029}');
    let mut lines = Vec::new();
    let mut rest = text;
    while let Some((line, behind)) = rest.split_once(is_end) {
        lines.push(line);
        let is_crlf = behind.starts_with('\n') && rest.get(line.len()..).is_some_and(|end| end.starts_with('\r'));
        rest = if is_crlf { behind.get(1..).unwrap_or_default() } else { behind };
    }
    if !rest.is_empty() {
        lines.push(rest);
    }
    lines
}

/// The statement of a line, without its comment. None for an empty line. A `#` begins a comment in quotes, too.
pub(super) fn statement(line: &str) -> Option<&str> {
    let statement = line.split('#').next().map(trim_end).unwrap_or_default();
    (!statement.is_empty()).then_some(statement)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_as_in_python() {
        assert_eq!(lines("a\r\nb\rc\n\nd\u{2028}e\u{85}"), ["a", "b", "c", "", "d", "e"]);
        assert!(lines("").is_empty());
        assert_eq!(lines("\n\r"), ["", ""]);
    }
}
