//! How far a bridge reaches: with which hosts it shares its ROS domain.
//!
//! A user's bridge signs what appears in its domain. On a network of many hosts that would be anybody's message. So a
//! bridge takes part with local processes only. Its configuration may say otherwise, and so may the variables of ROS 2 for
//! the range of discovery and for static peers.

use std::{
    fmt,
    net::{IpAddr, Ipv4Addr, SocketAddr, ToSocketAddrs},
};

use ledger_base::rejection::{Code, Rejection};
use ledger_base::settings::Section;

/// The variable by which ROS 2 nodes choose the range of their discovery.
pub const ROS_AUTOMATIC_DISCOVERY_RANGE: &str = "ROS_AUTOMATIC_DISCOVERY_RANGE";
/// The variable that names hosts beyond that range, with `;` between them.
pub const ROS_STATIC_PEERS: &str = "ROS_STATIC_PEERS";
/// The older variable for the range: if it is 1, ROS 2 ignores the range and the static peers of the environment.
const ROS_LOCALHOST_ONLY: &str = "ROS_LOCALHOST_ONLY";
/// Demands DDS Security (SROS2) from every ROS 2 node if it is `true`.
const ROS_SECURITY_ENABLE: &str = "ROS_SECURITY_ENABLE";
/// Most static peers, and most interfaces.
const HOSTS_MAX: usize = 64;
const HOSTS: &str = "host names or IPv4 addresses with ';' between them, at most 64";
const INTERFACES: &str = "IPv4 addresses of this host with ';' between them, at most 64";
const RANGES: &str = "\"localhost\" or \"subnet\"";

/// The range in which others are discovered by multicast.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Range {
    /// Processes of this host.
    #[default]
    Localhost,
    /// All hosts that multicast reaches.
    Subnet,
}

impl Range {
    /// As it is written in a configuration.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Localhost => "localhost",
            Self::Subnet => "subnet",
        }
    }
}

/// The settings of the configuration; none = the environment's, else the default.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Settings {
    range: Option<Range>,
    static_peers: Option<Vec<String>>,
    interfaces: Option<Vec<Ipv4Addr>>,
}

impl Settings {
    /// Reads `discovery_range`, `static_peers` and `interfaces`.
    pub(crate) fn read(&mut self, section: &mut Section<'_, '_>) {
        section.text("discovery_range", RANGES, &mut self.range, |text| {
            [Range::Localhost, Range::Subnet].into_iter().find(|range| range.name() == text).map(Some)
        });
        section.text("static_peers", HOSTS, &mut self.static_peers, |text| hosts(text).map(Some));
        section.text("interfaces", INTERFACES, &mut self.interfaces, |text| {
            let addresses: Option<Vec<_>> = hosts(text)?.iter().map(|address| address.parse().ok()).collect();
            addresses.filter(|addresses| !addresses.is_empty()).map(Some)
        });
    }
}

/// The hosts with which a participant shares its domain. By default this one.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Reach {
    /// Where others are discovered.
    pub range: Range,
    /// Hosts beyond that range, by name or IPv4 address. They have to name this host as well, or be in its range.
    pub static_peers: Vec<String>,
    /// IPv4 addresses of the interfaces that are used; none = all.
    pub interfaces: Option<Vec<Ipv4Addr>>,
}

impl Reach {
    /// The reach of the settings, else of the environment, else this host. `environment` answers with the text of a variable.
    ///
    /// # Errors
    /// [`Code::BadConfiguration`] if the environment says something that is no range, or `OFF`: a bridge without
    /// discovery would carry nothing. Also if it demands SROS2, in which a bridge cannot take part.
    pub fn choose(settings: &Settings, environment: impl Fn(&str) -> Option<String>) -> Result<Self, Rejection> {
        let variable = |name| environment(name).map(|text| text.trim().to_owned()).filter(|text| !text.is_empty());
        if variable(ROS_SECURITY_ENABLE).is_some_and(|text| text == "true") {
            return Err(Rejection::new(Code::BadConfiguration, "a bridge cannot take part in a domain that SROS2 secures")
                .found(format!("{ROS_SECURITY_ENABLE}=true"))
                .wanted("a domain without DDS Security")
                .next(format!(
                    "start the bridge with {ROS_SECURITY_ENABLE}=false; docs/bridge.md (SROS2) says how to close the robot's graph"
                )));
        }
        let is_localhost_only = variable(ROS_LOCALHOST_ONLY).is_some_and(|text| text == "1");
        let variable = |name| variable(name).filter(|_| !is_localhost_only);
        let range = match (settings.range, variable(ROS_AUTOMATIC_DISCOVERY_RANGE)) {
            (Some(range), _) => range,
            (None, None) => Range::default(),
            (None, Some(text)) => match text.as_str() {
                "LOCALHOST" | "SYSTEM_DEFAULT" => Range::Localhost,
                "SUBNET" => Range::Subnet,
                _ => return Err(bad(ROS_AUTOMATIC_DISCOVERY_RANGE, &text, "LOCALHOST, SUBNET or SYSTEM_DEFAULT")),
            },
        };
        let static_peers = match (&settings.static_peers, variable(ROS_STATIC_PEERS)) {
            (Some(peers), _) => peers.clone(),
            (None, None) => Vec::new(),
            (None, Some(text)) => hosts(&text).ok_or_else(|| bad(ROS_STATIC_PEERS, &text, HOSTS))?,
        };
        Ok(Self { range, static_peers, interfaces: settings.interfaces.clone() })
    }

    /// The addresses of the static peers. A name that nobody knows now is logged and left out. May block on DNS.
    pub(crate) fn peers(&self) -> Vec<IpAddr> {
        let mut addresses = Vec::new();
        for host in &self.static_peers {
            match (host.as_str(), 0).to_socket_addrs() {
                Ok(found) => addresses.extend(found.map(|address: SocketAddr| address.ip()).filter(IpAddr::is_ipv4)),
                Err(error) => tracing::warn!(host, %error, "static peer has no address; ignoring it"),
            }
        }
        addresses
    }
}

impl fmt::Display for Reach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.range {
            Range::Localhost => f.write_str("local processes")?,
            Range::Subnet => f.write_str("all hosts of the subnet")?,
        }
        match self.static_peers.as_slice() {
            [] if self.range == Range::Localhost => f.write_str(" only"),
            [] => Ok(()),
            peers => write!(f, " and {}", peers.join(", ")),
        }
    }
}

fn bad(variable: &str, text: &str, wanted: &str) -> Rejection {
    Rejection::new(Code::BadConfiguration, format!("{variable} is not usable for a bridge"))
        .found(format!("{text:?}"))
        .wanted(wanted)
        .next("set discovery_range and static_peers in the configuration of the bridge, or correct the variable")
}

fn hosts(text: &str) -> Option<Vec<String>> {
    let hosts: Vec<String> =
        text.split(';').map(str::trim).filter(|host| !host.is_empty()).map(str::to_owned).collect();
    let is_host = |host: &String| {
        host.len() <= 253 && host.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_'))
    };
    (hosts.len() <= HOSTS_MAX && hosts.iter().all(is_host)).then_some(hosts)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn choose(settings: &Settings, range: &str, peers: &str) -> Result<Reach, Rejection> {
        Reach::choose(settings, |name| Some(if name == ROS_STATIC_PEERS { peers.to_owned() } else { range.to_owned() }))
    }

    #[test]
    fn local_processes_only_unless_somebody_says_otherwise() {
        let none = Settings::default();
        assert_eq!(Reach::choose(&none, |_| None).unwrap(), Reach::default());
        for (text, range) in
            [("", Range::Localhost), ("LOCALHOST", Range::Localhost), ("SYSTEM_DEFAULT", Range::Localhost)]
        {
            assert_eq!(choose(&none, text, "").unwrap().range, range, "{text:?}");
        }
        assert_eq!(choose(&none, "SUBNET", "").unwrap().range, Range::Subnet);
    }

    #[test]
    fn a_setting_counts_before_the_environment() {
        let settings = Settings {
            range: Some(Range::Localhost),
            static_peers: Some(vec!["10.0.0.5".to_owned()]),
            interfaces: None,
        };
        let reach = choose(&settings, "SUBNET", "10.0.0.6").unwrap();
        assert_eq!((reach.range, reach.static_peers), (Range::Localhost, vec!["10.0.0.5".to_owned()]));
        assert_eq!(
            choose(&Settings::default(), "", "10.0.0.6; robot7.local;").unwrap().static_peers,
            ["10.0.0.6", "robot7.local"]
        );
    }

    #[test]
    fn localhost_only_counts_before_the_other_variables_and_after_the_settings() {
        let choose = |settings: &Settings, only: &str| {
            let of = |name: &str| match name {
                ROS_LOCALHOST_ONLY => Some(only.to_owned()),
                ROS_AUTOMATIC_DISCOVERY_RANGE => Some("SUBNET".to_owned()),
                ROS_STATIC_PEERS => Some("10.0.0.6".to_owned()),
                _ => None,
            };
            Reach::choose(settings, of).unwrap().to_string()
        };
        let none = Settings::default();
        assert_eq!(choose(&none, "1"), "local processes only");
        for disabled in ["0", "", "true"] {
            assert_eq!(
                choose(&none, disabled),
                "all hosts of the subnet and 10.0.0.6",
                "as ROS 2 reads it: {disabled:?}"
            );
        }
        let settings = Settings { range: Some(Range::Subnet), ..Settings::default() };
        assert_eq!(choose(&settings, "1"), "all hosts of the subnet");
    }

    #[test]
    fn a_bridge_says_that_it_cannot_take_part_in_a_secured_domain() {
        let with = |value: &str| {
            let value = value.to_owned();
            Reach::choose(&Settings::default(), move |name| (name == ROS_SECURITY_ENABLE).then(|| value.clone()))
        };
        let refused = with("true").unwrap_err();
        assert!(refused.message.contains("SROS2") && refused.advice().contains("docs/bridge.md"), "{refused}");
        for value in ["false", "", "True"] {
            assert_eq!(with(value).unwrap(), Reach::default(), "as ROS 2 reads it: {value:?}");
        }
    }

    #[test]
    fn a_variable_that_is_no_range_or_no_list_of_hosts_is_refused() {
        for (range, peers) in [("OFF", ""), ("localhost", ""), ("SUBNET", "two words"), ("SUBNET", "a/b")] {
            let refused = choose(&Settings::default(), range, peers).unwrap_err();
            assert_eq!(refused.code, Code::BadConfiguration, "{range} {peers}");
        }
    }

    #[test]
    fn the_ready_line_tells_how_far_a_bridge_reaches() {
        let far = Reach { range: Range::Subnet, static_peers: vec!["10.0.0.6".to_owned()], interfaces: None };
        assert_eq!(Reach::default().to_string(), "local processes only");
        assert_eq!(far.to_string(), "all hosts of the subnet and 10.0.0.6");
    }
}
