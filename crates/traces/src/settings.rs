//! The section `[traces]`, of a node or of a bridge that is a process of its own.

use ledger_base::settings::Section;
use std::time::Duration;
use tonic::transport::Endpoint;

/// Largest `one_in`.
const ONE_IN_MAX: u64 = 1_000_000;
/// How long the collector may take to accept a connection.
const CONNECT_MAX: Duration = Duration::from_secs(2);

/// The collector, and how many messages it hears of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settings {
    /// `http://HOST:PORT` where an OpenTelemetry collector listens for OTLP over gRPC; empty = there is none.
    pub endpoint: String,
    /// One message in so many is traced.
    pub one_in: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self { endpoint: String::new(), one_in: 100 }
    }
}

impl Settings {
    /// Reads the section.
    pub fn read(&mut self, root: &mut Section<'_, '_>) {
        root.section("traces", |section| {
            let endpoint = |text: &str| is_endpoint(text).then(|| text.to_owned());
            section.text(
                "endpoint",
                "http://HOST:PORT, for example \"http://127.0.0.1:4317\"",
                &mut self.endpoint,
                endpoint,
            );
            section.integer("one_in", 1..=ONE_IN_MAX, &mut self.one_in);
        });
    }

    /// The collector.
    pub(crate) fn endpoint(&self) -> Option<Endpoint> {
        let endpoint = Endpoint::from_shared(self.endpoint.clone()).ok().filter(|_| !self.endpoint.is_empty())?;
        Some(endpoint.connect_timeout(CONNECT_MAX))
    }
}

fn is_endpoint(text: &str) -> bool {
    let place = text.strip_prefix("http://").and_then(|rest| rest.rsplit_once(':'));
    let is_place = place.is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
    text.is_empty() || (is_place && Endpoint::from_shared(text.to_owned()).is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_collector_is_a_host_and_a_port_over_plain_http() {
        for text in ["", "http://127.0.0.1:4317", "http://collector.fleet:4317", "http://[::1]:4317"] {
            assert!(is_endpoint(text), "{text}");
        }
        for text in ["127.0.0.1:4317", "https://127.0.0.1:4317", "http://127.0.0.1", "http://:4317", "http://a b:1"] {
            assert!(!is_endpoint(text), "{text}");
        }
        assert!(Settings::default().endpoint().is_none());
    }
}
