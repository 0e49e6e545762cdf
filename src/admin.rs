//! The page for whoever watches a node: is it alive, is it ready, and its figures. HTTP, read only.
//!
//! ```text
//! admin       the addresses: /livez, /readyz, /metrics
//!   checks    what readiness consists of
//!   metrics   the figures, as Prometheus and OpenMetrics read them
//! ```

mod checks;
mod metrics;

use crate::doors::{Doors, Room};
use crate::gateway::Description;
use axum::Router;
use axum::extract::{RawQuery, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use checks::Check;
use ledger_api::tls::{TlsIdentity, TrustSource, server_config};
use ledger_rejection::{Code, Rejection};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinHandle;

/// The form of `/metrics`: <https://prometheus.io/docs/specs/om/open_metrics_spec/>.
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Most connections at a time.
const OPEN_MAX: usize = 32;
/// Longest life of one. A program that watches connects again.
const LIFE_MAX: Duration = Duration::from_secs(60);

/// The page, as long as it is served. It ends when it is dropped.
pub(crate) struct Admin {
    address: SocketAddr,
    serving: JoinHandle<()>,
}

impl Admin {
    /// Serves the page of a node at `HOST:PORT`. An address of loopback is for everybody on this machine. Elsewhere the node shows its
    /// certificate, and wants one of the network.
    ///
    /// # Errors
    /// [`Code::BadConfiguration`] if nothing can listen there; [`Code::BadFile`] if the certificate cannot be used.
    pub(crate) async fn serve(
        address: &str,
        node: Arc<Description>,
        (identity, trust): (TlsIdentity, Arc<dyn TrustSource>),
    ) -> Result<Self, Rejection> {
        let listening = Doors::listen(address, "admin.listen").await?;
        let address = listening.1;
        let tls = match address.ip().is_loopback() {
            true => None,
            false => {
                let config = server_config(identity, trust);
                let mut config = config.map_err(|error| Rejection::new(Code::BadFile, error.to_string()))?;
                config.alpn_protocols = vec![b"http/1.1".to_vec()];
                Some(config)
            }
        };
        let room = Room { all_max: OPEN_MAX, each_max: OPEN_MAX, life_max: LIFE_MAX, tls, wants_certificate: true };
        let doors = Doors::open(listening, room);
        let page = Router::new()
            .route("/livez", get(live))
            .route("/readyz", get(ready))
            .route("/metrics", get(figures))
            .with_state(node);
        let serving = tokio::spawn(async move {
            if let Err(error) = axum::serve(doors, page).await {
                tracing::error!(%error, "the admin page ended");
            }
        });
        tracing::info!(%address, "admin page: /livez, /readyz, /metrics");
        Ok(Self { address, serving })
    }

    /// Where it listens; the port is the real one where the configuration said 0.
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Admin {
    fn drop(&mut self) {
        self.serving.abort();
    }
}

/// Does the process answer? A supervisor that restarts it otherwise asks this, and nothing else.
async fn live() -> &'static str {
    "ok\n"
}

/// Can the node do its work?
pub(crate) fn is_ready(node: &Description) -> bool {
    node.status().is_ok_and(|status| checks::all(&status).iter().all(Check::is_ok))
}

/// Can the node do its work? With `?verbose` every check is told, otherwise only those that failed.
async fn ready(State(node): State<Arc<Description>>, RawQuery(query): RawQuery) -> Response {
    let verbose = query.is_some_and(|query| query.split('&').any(|word| word.split('=').next() == Some("verbose")));
    let checks = match node.status() {
        Ok(status) => checks::all(&status),
        Err(fault) => vec![Check::failed("state", fault.to_string())],
    };
    let is_ready = checks.iter().all(Check::is_ok);
    let shown = checks.iter().filter(|check| verbose || !check.is_ok());
    let mut text: String = shown.map(ToString::to_string).collect();
    text.push_str(if is_ready { "ready\n" } else { "not ready\n" });
    let code = if is_ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    (code, text).into_response()
}

async fn figures(State(node): State<Arc<Description>>) -> Response {
    match node.status().and_then(|status| metrics::text(&status, node.meters())) {
        Ok(text) => ([(CONTENT_TYPE, OPEN_METRICS)], text).into_response(),
        Err(fault) => (StatusCode::INTERNAL_SERVER_ERROR, format!("{fault}\n")).into_response(),
    }
}
