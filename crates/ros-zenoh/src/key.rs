//! Keys of topics and services: `domain/name/type/hash`.

use std::fmt;

/// The hash in the place of one that is not known: every hash.
const ANY: &str = "*";
/// The hash that a token has if it is not known. `rmw_zenoh` for ROS 2 Humble writes it, too.
pub const NO_HASH: &str = "TypeHashNotSupported";

/// A topic or a service with its type.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Subject {
    /// The name, `/cmd_vel`.
    pub name: String,
    /// The type as DDS writes it, `geometry_msgs::msg::dds_::Twist_`, or `std_srvs::srv::dds_::Trigger_` for a service.
    pub type_name: String,
    /// The hash of its definition, `RIHS01_…`; none if it is not known. Then it meets endpoints with any hash.
    pub hash: Option<String>,
}

impl Subject {
    /// The key on which messages or requests travel in a domain.
    pub fn key(&self, domain: u16) -> String {
        let Self { name, type_name, hash } = self;
        format!("{domain}/{}/{type_name}/{}", name.trim_matches('/'), hash.as_deref().unwrap_or(ANY))
    }

    /// Do endpoints of both exchange messages?
    pub fn meets(&self, other: &Self) -> bool {
        let same_hash = match (&self.hash, &other.hash) {
            (Some(own), Some(other)) => own == other,
            _ => true,
        };
        self.name == other.name && self.type_name == other.type_name && same_hash
    }
}

impl fmt::Display for Subject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} [{}]", self.name, self.type_name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn subject(hash: Option<&str>) -> Subject {
        Subject {
            name: "/robot1/chatter".to_owned(),
            type_name: "std_msgs::msg::dds_::String_".to_owned(),
            hash: hash.map(str::to_owned),
        }
    }

    #[test]
    fn the_key_is_that_of_rmw_zenoh() {
        let key = subject(Some("RIHS01_df66")).key(2);
        assert_eq!(key, "2/robot1/chatter/std_msgs::msg::dds_::String_/RIHS01_df66");
        assert_eq!(subject(None).key(0), "0/robot1/chatter/std_msgs::msg::dds_::String_/*");
    }

    #[test]
    fn another_definition_of_a_type_is_another_topic() {
        let (one, other, none) = (subject(Some("RIHS01_1")), subject(Some("RIHS01_2")), subject(None));
        assert!(one.meets(&one) && one.meets(&none) && none.meets(&other));
        assert!(!one.meets(&other));
        assert!(!one.meets(&Subject { name: "/chatter".to_owned(), ..one.clone() }));
    }
}
