//! Numbers as Python reads them from text. Digits of other scripts are not read.

use super::lines::trim;

/// A whole number: decimal also with zeros in front, or behind `0x`, `0o` or `0b`; `_` may stand between digits.
pub(super) fn whole(text: &str) -> Option<i128> {
    let (is_negative, unsigned) = signed(trim(text));
    let prefix: String = unsigned.chars().take(2).collect::<String>().to_ascii_lowercase();
    let (radix, digits) = match (prefix.as_str(), unsigned.get(2..)) {
        ("0x", Some(digits)) => (16, digits),
        ("0o", Some(digits)) => (8, digits),
        ("0b", Some(digits)) => (2, digits),
        _ => (10, unsigned),
    };
    // A prefix and `_` may be neighbours.
    let digits = if radix == 10 { digits } else { digits.strip_prefix('_').unwrap_or(digits) };
    let value = i128::from_str_radix(&grouped(digits, radix)?, radix).ok()?;
    Some(if is_negative { -value } else { value })
}

/// A decimal whole number.
pub(super) fn decimal(text: &str) -> Option<i128> {
    let (is_negative, digits) = signed(trim(text));
    let value: i128 = grouped(digits, 10)?.parse().ok()?;
    Some(if is_negative { -value } else { value })
}

/// A floating number, `inf`, `infinity` or `nan`.
pub(super) fn float(text: &str) -> Option<f64> {
    let text = trim(text);
    let is_digit = |c: Option<char>| c.is_some_and(|c| c.is_ascii_digit());
    let between = |at: usize| {
        is_digit(text.get(..at).and_then(|before| before.chars().next_back()))
            && is_digit(text.get(at + 1..).and_then(|behind| behind.chars().next()))
    };
    if text.match_indices('_').any(|(at, _)| !between(at)) {
        return None;
    }
    text.replace('_', "").parse().ok()
}

fn signed(text: &str) -> (bool, &str) {
    match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    }
}

/// Digits without the `_` between them.
fn grouped(digits: &str, radix: u32) -> Option<String> {
    let is_group = |group: &str| !group.is_empty() && group.chars().all(|c| c.is_digit(radix));
    digits.split('_').all(is_group).then(|| digits.replace('_', ""))
}
