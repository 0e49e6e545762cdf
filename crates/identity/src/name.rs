//! Names that people can tell apart (Unicode Technical Standard 39).
//!
//! A name of the ledger is read by people who decide by it. So it has letters of one script in their composed form (NFC),
//! and no character that shows nothing or turns the direction of the text. Two names that may be taken for each other have one of
//! their [`looks`] in common.

use ledger_base::rejection::{Code, Rejection};
use std::collections::BTreeSet;
use unicode_normalization::is_nfc;
use unicode_security::{GeneralSecurityProfile, MixedScript, skeleton};

/// Checks that people can read a name without being deceived. Spaces and ASCII signs are allowed; other checks of a
/// name are elsewhere.
///
/// The tables are those of the Unicode version of `unicode-security`: they decide which registrations are executed, so a
/// newer version of it comes with newer rules of execution.
///
/// # Errors
/// [`Code::BadName`] with the character or the reason.
pub fn check_readable(name: &str) -> Result<(), Rejection> {
    let plain = |c: char| c == ' ' || c.is_ascii_graphic() || c.identifier_allowed();
    let found = match name.chars().find(|c| !plain(*c)) {
        Some(odd) => format!("the character {odd:?} (U+{:04X})", u32::from(odd)),
        None if !is_nfc(name) => "letters and accents that are not composed".to_owned(),
        None if !name.is_single_script() => "letters of several scripts".to_owned(),
        None => return Ok(()),
    };
    Err(Rejection::new(Code::BadName, format!("the name {name:?} could be mistaken for another"))
        .found(found)
        .wanted("letters of one script in composed form (NFC), digits and signs, nothing invisible (UTS 39)"))
}

/// The looks of a name: names that may be taken for each other have one in common. They are the skeletons of UTS 39 of the
/// name as it is and in small letters, both without regard to case. So `l` and `i` are both like `I`, and not like each other.
pub fn looks(name: &str) -> BTreeSet<String> {
    let look = |name: &str| skeleton(name).collect::<String>().to_lowercase();
    [look(name), look(&name.to_lowercase())].into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_people_everywhere_are_readable_and_those_that_deceive_are_not() {
        for name in ["Salma", "Jörg", "Ольга", "さくら", "田中", "robot-7_b.2", "Org 1", "عمر"] {
            assert!(check_readable(name).is_ok(), "{name}: {:?}", check_readable(name));
        }
        let wrong = [
            ("S\u{430}lma", "several scripts"),
            ("Jo\u{308}rg", "not composed"),
            ("Sal\u{200b}ma", "U+200B"),
            ("\u{202e}amlaS", "U+202E"),
            ("Sal\u{ad}ma", "U+00AD"),
            ("Salma\u{3164}", "U+3164"),
            ("\u{ff33}alma", "U+FF33"),
        ];
        for (name, found) in wrong {
            let refused = check_readable(name).err();
            assert!(
                refused.as_ref().is_some_and(|r| r.code == Code::BadName && r.found.contains(found)),
                "{refused:?}"
            );
        }
    }

    #[test]
    fn names_that_may_be_taken_for_each_other_have_a_look_in_common() {
        let alike = |one: &str, other: &str| !looks(one).is_disjoint(&looks(other));
        for (one, other) in [
            ("Salma", "Sa1ma"),
            ("Ivan", "lvan"),
            ("O1", "0l"),
            ("сор", "cop"),
            ("modern", "rnodern"),
            ("Salma", "salma"),
            ("Ivan", "ivan"),
            ("IVAN", "Ivan"),
            ("R0bot", "robot"),
            ("SALMA1", "salmal"),
            ("ÉLODIE", "élodie"),
        ] {
            assert!(alike(one, other) && alike(other, one), "{one} and {other}");
        }
        for (one, other) in [("Salma", "Selma"), ("lvan", "ivan"), ("Salma", "Salma2")] {
            assert!(!alike(one, other), "{one} and {other}");
        }
    }
}
