//! Which middleware carries the local graph: DDS, or zenoh as `rmw_zenoh` uses it.

use std::path::{Path, PathBuf};

use ledger_base::settings::Section;
use ros_zenoh::settings::{Endpoint, Mode, Protocol, Settings, Tls};

use super::reach::{Range, Reach};
use crate::error::{Error, Explained, Result};

/// The endpoint of the router that `rmw_zenohd` starts.
const ENDPOINT: &str = "tcp/127.0.0.1:7447";
/// Where a peer listens by default: this host, at any free port.
const LISTEN: &str = "tcp/127.0.0.1:0";
const ENDPOINTS: &str = "tcp/HOST:PORT or tls/HOST:PORT, such as \"tcp/127.0.0.1:7447\"";
const FILE: &str = "the path of a PEM file";

/// The middleware of the local graph.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum MiddlewareChoice {
    /// DDS.
    #[default]
    Dds,
    /// A graph of `rmw_zenoh`. Only a program with the feature `zenoh` has it.
    Zenoh(Box<Settings>),
}

impl MiddlewareChoice {
    /// Reads `transport` and `[zenoh]`; `directory` is where relative paths start.
    pub(crate) fn read(&mut self, section: &mut Section<'_, '_>, directory: &Path) {
        let (mut is_zenoh, mut settings) = (false, None);
        section.text("transport", "\"dds\" or \"zenoh\"", &mut is_zenoh, |text| {
            [("dds", false), ("zenoh", true)].into_iter().find(|(name, _)| *name == text).map(|(_, is_zenoh)| is_zenoh)
        });
        section.section("zenoh", |section| settings = Some(read_zenoh(section, directory)));
        match (is_zenoh, settings) {
            (true, settings) => *self = Self::Zenoh(Box::new(settings.unwrap_or_else(default_settings))),
            (false, None) => {}
            (false, Some(_)) => {
                let (found, wanted) = ("dds, and a section [zenoh]".to_owned(), "transport = \"zenoh\"".to_owned());
                section.conflict(["transport", "zenoh"], found, wanted);
            }
        }
    }

    /// Checks that the endpoints stay within the range.
    ///
    /// # Errors
    /// [`Error::Setting`] if one leaves this host, and the range does not.
    pub(crate) fn check(&self, reach: &Reach) -> Result<()> {
        let Self::Zenoh(settings) = self else { return Ok(()) };
        let far = settings.connect.iter().chain(&settings.listen).find(|endpoint| !endpoint.is_loopback());
        match far {
            Some(far) if reach.range == Range::Localhost => Err(Error::Setting(Explained::new(
                "an endpoint of zenoh leaves this host, and discovery_range does not",
                format!("{far:?}", far = far.to_string()),
                "an address of this host, such as 127.0.0.1, or discovery_range = \"subnet\"",
                "a bridge signs what appears in its graph: set discovery_range = \"subnet\" only if TLS and access control close it",
            ))),
            _ => Ok(()),
        }
    }
}

/// The fault of a program without the feature `zenoh`.
#[cfg(not(feature = "zenoh"))]
pub(crate) fn without_zenoh() -> Explained {
    let (what, found) = ("this program has no zenoh", "transport = \"zenoh\"");
    Explained::new(what, found, "the program ledgerd-bridge-zenoh", "docs/bridge.md (rmw_zenoh) says how to get it")
}

fn read_zenoh(section: &mut Section<'_, '_>, directory: &Path) -> Settings {
    let mut settings = default_settings();
    section.text("mode", "\"client\" or \"peer\"", &mut settings.mode, |text| {
        [Mode::Client, Mode::Peer].into_iter().find(|mode| mode.name() == text)
    });
    let (mut connect, mut listen) = (None, None);
    section.text("endpoint", ENDPOINTS, &mut connect, |text| text.parse::<Endpoint>().ok().map(Some));
    section.text("listen", ENDPOINTS, &mut listen, |text| text.parse::<Endpoint>().ok().map(Some));
    settings.connect.splice(.., connect.into_iter().chain(settings.connect.clone()).take(1));
    match (settings.mode, listen) {
        (Mode::Client, None) => {}
        (Mode::Client, Some(listen)) => {
            section.conflict(
                ["mode", "listen"],
                format!("a client and {:?}", listen.to_string()),
                "a peer, or no listen".to_owned(),
            );
        }
        (Mode::Peer | Mode::Router, listen) => {
            settings.listen = listen.or_else(|| LISTEN.parse().ok()).into_iter().collect()
        }
    }
    let Tls { ca, certificate, key } = &mut settings.tls;
    for (name, file) in [("ca", ca), ("certificate", certificate), ("key", key)] {
        section.text(name, FILE, file, |path| Some(Some(directory.join(path))));
    }
    faults(section, &settings);
    settings
}

/// Refuses settings of TLS that do not go together.
fn faults(section: &mut Section<'_, '_>, settings: &Settings) {
    let Tls { ca, certificate, key } = &settings.tls;
    let shown = |path: &Option<PathBuf>| path.as_ref().map_or("nothing".to_owned(), |path| path.display().to_string());
    if certificate.is_some() != key.is_some() {
        let found = format!("{} and {}", shown(certificate), shown(key));
        section.conflict(["certificate", "key"], found, "both, or none".to_owned());
    }
    let is_tls = settings.connect.iter().chain(&settings.listen).any(|endpoint| endpoint.protocol == Protocol::Tls);
    if is_tls && ca.is_none() {
        let found = "an endpoint with TLS, and nothing".to_owned();
        section.conflict(["endpoint", "ca"], found, "the certificate authority of the router".to_owned());
    }
}

fn default_settings() -> Settings {
    Settings { connect: ENDPOINT.parse().ok().into_iter().collect(), ..Settings::default() }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::config::Config;

    fn read(text: &str) -> std::result::Result<MiddlewareChoice, String> {
        let text = format!("{text}\n[discover]\nrobot = 'T'");
        let config = Config::parse(&text, Path::new("/etc/bridge.toml"), |_| ());
        config.map(|config| config.middleware).map_err(|faults| faults.iter().map(ToString::to_string).collect())
    }

    fn zenoh(text: &str) -> Settings {
        let MiddlewareChoice::Zenoh(settings) = read(&format!("transport = 'zenoh'\n{text}")).unwrap() else {
            unreachable!("{text}")
        };
        *settings
    }

    #[test]
    fn dds_is_the_default_and_zenoh_is_the_client_of_the_router_of_this_host() {
        assert_eq!(read("").unwrap(), MiddlewareChoice::Dds);
        assert_eq!(read("transport = 'dds'").unwrap(), MiddlewareChoice::Dds);
        let settings = zenoh("");
        assert_eq!((settings.mode, settings.connect.len(), settings.listen.len()), (Mode::Client, 1, 0));
        assert_eq!(settings.connect.first().unwrap().to_string(), ENDPOINT);
    }

    #[test]
    fn a_peer_listens_on_this_host_unless_it_is_set() {
        let listen = |text: &str| zenoh(text).listen.first().unwrap().to_string();
        assert_eq!(listen("[zenoh]\nmode = 'peer'"), LISTEN);
        assert_eq!(listen("[zenoh]\nmode = 'peer'\nlisten = 'tcp/10.0.0.4:7448'"), "tcp/10.0.0.4:7448");
    }

    #[test]
    fn files_of_tls_lie_beside_the_configuration() {
        let text =
            "[zenoh]\nendpoint = 'tls/router:7447'\nca = 'ca.pem'\ncertificate = 'bridge.pem'\nkey = '/run/bridge.key'";
        let tls = zenoh(text).tls;
        let paths = [tls.ca, tls.certificate, tls.key].map(|path| path.unwrap().display().to_string());
        assert_eq!(paths, ["/etc/ca.pem", "/etc/bridge.pem", "/run/bridge.key"]);
    }

    #[test]
    fn settings_that_do_not_go_together_are_refused_with_their_names() {
        for (text, names) in [
            ("[zenoh]\nmode = 'client'", ["transport", "zenoh"]),
            ("transport = 'zenoh'\n[zenoh]\nlisten = 'tcp/127.0.0.1:1'", ["mode", "listen"]),
            ("transport = 'zenoh'\n[zenoh]\ncertificate = 'a'", ["certificate", "key"]),
            ("transport = 'zenoh'\n[zenoh]\nendpoint = 'tls/a:1'", ["endpoint", "ca"]),
            ("transport = 'ros1'", ["transport", "zenoh"]),
            ("transport = 'zenoh'\n[zenoh]\nmode = 'router'", ["mode", "peer"]),
            ("transport = 'zenoh'\n[zenoh]\nendpoint = 'udp/a:1'", ["endpoint", "tcp/HOST:PORT"]),
        ] {
            let refused = read(text).unwrap_err();
            assert!(names.iter().all(|name| refused.contains(name)), "{text}: {refused}");
        }
    }

    #[test]
    fn an_endpoint_leaves_this_host_only_if_the_range_does() {
        let (near, far) = (Reach::default(), Reach { range: Range::Subnet, ..Reach::default() });
        for (text, is_far) in [
            ("", false),
            ("[zenoh]\nendpoint = 'tcp/[::1]:7447'", false),
            ("[zenoh]\nendpoint = 'tcp/10.0.0.5:7447'", true),
            ("[zenoh]\nendpoint = 'tls/router:7447'\nca = 'ca.pem'", true),
            ("[zenoh]\nmode = 'peer'\nlisten = 'tcp/0.0.0.0:7448'", true),
        ] {
            let choice = MiddlewareChoice::Zenoh(Box::new(zenoh(text)));
            assert_eq!(choice.check(&near).is_err(), is_far, "{text}");
            assert!(choice.check(&far).is_ok(), "{text}");
        }
        let choice = MiddlewareChoice::Zenoh(Box::new(zenoh("[zenoh]\nendpoint = 'tcp/10.0.0.5:7447'")));
        let refused = choice.check(&near).unwrap_err().to_string();
        assert!(refused.contains("10.0.0.5") && refused.contains("discovery_range = \"subnet\""), "{refused}");
    }
}
