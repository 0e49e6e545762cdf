//! Where priorities come from: `attribute:NAME`, `policy`, `fixed:N`.

use crate::arguments::shown;
use ledger_base::rejection::{Code, Rejection};

/// The largest priority; the smallest is the same below zero.
pub(crate) const PRIORITY_MAX: i64 = 1_000_000;
/// The form of the setting.
const WANTED: &str = "attribute:NAME, policy, or fixed:N with N from -1000000 to 1000000";

/// The source of the priorities of a service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Source<'a> {
    /// Everybody has this one.
    Fixed(i64),
    /// The value of an attribute of the certificate, if its organisation is trusted.
    Attribute(&'a str),
    /// The annotation `@priority` of the policies that permit it.
    Policy,
}

impl<'a> Source<'a> {
    /// Reads the setting; without one, everybody has priority 0.
    ///
    /// # Errors
    /// [`Code::BadArgument`].
    pub(crate) fn of(setting: Option<&'a str>) -> Result<Self, Rejection> {
        let Some(setting) = setting else { return Ok(Self::Fixed(0)) };
        let read = match setting.split_once(':') {
            None if setting == "policy" => Some(Self::Policy),
            Some(("attribute", name)) if !name.is_empty() && name.len() <= 256 => Some(Self::Attribute(name)),
            Some(("fixed", number)) => parse(number).map(Self::Fixed),
            _ => None,
        };
        read.ok_or_else(|| {
            Rejection::new(Code::BadArgument, "the source of priorities is not usable")
                .found(shown(setting))
                .wanted(WANTED)
                .next("use one of these forms")
        })
    }
}

/// Reads a priority; none if it is no whole number within the bounds.
pub(crate) fn parse(text: &str) -> Option<i64> {
    let digits = text.strip_prefix('-').unwrap_or(text);
    let number: i64 = digits.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok()).flatten()?;
    (-PRIORITY_MAX..=PRIORITY_MAX).contains(&number).then_some(number)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_source_is_read_or_refused_with_what_is_wanted() {
        assert_eq!(Source::of(None).unwrap(), Source::Fixed(0));
        assert_eq!(Source::of(Some("fixed:-7")).unwrap(), Source::Fixed(-7));
        assert_eq!(Source::of(Some("attribute:rank")).unwrap(), Source::Attribute("rank"));
        assert_eq!(Source::of(Some("policy")).unwrap(), Source::Policy);
        for bad in ["", "fixed", "fixed:", "fixed:+1", "fixed:1000001", "fixed:1e3", "attribute:", "policy:x", "none"] {
            let refused = Source::of(Some(bad)).unwrap_err();
            assert_eq!((refused.code, refused.wanted.as_str()), (Code::BadArgument, WANTED), "{bad}");
        }
    }
}
