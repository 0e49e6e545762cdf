//! The form in which an attribute is written: `Husky`, `level=3`.
//!
//! A certificate may hold any name, and those of other CAs do. But two attributes in one, or a name with its value behind a space, are
//! slips that no policy would ever match. They are rejected where an attribute is given or demanded.

use std::fmt;

/// Most attributes that a slip is taken for.
const MEANT_MAX: usize = 8;

/// A text that is no attribute, and what was probably meant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotAnAttribute {
    /// The attributes that were probably meant; empty if nothing is near.
    pub meant: Vec<String>,
}

/// The accepted form.
pub const ATTRIBUTE_FORM: &str =
    "KEY=VALUE, or KEY alone for KEY=true, with a key of letters, digits, '_', '-' and '.'";

impl NotAnAttribute {
    /// A question about what was meant; empty if nothing is near. `option` stands before each of several attributes.
    pub fn question(&self, option: &str) -> String {
        match self.meant.as_slice() {
            [] => String::new(),
            [one] => format!("did you mean {one}?"),
            several => {
                let each: Vec<String> = several.iter().map(|one| format!("{option}{one}")).collect();
                let between = if option.is_empty() { " and " } else { " " };
                format!("did you mean {} attributes, {}?", several.len(), each.join(between))
            }
        }
    }
}

impl fmt::Display for NotAnAttribute {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let question = self.question("--attr ");
        match question.as_str() {
            "" => write!(f, "wanted {ATTRIBUTE_FORM}"),
            question => write!(f, "wanted {ATTRIBUTE_FORM} ({question})"),
        }
    }
}

/// The key and the value of an attribute: `KEY=VALUE`, or `KEY` for the value `true`.
///
/// # Errors
/// [`NotAnAttribute`] for a key that has other characters, and for a value that begins further attributes.
pub fn read_attribute(text: &str) -> Result<(&str, &str), NotAnAttribute> {
    parts(text).ok_or_else(|| NotAnAttribute { meant: meant(text) })
}

fn parts(text: &str) -> Option<(&str, &str)> {
    let (key, value) = text.split_once('=').unwrap_or((text, "true"));
    let is_value = !value.chars().any(char::is_control) && !has_another(value);
    (is_key(key) && is_value).then_some((key, value))
}

/// The attribute as it is typed.
pub fn shown_attribute(key: &str, value: &str) -> String {
    if value == "true" { key.to_owned() } else { format!("{key}={value}") }
}

fn is_key(key: &str) -> bool {
    !key.is_empty() && key.chars().all(|c| c.is_alphanumeric() || matches!(c, '_' | '-' | '.'))
}

/// Does another attribute follow in the value, as in `true,Husky=true`?
fn has_another(value: &str) -> bool {
    value.split([',', ';']).skip(1).any(|part| part.split_once('=').is_some_and(|(key, _)| is_key(key.trim())))
}

fn meant(text: &str) -> Vec<String> {
    let several: Vec<&str> =
        text.split([',', ';', '&', '|', '+']).map(str::trim).filter(|part| !part.is_empty()).collect();
    let read: Vec<String> = match several.as_slice() {
        [one] => of_words(one),
        several => several.iter().map(|one| (*one).to_owned()).collect(),
    };
    // A value alone names nothing.
    let all_fit = !text.trim_start().starts_with('=') && read.iter().all(|one| parts(one).is_some());
    if all_fit && read.len() <= MEANT_MAX { read } else { Vec::new() }
}

/// The attributes in `level 3`, `level: 3`, `level = 3`, `Husky Turtlebot4`.
fn of_words(text: &str) -> Vec<String> {
    let words: Vec<&str> =
        text.split(|c: char| c.is_whitespace() || matches!(c, ':' | '=')).filter(|word| !word.is_empty()).collect();
    let is_value = |word: &str| matches!(word, "true" | "false") || word.starts_with(|c: char| c.is_ascii_digit());
    match words.as_slice() {
        [key, value] if text.contains([':', '=']) || is_value(value) => vec![shown_attribute(key, value)],
        words => words.iter().map(|word| (*word).to_owned()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attribute_is_a_key_and_a_value() {
        for (text, wanted) in [
            ("Husky", ("Husky", "true")),
            ("level=3", ("level", "3")),
            ("level=3=4", ("level", "3=4")),
            ("note=two words, and more", ("note", "two words, and more")),
            ("note=", ("note", "")),
            ("hf.Affiliation=org3.sales", ("hf.Affiliation", "org3.sales")),
            ("zugelassen-für_halle.2", ("zugelassen-für_halle.2", "true")),
        ] {
            assert_eq!(read_attribute(text), Ok(wanted), "{text}");
        }
    }

    #[test]
    fn a_slip_is_rejected_with_what_was_meant() {
        for (text, meant) in [
            ("Turtlebot4,Husky", &["Turtlebot4", "Husky"][..]),
            ("Turtlebot4, Husky", &["Turtlebot4", "Husky"]),
            ("Turtlebot4 Husky", &["Turtlebot4", "Husky"]),
            ("Turtlebot4=true,Husky=true", &["Turtlebot4=true", "Husky=true"]),
            ("level=3;Husky=true", &["level=3", "Husky=true"]),
            ("level 3", &["level=3"]),
            ("level: 3", &["level=3"]),
            ("level:3", &["level=3"]),
            ("level = 3", &["level=3"]),
            ("safety true", &["safety"]),
            (" Husky", &["Husky"]),
            ("", &[]),
            ("=true", &[]),
            ("a\nb=c", &["a", "b", "c"]),
            ("\"Husky\"", &[]),
        ] {
            let refused = read_attribute(text).err().map(|refused| refused.meant);
            assert_eq!(
                refused.as_deref(),
                Some(meant.iter().map(|&one| one.to_owned()).collect::<Vec<_>>()).as_deref(),
                "{text}"
            );
        }
    }

    #[test]
    fn the_question_names_each_attribute() {
        let several = read_attribute("Turtlebot4,Husky").err().map(|refused| refused.to_string()).unwrap_or_default();
        assert!(several.ends_with("(did you mean 2 attributes, --attr Turtlebot4 --attr Husky?)"), "{several}");
        let one = read_attribute("level 3").err().map(|refused| refused.to_string()).unwrap_or_default();
        assert!(one.ends_with("(did you mean level=3?)"), "{one}");
    }
}
