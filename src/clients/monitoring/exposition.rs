//! The forms of `/metrics`: OpenMetrics for clients that accept it, the text form of Prometheus for all others.

use axum::http::HeaderMap;
use axum::http::header::ACCEPT;
use std::collections::BTreeMap;

/// <https://prometheus.io/docs/specs/om/open_metrics_spec/>
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
/// <https://prometheus.io/docs/instrumenting/exposition_formats/#text-based-format>
const TEXT: &str = "text/plain; version=0.0.4; charset=utf-8";

/// A form of `/metrics`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Exposition {
    /// OpenMetrics 1.0.0.
    OpenMetrics,
    /// The text form of Prometheus, 0.0.4, which every client reads.
    Text,
}

impl Exposition {
    /// The form that a client accepts. OpenMetrics needs to be named, and to be preferred to plain text.
    pub(super) fn accepted(headers: &HeaderMap) -> Self {
        let (mut open_metrics, mut text) = (0.0, 0.0);
        let accepted = headers.get_all(ACCEPT).iter().filter_map(|value| value.to_str().ok());
        for range in accepted.flat_map(|value| value.split(',')) {
            let mut parts = range.split(';').map(str::trim);
            let kind = parts.next().unwrap_or_default().to_ascii_lowercase();
            let (mut quality, mut is_known) = (1.0_f64, true);
            for (name, value) in parts.filter_map(|part| part.split_once('=')) {
                match name.trim().to_ascii_lowercase().as_str() {
                    "q" => quality = value.trim().parse().unwrap_or(0.0),
                    "version" => is_known = ["1.0.0", "0.0.1"].contains(&value.trim().trim_matches('"')),
                    _ => {}
                }
            }
            match kind.as_str() {
                "application/openmetrics-text" if is_known => open_metrics = quality.max(open_metrics),
                "text/plain" => text = quality.max(text),
                _ => {}
            }
        }
        if open_metrics > 0.0 && open_metrics >= text { Self::OpenMetrics } else { Self::Text }
    }

    /// The value of `content-type`.
    pub(super) fn content_type(self) -> &'static str {
        match self {
            Self::OpenMetrics => OPEN_METRICS,
            Self::Text => TEXT,
        }
    }

    /// Figures that are encoded as OpenMetrics, in this form.
    pub(super) fn render(self, encoded: String) -> String {
        match self {
            Self::OpenMetrics => encoded,
            Self::Text => text(&encoded),
        }
    }
}

/// In the text form, the name of a counter ends in `_total` also in its description, there are no units, and an info is a gauge.
fn text(encoded: &str) -> String {
    let of = |line: &'_ str, word: &str| Some(line.strip_prefix(word)?.split_once(' ')).flatten().map(owned);
    let kinds: BTreeMap<String, String> = encoded.lines().filter_map(|line| of(line, "# TYPE ")).collect();
    let mut rendered = String::with_capacity(encoded.len());
    for line in encoded.lines() {
        if line == "# EOF" || line.starts_with("# UNIT ") {
            continue;
        }
        let described = ["# HELP ", "# TYPE "].into_iter().find_map(|word| Some((word, of(line, word)?)));
        let Some((word, (name, rest))) = described else {
            rendered.push_str(line);
            rendered.push('\n');
            continue;
        };
        let (suffix, kind) = match kinds.get(&name).map(String::as_str) {
            Some("counter") => ("_total", "counter"),
            Some("info") => ("_info", "gauge"),
            Some("unknown") | None => ("", "untyped"),
            Some(kind) => ("", kind),
        };
        let rest = if word == "# TYPE " { kind } else { &rest };
        rendered.push_str(&format!("{word}{name}{suffix} {rest}\n"));
    }
    rendered
}

fn owned((name, rest): (&str, &str)) -> (String, String) {
    (name.to_owned(), rest.to_owned())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn accepted(value: &str) -> Exposition {
        Exposition::accepted(&HeaderMap::from_iter([(ACCEPT, value.parse().unwrap())]))
    }

    #[test]
    fn the_form_is_one_that_the_client_accepts() {
        // Prometheus, Go's expfmt, curl, a browser.
        let prometheus = "application/openmetrics-text;version=1.0.0,application/openmetrics-text;version=0.0.1;q=0.75,\
                          text/plain;version=0.0.4;q=0.5,*/*;q=0.1";
        let expfmt = "application/vnd.google.protobuf;proto=io.prometheus.client.MetricFamily;encoding=delimited;q=0.7,\
                      text/plain;version=0.0.4;q=0.3";
        assert_eq!(accepted(prometheus), Exposition::OpenMetrics);
        for other in [
            expfmt,
            "*/*",
            "text/html,*/*;q=0.8",
            "application/openmetrics-text;q=0",
            "application/openmetrics-text;version=2.0.0",
        ] {
            assert_eq!(accepted(other), Exposition::Text, "{other}");
        }
        assert_eq!(accepted("application/openmetrics-text;q=0.4, text/plain;q=0.5"), Exposition::Text);
        assert_eq!(Exposition::accepted(&HeaderMap::new()), Exposition::Text);
    }

    #[test]
    fn the_text_form_names_counters_as_their_samples_do() {
        let encoded = "# HELP a_calls Calls.\n# TYPE a_calls counter\na_calls_total{code=\"OK\"} 1\n\
                       # HELP a_free_bytes Free.\n# TYPE a_free_bytes gauge\n# UNIT a_free_bytes bytes\na_free_bytes 5\n\
                       # HELP a_node This.\n# TYPE a_node info\na_node_info{v=\"1\"} 1\n# EOF\n";
        let wanted = "# HELP a_calls_total Calls.\n# TYPE a_calls_total counter\na_calls_total{code=\"OK\"} 1\n\
                      # HELP a_free_bytes Free.\n# TYPE a_free_bytes gauge\na_free_bytes 5\n\
                      # HELP a_node_info This.\n# TYPE a_node_info gauge\na_node_info{v=\"1\"} 1\n";
        assert_eq!(Exposition::Text.render(encoded.to_owned()), wanted);
        assert_eq!(Exposition::OpenMetrics.render(encoded.to_owned()), encoded);
    }
}
