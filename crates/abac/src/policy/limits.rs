//! The limits of policies, read from their texts before anything parses them, and the steps that they take.
//!
//! Steps stand for the time of one decision, and are the same on every node. There is one for each byte of the owner's
//! policies, as most of Cedar's work grows with these. A pattern of `like` may be compared with every character of a text,
//! so each of its bytes takes [`STEPS_OF_PATTERN`] more.

use super::invalid;
use ledger_base::rejection::Rejection;

/// Longest text of one policy, in bytes.
pub const POLICY_BYTES_MAX: usize = 8 * 1024;
/// Deepest nesting of brackets, and most `if`s of one policy: both nest.
pub(super) const NESTING_MAX: usize = 32;
/// Most operators of one policy that can be chained: `a && b && …` nests inside Cedar although it does not look it.
pub(super) const CHAIN_MAX: usize = 1024;
/// Most wildcards in the patterns of one policy text.
const WILDCARDS_MAX: usize = 64;
/// Longest pattern of `like`, in bytes.
const PATTERN_BYTES_MAX: usize = 256;
/// Longest text in quotes, in bytes: as long as the attributes of a certificate.
const TEXT_BYTES_MAX: usize = 4 * 1024;
/// Most elements of one set.
const SET_MAX: usize = 256;
/// Steps of a byte of a pattern: a text of 4 KiB, of which 64 characters are compared in the time of a step.
const STEPS_OF_PATTERN: u64 = (TEXT_BYTES_MAX / 64) as u64;
/// Most steps of a decision by all policies of one organisation.
pub(crate) const STEPS_MAX: u64 = 1024 * 1024;

/// The checks before anything parses the text: its length and how deep it can nest.
pub(super) fn check(text: &str) -> Result<(), Rejection> {
    if text.len() > POLICY_BYTES_MAX {
        return Err(invalid(
            "the policy is too long",
            format!("{} bytes", text.len()),
            &format!("at most {POLICY_BYTES_MAX} bytes; split it into several"),
        ));
    }
    let (nesting, chain) = nesting(text);
    if nesting > NESTING_MAX {
        let wanted = format!("at most {NESTING_MAX} brackets within each other, and as many ifs in one policy");
        return Err(invalid("the policy is nested too deeply", format!("nesting of {nesting}"), &wanted));
    }
    if chain > CHAIN_MAX {
        let wanted = format!("at most {CHAIN_MAX} operators before a semicolon; split it into several");
        return Err(invalid("the chain of operators in the policy is too long", format!("{chain} operators"), &wanted));
    }
    Ok(())
}

/// How deep a text can nest: the deepest nesting of brackets or, if more, the largest number of `if`s in one policy.
/// The second number is the largest count of operators in one policy that can be chained. Strings and comments do not
/// count.
fn nesting(text: &str) -> (usize, usize) {
    let (mut depth, mut ifs, mut operators) = (0_usize, 0_usize, 0_usize);
    let (mut deepest, mut longest) = (0, 0);
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let mut skip = first.len_utf8();
        match first {
            '(' | '{' => depth += 1,
            '[' => (depth, operators) = (depth + 1, operators + 1),
            ')' | ']' | '}' => depth = depth.saturating_sub(1),
            ';' => (ifs, operators) = (0, 0),
            '"' => skip = string_bytes(rest),
            '/' if rest.starts_with("//") => skip = rest.find(['\n', '\r']).unwrap_or(rest.len()),
            '+' | '-' | '*' | '.' => operators += 1,
            '&' | '|' if rest.starts_with("&&") || rest.starts_with("||") => (skip, operators) = (2, operators + 1),
            _ if first.is_alphanumeric() || first == '_' => {
                skip = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
                ifs += usize::from(rest.get(..skip) == Some("if"));
            }
            _ => {}
        }
        deepest = deepest.max(depth).max(ifs);
        longest = longest.max(operators);
        rest = rest.get(skip..).unwrap_or_default();
    }
    (deepest, longest)
}

/// Length of the string literal that the text starts with; an unterminated one reaches to the end.
fn string_bytes(text: &str) -> usize {
    let mut escaped = false;
    for (at, c) in text.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return at + 1,
            _ => {}
        }
    }
    text.len()
}

/// The steps that the policies of a text take, within what they may be.
///
/// # Errors
/// [`ledger_base::rejection::Code::PolicyInvalid`] with what is too large.
pub(crate) fn steps(text: &str) -> Result<u64, Rejection> {
    let Sizes { patterns, pattern, wildcards, quoted, set } = sizes(text);
    let limits = [
        (wildcards, WILDCARDS_MAX, "wildcards in a policy"),
        (pattern, PATTERN_BYTES_MAX, "bytes in a pattern of like"),
        (quoted, TEXT_BYTES_MAX, "bytes in a text in quotes"),
        (set, SET_MAX, "elements in a set"),
    ];
    if let Some((found, most, what)) = limits.into_iter().find(|(found, most, _)| found > most) {
        return Err(invalid(
            "the policy needs too much work to evaluate",
            format!("{found} {what}"),
            &format!("at most {most}"),
        ));
    }
    Ok(text.len() as u64 + patterns as u64 * STEPS_OF_PATTERN)
}

/// The steps that a decision by all of these takes.
///
/// # Errors
/// As [`steps`].
pub(crate) fn steps_of_all(texts: &[(String, String)]) -> Result<u64, Rejection> {
    let mut all = 0;
    for (id, text) in texts {
        let of_one = steps(text).map_err(|mut refused| {
            refused.message = format!("{} ({id})", refused.message);
            refused
        })?;
        all += of_one;
    }
    if all <= STEPS_MAX {
        return Ok(all);
    }
    let wanted = format!("at most {STEPS_MAX} steps by all policies of an organisation together");
    Err(invalid("the policies need too much work to evaluate", format!("{all} steps"), &wanted))
}

/// The sizes of what takes long in a text.
#[derive(Debug, Default, PartialEq, Eq)]
struct Sizes {
    /// Bytes of all patterns of `like`.
    patterns: usize,
    /// Bytes of the longest one.
    pattern: usize,
    /// Wildcards in all of them.
    wildcards: usize,
    /// Bytes of the longest text in quotes.
    quoted: usize,
    /// Elements of the largest set.
    set: usize,
}

fn sizes(text: &str) -> Sizes {
    let (mut sizes, mut like) = (Sizes::default(), false);
    // The elements of every bracket that is open.
    let mut open: Vec<usize> = Vec::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let mut skip = first.len_utf8();
        match first {
            '"' => {
                skip = string_bytes(rest);
                let quoted = rest.get(..skip).unwrap_or_default();
                sizes.quoted = sizes.quoted.max(skip);
                if like {
                    sizes.patterns += skip;
                    sizes.pattern = sizes.pattern.max(skip);
                    sizes.wildcards += wildcards(quoted);
                }
            }
            '/' if rest.starts_with("//") => skip = rest.find(['\n', '\r']).unwrap_or(rest.len()),
            '[' | '(' | '{' => open.push(1),
            ']' | ')' | '}' => drop(open.pop()),
            ',' => {
                if let Some(elements) = open.last_mut() {
                    *elements += 1;
                    sizes.set = sizes.set.max(*elements);
                }
            }
            _ if first.is_alphanumeric() || first == '_' => {
                skip = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
            }
            _ => {}
        }
        // A comment or space between `like` and its pattern changes nothing.
        let spaced = first.is_whitespace() || rest.starts_with("//");
        like = rest.get(..skip) == Some("like") || (like && spaced);
        rest = rest.get(skip..).unwrap_or_default();
    }
    sizes
}

/// The stars of a pattern that are not escaped.
fn wildcards(quoted: &str) -> usize {
    let (mut found, mut escaped) = (0, false);
    for c in quoted.chars() {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '*' => found += 1,
            _ => {}
        }
    }
    found
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn patterns_sets_and_texts_are_measured_where_they_stand() {
        let text = r#"permit (principal, action, resource) when {
            resource.topic like "/a*\*b" && principal.name like // "*" is no pattern
                "*" && "*" != "**" && ["x", f(1, 2), "z"].contains("like") };"#;
        let sizes = sizes(text);
        assert_eq!((sizes.patterns, sizes.pattern, sizes.wildcards, sizes.set), (8 + 3, 8, 2, 3));
    }

    #[test]
    fn a_policy_is_as_costly_as_it_is_long_and_as_its_patterns_are() {
        let plain = "permit (principal, action, resource);";
        assert_eq!(steps(plain).unwrap(), plain.len() as u64);
        let like = r#"permit (principal, action, resource) when { principal.name like "S*" };"#;
        assert_eq!(steps(like).unwrap(), like.len() as u64 + 4 * STEPS_OF_PATTERN);
    }
}
