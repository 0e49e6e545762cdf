//! Limits: what the policies that permit a use bind it to. The robot's gate enforces them.

use serde::{Deserialize, Serialize};

/// The limits of a grant, from the annotations of the policies that permit it. Where several permit it, each limit is the
/// strictest of theirs. Whole numbers of small units: every node must read them alike.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Most messages in a thousand seconds: `@max_rate("50")`, in Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_rate_mhz: Option<u64>,
    /// Age (milliseconds) beyond which a message is dropped, if that is shorter than the service's: `@max_age("200ms")`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_age_ms: Option<u64>,
    /// Largest linear speed (millimetres per second): `@max_linear("0.5")`, in m/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_linear_mm_s: Option<u64>,
    /// Largest angular speed (thousandths of a radian per second): `@max_angular("1.0")`, in rad/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_angular_mrad_s: Option<u64>,
    /// The windows of time within which the grant lasts, all of them: `@between("08:00-18:00 Mon-Fri +02:00")`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub between: Vec<String>,
}

impl Limits {
    /// Do they bind nothing?
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// These limits and the others, each the stricter one.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let least = |one: Option<u64>, two: Option<u64>| one.into_iter().chain(two).min();
        let mut between = [self.between, other.between].concat();
        between.sort();
        between.dedup();
        Self {
            max_rate_mhz: least(self.max_rate_mhz, other.max_rate_mhz),
            max_age_ms: least(self.max_age_ms, other.max_age_ms),
            max_linear_mm_s: least(self.max_linear_mm_s, other.max_linear_mm_s),
            max_angular_mrad_s: least(self.max_angular_mrad_s, other.max_angular_mrad_s),
            between,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_limits_the_stricter_one_counts_and_windows_add_up() {
        let one = Limits { max_rate_mhz: Some(5), max_age_ms: Some(9), between: vec!["b".into()], ..Limits::default() };
        let two = Limits {
            max_rate_mhz: Some(7),
            max_linear_mm_s: Some(1),
            between: vec!["a".into(), "b".into()],
            ..Limits::default()
        };
        let both = Limits {
            max_rate_mhz: Some(5),
            max_age_ms: Some(9),
            max_linear_mm_s: Some(1),
            max_angular_mrad_s: None,
            between: vec!["a".into(), "b".into()],
        };
        assert_eq!(one.clone().and(two.clone()), both);
        assert_eq!(two.and(one), both);
        assert!(Limits::default().and(Limits::default()).is_none());
    }
}
