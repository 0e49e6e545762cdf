//! The quality of service in a liveliness token.
//!
//! ```text
//! reliability:durability:history,depth:deadline_s,ns:lifespan_s,ns:liveliness,lease_s,ns
//! ```
//! A field is empty if it has the default of `rmw_qos_profile_default`; the depth is always there. Numbers are those of
//! `rmw_qos_policy_*_t`.

use std::{fmt, time::Duration};

/// The history depth of `rmw_qos_profile_default`.
const DEFAULT_DEPTH: usize = 10;

/// The part of it that matters here. Deadline and liveliness of others are not looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TokenQos {
    /// Are lost samples sent again?
    pub is_reliable: bool,
    /// Do subscribers that come late receive what was published before?
    pub is_latched: bool,
    /// Samples kept; none = all.
    pub depth: Option<usize>,
    /// How long a sample is of use; none = for ever.
    pub lifespan: Option<Duration>,
}

impl Default for TokenQos {
    /// That of a service: reliable, volatile, the last ten.
    fn default() -> Self {
        Self { is_reliable: true, is_latched: false, depth: Some(DEFAULT_DEPTH), lifespan: None }
    }
}

impl fmt::Display for TokenQos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reliability = if self.is_reliable { "" } else { "2" };
        let durability = if self.is_latched { "1" } else { "" };
        write!(f, "{reliability}:{durability}:")?;
        match self.depth {
            Some(depth) => write!(f, ",{depth}")?,
            None => f.write_str("2,0")?,
        }
        match self.lifespan {
            Some(lifespan) => write!(f, ":,:{},{}:,,", lifespan.as_secs(), lifespan.subsec_nanos()),
            None => f.write_str(":,:,:,,"),
        }
    }
}

impl TokenQos {
    /// Reads it; none if it is malformed.
    pub fn parse(text: &str) -> Option<Self> {
        let mut groups = text.split(':');
        let mut group = || groups.next();
        let (reliability, durability, history) = (group()?, group()?, group()?);
        let (_deadline, lifespan) = (group()?, group()?);
        let (history, depth) = history.split_once(',')?;
        let depth = if depth.is_empty() { DEFAULT_DEPTH } else { depth.parse().ok()? };
        let (seconds, nanos) = lifespan.split_once(',')?;
        let lifespan = match (seconds, nanos) {
            ("", "") => None,
            (seconds, nanos) => Some(Duration::new(seconds.parse().ok()?, nanos_of(nanos)?)),
        };
        Some(Self {
            // 0 = the default of the system, 5 = the best available one.
            is_reliable: one_of(reliability, &["", "0", "1", "5"], &["2"])?,
            is_latched: one_of(durability, &["1"], &["", "0", "2", "5"])?,
            depth: one_of(history, &["", "0", "1"], &["2"])?.then_some(depth),
            lifespan,
        })
    }
}

/// Nanoseconds below a second: more would make [`Duration::new`] carry over, and panic at the end of its range.
fn nanos_of(text: &str) -> Option<u32> {
    let nanos: u32 = text.parse().ok()?;
    (nanos < 1_000_000_000).then_some(nanos)
}

/// True if the text is one of the first, false if it is one of the second.
fn one_of(text: &str, yes: &[&str], no: &[&str]) -> Option<bool> {
    let is_yes = yes.contains(&text);
    (is_yes || no.contains(&text)).then_some(is_yes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_text_is_that_of_rmw_zenoh() {
        let reliable = TokenQos { depth: Some(7), ..TokenQos::default() };
        assert_eq!(reliable.to_string(), "::,7:,:,:,,");
        let latched = TokenQos { is_latched: true, depth: Some(1), ..TokenQos::default() };
        assert_eq!(latched.to_string(), ":1:,1:,:,:,,");
        let sensor = TokenQos { is_reliable: false, depth: None, ..TokenQos::default() };
        assert_eq!(sensor.to_string(), "2::2,0:,:,:,,");
        let marked = TokenQos { lifespan: Some(Duration::new(5, 16)), ..TokenQos::default() };
        assert_eq!(marked.to_string(), "::,10:,:5,16:,,");
    }

    #[test]
    fn what_rmw_zenoh_writes_in_full_is_understood() {
        assert_eq!(TokenQos::parse("1:2:1,10:,:,:1,,"), Some(TokenQos::default()));
        assert_eq!(TokenQos::parse("::,:,:,:,,"), Some(TokenQos::default()));
        for bad in [
            "",
            "::",
            "3::,1:,:,:,,",
            ":9:,1:,:,:,,",
            "::,x:,:,:,,",
            "::,1:,:1,1000000000:,,",
            "::,1:,:99999999999999999999,0:,,",
        ] {
            assert_eq!(TokenQos::parse(bad), None, "{bad}");
        }
    }

    proptest! {
        #[test]
        fn it_comes_back(is_reliable: bool, is_latched: bool, depth in proptest::option::of(0usize..10_000), nanos: Option<u64>) {
            let lifespan = nanos.map(Duration::from_nanos);
            let qos = TokenQos { is_reliable, is_latched, depth, lifespan };
            prop_assert_eq!(TokenQos::parse(&qos.to_string()), Some(qos));
        }

        #[test]
        fn any_text_is_read_without_a_panic(text in ".{0,80}") {
            let _read = TokenQos::parse(&text);
        }
    }
}
