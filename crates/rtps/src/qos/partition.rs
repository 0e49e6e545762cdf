//! Partitions (DDS 1.4 §2.2.3.13): names, or patterns in the manner of `fnmatch`.

/// Is a writer with the one list connected to a reader with the other? An empty list is the partition with the empty name.
pub(super) fn have_one_in_common(offered: &[String], requested: &[String]) -> bool {
    let names = |list: &[String]| if list.is_empty() { vec![String::new()] } else { list.to_vec() };
    let requested = names(requested);
    names(offered).iter().any(|one| requested.iter().any(|other| fit(one, other)))
}

/// Two patterns never fit, not even equal ones.
fn fit(one: &str, other: &str) -> bool {
    match (is_pattern(one), is_pattern(other)) {
        (false, false) => one == other,
        (true, false) => matches(one.as_bytes(), other.as_bytes()),
        (false, true) => matches(other.as_bytes(), one.as_bytes()),
        (true, true) => false,
    }
}

fn is_pattern(name: &str) -> bool {
    name.contains(['*', '?', '['])
}

/// Does the pattern match the whole name? Takes at most the product of both lengths: only the last `*` is ever extended.
fn matches(mut pattern: &[u8], mut name: &[u8]) -> bool {
    // The pattern behind the last `*`, and the name that is left if that `*` takes one byte more.
    let mut retry: Option<(&[u8], &[u8])> = None;
    loop {
        if let Some((b'*', rest)) = pattern.split_first() {
            pattern = rest;
            retry = name.split_first().map(|(_, left)| (rest, left));
            continue;
        }
        if let (Some(rest), Some((_, left))) = (match_one(pattern, name), name.split_first()) {
            (pattern, name) = (rest, left);
            continue;
        }
        if pattern.is_empty() && name.is_empty() {
            return true;
        }
        let Some((after_star, left)) = retry else { return false };
        (pattern, name) = (after_star, left);
        retry = left.split_first().map(|(_, less)| (after_star, less));
    }
}

/// The rest of the pattern if its first element matches the first byte of the name.
fn match_one<'a>(pattern: &'a [u8], name: &[u8]) -> Option<&'a [u8]> {
    let byte = name.first()?;
    let (first, rest) = pattern.split_first()?;
    if *first == b'['
        && let Some((contains, rest)) = match_bracket(rest, *byte)
    {
        return contains.then_some(rest);
    }
    (*first == b'?' || first == byte).then_some(rest)
}

/// `abc]`, `a-z]`, `!abc]`: does it contain the byte, and what follows? None without a closing bracket: then `[` means itself.
fn match_bracket(pattern: &[u8], byte: u8) -> Option<(bool, &[u8])> {
    let (is_negated, set) = match pattern {
        [b'!' | b'^', set @ ..] => (true, set),
        set => (false, set),
    };
    // A bracket that comes first is a member.
    let length = 1 + set.get(1..)?.iter().position(|other| *other == b']')?;
    let (mut members, rest) = set.split_at_checked(length)?;
    let mut is_member = false;
    loop {
        members = match members {
            [low, b'-', high, more @ ..] => {
                is_member |= (*low..=*high).contains(&byte);
                more
            }
            [one, more @ ..] => {
                is_member |= *one == byte;
                more
            }
            [] => return Some((is_member != is_negated, rest.get(1..)?)),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fits(pattern: &str, name: &str) -> bool {
        let list = |text: &str| [text.to_owned()];
        let both = (have_one_in_common(&list(pattern), &list(name)), have_one_in_common(&list(name), &list(pattern)));
        assert_eq!(both.0, both.1);
        both.0
    }

    #[test]
    fn names_fit_equal_names_and_patterns_that_match_the_whole_name() {
        for (pattern, name) in [
            ("", ""),
            ("a", "a"),
            ("*", ""),
            ("*", "abc"),
            ("a*", "a"),
            ("a*c", "abbc"),
            ("*b*", "abc"),
            ("a*b*c", "axbxbxc"),
            ("a?c", "abc"),
            ("[ab]1", "b1"),
            ("r[0-9]", "r7"),
            ("r[!0-9]", "rx"),
            ("r[^0-9]*", "rxy"),
            ("[]]", "]"),
            ("[a-]", "-"),
        ] {
            assert!(fits(pattern, name), "{pattern} {name}");
        }
        for (pattern, name) in
            [("a", "b"), ("a", ""), ("a*c", "abcd"), ("a?c", "ac"), ("?", ""), ("r[0-9]", "rx"), ("r[!0-9]", "r7")]
        {
            assert!(!fits(pattern, name), "{pattern} {name}");
        }
    }

    #[test]
    fn a_bracket_that_is_not_closed_means_itself() {
        assert!(matches(b"[a?", b"[ax") && matches(b"[", b"[") && !matches(b"[a", b"a"));
    }

    #[test]
    fn two_patterns_never_fit() {
        assert!(!fits("a*", "a*") && !fits("*", "?"));
    }

    #[test]
    fn an_empty_list_is_the_partition_with_the_empty_name() {
        let list = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        for (offered, requested, connected) in [
            (&[][..], &[][..], true),
            (&[], &[""], true),
            (&["*"], &[], true),
            (&["a"], &[], false),
            (&["a", "b"], &["c", "b"], true),
            (&["a", ""], &[], true),
        ] {
            assert_eq!(have_one_in_common(&list(offered), &list(requested)), connected, "{offered:?} {requested:?}");
        }
    }

    #[test]
    fn a_pattern_of_many_stars_is_matched_in_bounded_time() {
        let (pattern, name) = ("*a".repeat(128) + "b", "a".repeat(256));
        assert!(!fits(&pattern, &name));
    }
}
