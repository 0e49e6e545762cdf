//! Text from others, without characters that a terminal would obey.

use std::borrow::Cow;

/// The text without anything that a terminal would obey, or that shows nothing and turns or hides what stands beside it.
/// Names and messages come from other organisations.
pub(crate) fn printable(text: &str) -> Cow<'_, str> {
    if text.chars().any(deceives) {
        text.chars().flat_map(|c| if deceives(c) { c.escape_default().collect() } else { vec![c] }).collect()
    } else {
        Cow::Borrowed(text)
    }
}

/// Control characters, and those of Unicode that are invisible or change the direction of the text.
pub(crate) fn deceives(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}')
        || matches!(c, '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}')
}

/// A result for people: whatever forgot [`printable`], its lines and tabs stay.
pub(crate) fn harmless(text: &str) -> String {
    text.split_inclusive(['\n', '\t'])
        .flat_map(|part| {
            let end = part.len() - usize::from(part.ends_with(['\n', '\t']));
            let (words, end) = part.split_at(end);
            [printable(words), Cow::Borrowed(end)]
        })
        .collect()
}

/// JSON that says the same and has no character that a terminal would obey: they stand in strings only.
pub(crate) fn harmless_json(json: &str) -> String {
    let mut made = String::with_capacity(json.len());
    for c in json.chars() {
        if deceives(c) {
            c.encode_utf16(&mut [0; 2]).iter().for_each(|unit| made.push_str(&format!("\\u{unit:04x}")));
        } else {
            made.push(c);
        }
    }
    made
}

/// [`printable`] line by line.
pub(crate) fn printable_lines(text: &str) -> String {
    text.lines().map(printable).collect::<Vec<_>>().join("\n")
}
