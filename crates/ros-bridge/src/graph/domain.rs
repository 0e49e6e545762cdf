//! Which ROS domain a bridge joins.

use std::fmt;

use ledger_base::rejection::{Code, Rejection};

/// Highest DDS domain: above it the UDP ports would exceed 65535.
pub const DOMAIN_MAX: u16 = 232;
/// The environment variable by which ROS 2 nodes choose their domain.
pub const ROS_DOMAIN_ID: &str = "ROS_DOMAIN_ID";

/// A ROS domain, and who chose it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Domain {
    /// Its number.
    pub id: u16,
    /// The setting that chose it.
    pub chosen_by: ChosenBy,
}

/// The setting that chose a domain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChosenBy {
    /// The setting `domain_id`.
    Setting,
    /// The environment variable `ROS_DOMAIN_ID`.
    Environment,
    /// Nobody: it is 0, as for every ROS 2 node.
    Default,
}

impl Domain {
    /// The domain of the setting, else of the environment (the text of `ROS_DOMAIN_ID`), else 0.
    ///
    /// # Errors
    /// [`Code::BadConfiguration`] if the environment names no domain: another one would be a surprise.
    pub fn choose(setting: Option<u16>, environment: Option<&str>) -> Result<Self, Rejection> {
        if let Some(id) = setting {
            return Ok(Self { id, chosen_by: ChosenBy::Setting });
        }
        // ROS 2 takes an empty variable for none.
        let Some(text) = environment.map(str::trim).filter(|text| !text.is_empty()) else {
            return Ok(Self { id: 0, chosen_by: ChosenBy::Default });
        };
        match text.parse().ok().filter(|id| *id <= DOMAIN_MAX) {
            Some(id) => Ok(Self { id, chosen_by: ChosenBy::Environment }),
            None => Err(Rejection::new(Code::BadConfiguration, format!("{ROS_DOMAIN_ID} names no ROS domain"))
                .found(format!("{text:?}"))
                .wanted(format!("a number from 0 to {DOMAIN_MAX}"))
                .next("set domain_id in the configuration of the bridge, or correct the variable")),
        }
    }
}

impl fmt::Display for ChosenBy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Setting => "domain_id",
            Self::Environment => ROS_DOMAIN_ID,
            Self::Default => "the default",
        })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_setting_counts_before_the_environment_and_that_before_zero() {
        let choose = |setting, environment| {
            let domain = Domain::choose(setting, environment).unwrap();
            (domain.id, domain.chosen_by)
        };
        assert_eq!(choose(Some(0), Some("7")), (0, ChosenBy::Setting));
        assert_eq!(choose(None, Some(" 7 ")), (7, ChosenBy::Environment));
        assert_eq!(choose(None, Some("")), (0, ChosenBy::Default));
        assert_eq!(choose(None, None), (0, ChosenBy::Default));
    }

    #[test]
    fn a_variable_that_names_no_domain_is_refused() {
        for text in ["233", "-1", "seven", "0x7"] {
            let refused = Domain::choose(None, Some(text)).unwrap_err();
            assert_eq!(refused.code, Code::BadConfiguration);
            assert!(refused.found.contains(text) && refused.message.contains(ROS_DOMAIN_ID), "{refused}");
        }
    }
}
