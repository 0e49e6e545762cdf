//! Words of a shell, for commands that are printed to be copied.

use std::borrow::Cow;
use std::path::Path;

/// The text as one word of a POSIX shell: in single quotes unless it needs none.
///
/// ```
/// use ledger_base::shell::word;
///
/// assert_eq!(word("/etc/ledgerd/ledgerd.toml"), "/etc/ledgerd/ledgerd.toml");
/// assert_eq!(word("my fleet.toml"), "'my fleet.toml'");
/// ```
pub fn word(text: &str) -> Cow<'_, str> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:@%+=,".contains(c);
    if !text.is_empty() && text.chars().all(plain) && !text.starts_with('-') {
        Cow::Borrowed(text)
    } else {
        Cow::Owned(format!("'{}'", text.replace('\'', r"'\''")))
    }
}

/// A path as one word of a POSIX shell. One that begins with a dash is written as `./-…`, so that no program takes it for an
/// option.
pub fn path(path: &Path) -> String {
    let text = path.display().to_string();
    if text.starts_with('-') { word(&format!("./{text}")).into_owned() } else { word(&text).into_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odd_texts_are_quoted_and_plain_ones_are_not() {
        for (text, quoted) in [
            ("Org1/Salma", "Org1/Salma"),
            ("", "''"),
            ("a b", "'a b'"),
            ("$(rm)", "'$(rm)'"),
            ("it's", r"'it'\''s'"),
            ("-rf", "'-rf'"),
            ("ä", "'ä'"),
        ] {
            assert_eq!(word(text), quoted);
        }
    }

    #[test]
    fn a_path_is_one_word_and_no_option() {
        assert_eq!(path(Path::new("/srv/node 1/ledgerd.toml")), "'/srv/node 1/ledgerd.toml'");
        assert_eq!(path(Path::new("-config")), "./-config");
        assert_eq!(path(Path::new("-my config")), "'./-my config'");
    }
}
