//! The layout of JSON text, without a change to its values: the order of fields and the digits of numbers stay as they are.

use serde_json::value::RawValue;

/// Spaces per level.
const INDENT: usize = 2;

/// The text with one field per line, or `None` if it is not JSON.
pub fn pretty(text: &str) -> Option<String> {
    serde_json::from_str::<&RawValue>(text).ok().map(|_| lay_out(text, true))
}

/// The text on one line, or `None` if it is not JSON.
pub fn compact(text: &str) -> Option<Box<RawValue>> {
    serde_json::from_str::<&RawValue>(text).ok()?;
    RawValue::from_string(lay_out(text, false)).ok()
}

/// `text` is valid JSON, so braces balance and strings end.
fn lay_out(text: &str, lines: bool) -> String {
    let mut out = String::with_capacity(text.len());
    let mut depth = 0usize;
    let mut in_string = false;
    let mut escaped = false;
    let mut characters = text.chars().peekable();
    while let Some(c) = characters.next() {
        if in_string {
            out.push(c);
            in_string = escaped || c != '"';
            escaped = c == '\\' && !escaped;
            continue;
        }
        match c {
            c if c.is_ascii_whitespace() => continue,
            '"' => {
                in_string = true;
                out.push(c);
            }
            '{' | '[' => {
                out.push(c);
                while characters.peek().is_some_and(char::is_ascii_whitespace) {
                    characters.next();
                }
                if characters.peek().is_some_and(|next| matches!(next, '}' | ']')) {
                    out.extend(characters.next());
                } else {
                    depth += 1;
                    new_line(&mut out, depth, lines);
                }
            }
            '}' | ']' => {
                depth = depth.saturating_sub(1);
                new_line(&mut out, depth, lines);
                out.push(c);
            }
            ',' => {
                out.push(c);
                new_line(&mut out, depth, lines);
            }
            ':' => out.push_str(if lines { ": " } else { ":" }),
            _ => out.push(c),
        }
    }
    out
}

fn new_line(out: &mut String, depth: usize, lines: bool) {
    if lines {
        out.push('\n');
        out.extend(std::iter::repeat_n(' ', depth * INDENT));
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn order_numbers_and_strings_stay_as_they_are() {
        let text =
            r#"{"Name":"a \"b\\\" {,:","SubTopic":[1e400, 18446744073709551615 ],"x":{},"y":[ ],"UnderOp":true}"#;
        let wanted = "{\n  \"Name\": \"a \\\"b\\\\\\\" {,:\",\n  \"SubTopic\": [\n    1e400,\n    18446744073709551615\n  \
                      ],\n  \"x\": {},\n  \"y\": [],\n  \"UnderOp\": true\n}";
        assert_eq!(pretty(text).unwrap(), wanted);
    }

    #[test]
    fn pretty_then_compact_gives_the_first_text() {
        for text in [r#"{"a":[1,{"b":" c : d "}],"e":{}}"#, "[]", "null", r#""x""#, r#"[[],[[]],"\\"]"#] {
            assert_eq!(compact(&pretty(text).unwrap()).unwrap().get(), text);
        }
    }

    #[test]
    fn what_is_not_json_is_left_alone() {
        for text in ["", "{", "hello", "{}x", "\"open"] {
            assert!(pretty(text).is_none() && compact(text).is_none(), "{text:?}");
        }
    }
}
