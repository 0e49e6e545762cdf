//! Variables of ROS 2 that put nodes out of reach of a bridge on DDS.

use std::fmt;

/// Chooses the middleware of ROS 2 nodes.
const RMW_IMPLEMENTATION: &str = "RMW_IMPLEMENTATION";
/// The addresses of discovery servers of Fast DDS.
const ROS_DISCOVERY_SERVER: &str = "ROS_DISCOVERY_SERVER";
/// The transports of Fast DDS.
const FASTDDS_BUILTIN_TRANSPORTS: &str = "FASTDDS_BUILTIN_TRANSPORTS";
/// The middleware that speaks DDS, by parts of its names.
const DDS: [&str; 4] = ["fastrtps", "cyclonedds", "connext", "gurum"];

/// A variable in the environment of a bridge. Nodes that have it as well do not reach the bridge.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutOfReach {
    /// The variable and its value.
    pub setting: String,
    /// Its effect in ROS 2.
    pub effect: &'static str,
    /// The setting of the bridge that replaces it.
    pub remedy: &'static str,
}

impl OutOfReach {
    /// Those of this environment, which answers with the text of a variable.
    pub fn find(environment: impl Fn(&str) -> Option<String>) -> Vec<Self> {
        let variable =
            |name: &str| environment(name).map(|text| text.trim().to_owned()).filter(|text| !text.is_empty());
        let of = |name: &str, effect, remedy| {
            let setting = variable(name).map(|value| format!("{name}={value}"));
            setting.map(|setting| Self { setting, effect, remedy })
        };
        let is = |name: &str, check: &dyn Fn(&str) -> bool| variable(name).is_some_and(|value| check(&value));
        let mut found = Vec::new();
        if is(RMW_IMPLEMENTATION, &|name| !DDS.iter().any(|dds| name.contains(dds))) {
            let effect = "not known to speak DDS: a bridge does not discover its nodes";
            found.extend(of(
                RMW_IMPLEMENTATION,
                effect,
                "rmw_fastrtps_cpp or rmw_cyclonedds_cpp, for each node of this graph",
            ));
        }
        if is(ROS_DISCOVERY_SERVER, &|_| true) {
            let effect = "a bridge takes part in no discovery server: its clients do not discover the bridge";
            let remedy = "no discovery server for the nodes that a bridge serves; across machines use ROS_STATIC_PEERS";
            found.extend(of(ROS_DISCOVERY_SERVER, effect, remedy));
        }
        // Options may follow, as in LARGE_DATA?max_msg_size=1MB.
        if is(FASTDDS_BUILTIN_TRANSPORTS, &|kinds| !matches!(kinds.split('?').next(), Some("DEFAULT" | "UDPv4"))) {
            let effect = "nodes of Fast DDS without UDP over IPv4 exchange no messages with a bridge";
            found.extend(of(
                FASTDDS_BUILTIN_TRANSPORTS,
                effect,
                "DEFAULT or UDPv4, for each node that a bridge serves",
            ));
        }
        found
    }
}

impl fmt::Display for OutOfReach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.setting, self.effect)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variables_that_hide_nodes_from_a_bridge_are_named_each_once() {
        let of = |pairs: &[(&str, &str)]| {
            let value = |name: &str| pairs.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned());
            OutOfReach::find(value).into_iter().map(|found| found.setting).collect::<Vec<_>>()
        };
        for harmless in [
            (RMW_IMPLEMENTATION, "rmw_fastrtps_cpp"),
            (RMW_IMPLEMENTATION, "rmw_fastrtps_dynamic_cpp"),
            (RMW_IMPLEMENTATION, "rmw_cyclonedds_cpp"),
            (RMW_IMPLEMENTATION, ""),
            (ROS_DISCOVERY_SERVER, " "),
            (FASTDDS_BUILTIN_TRANSPORTS, "DEFAULT"),
            (FASTDDS_BUILTIN_TRANSPORTS, "UDPv4?max_msg_size=1MB"),
        ] {
            assert_eq!(of(&[harmless]), Vec::<String>::new(), "{harmless:?}");
        }
        let hidden = [
            (RMW_IMPLEMENTATION, "rmw_zenoh_cpp"),
            (ROS_DISCOVERY_SERVER, "10.0.0.1:11811"),
            (FASTDDS_BUILTIN_TRANSPORTS, "LARGE_DATA"),
        ];
        assert_eq!(of(&hidden), hidden.map(|(name, value)| format!("{name}={value}")));
        for transports in ["SHM", "UDPv6", "DEFAULTv6", "LARGE_DATA?max_msg_size=1MB"] {
            assert_eq!(of(&[(FASTDDS_BUILTIN_TRANSPORTS, transports)]).len(), 1, "{transports}");
        }
    }
}
