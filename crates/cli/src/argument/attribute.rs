//! Attributes: `KEY=VALUE`, or `KEY` alone for `KEY=true`.

use ledger_identity::read_attribute;

/// One attribute of a certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Attribute {
    /// Its name.
    pub(crate) key: String,
    /// Its value; `true` if none was given.
    pub(crate) value: String,
}

impl std::str::FromStr for Attribute {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (key, value) = read_attribute(text).map_err(|fault| fault.to_string())?;
        Ok(Self { key: key.to_owned(), value: value.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_alone_means_true() {
        let read = |text: &str| text.parse::<Attribute>().map(|a| (a.key, a.value));
        assert_eq!(read("Husky"), Ok(("Husky".into(), "true".into())));
        assert_eq!(read("level=3=4"), Ok(("level".into(), "3=4".into())));
        assert_eq!(read("note="), Ok(("note".into(), String::new())));
    }

    #[test]
    fn a_value_without_a_key_is_refused() {
        for text in ["", "=true", " a=b", "a\n=b", "Turtlebot4,Husky", "level 3"] {
            assert!(text.parse::<Attribute>().is_err(), "{text:?}");
        }
    }
}
