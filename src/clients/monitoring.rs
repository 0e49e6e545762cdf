//! The page for whoever watches a node or a bridge: is it alive, is it ready, and its figures. HTTP, read only.
//!
//! ```text
//! admin       the addresses: /livez, /readyz, /metrics
//!   check     a part of readiness
//!   figures   figures
//!   exposition  their forms: OpenMetrics, and the text form of Prometheus
//!   node      the checks and the figures of a node
//!   bridge    those of a bridge
//! ```

mod bridge;
mod check;
mod exposition;
mod figures;
mod node;

use crate::clients::http::{Names, foreign, host_of};
use crate::process::config::BridgePage;
use crate::process::page_connections::{Doors, Room};
use crate::process::tls_files::TlsFiles;
use axum::Router;
use axum::extract::{RawQuery, Request, State};
use axum::http::header::{CONTENT_TYPE, VARY};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use check::Check;
use exposition::Exposition;
use ledger_api::tls::{TlsIdentity, TrustSource, server_config};
use ledger_base::rejection::{Code, Rejection};
pub(crate) use node::{WatchedNode, is_ready};
use prometheus_client::encoding::text::encode;
use prometheus_client::registry::Registry;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::version::TLS13;

/// Most connections at a time.
const OPEN_MAX: usize = 32;
/// Longest life of one. A program that watches connects again.
const LIFE_MAX: Duration = Duration::from_secs(60);

/// A part of this program that is watched through the page.
pub(crate) trait Watched: Send + Sync + 'static {
    /// The parts of readiness, as they are now.
    fn checks(&self) -> Vec<Check>;

    /// Registers the figures, as they are now.
    ///
    /// # Errors
    /// The reason why they cannot be read.
    fn register(&self, registry: &mut Registry) -> Result<(), Rejection>;
}

/// The certificate that the page shows, and the ones that it accepts.
pub(crate) enum PageCredentials {
    /// That of a node, and those of the members of its network.
    OfNetwork(TlsIdentity, Arc<dyn TrustSource>),
    /// Those of an operator, if there are any.
    OfFiles(BridgePage),
}

/// The page, as long as it is served. It ends when it is dropped.
pub(crate) struct Admin {
    address: SocketAddr,
    serving: JoinHandle<()>,
}

impl Admin {
    /// Serves the page at `HOST:PORT`. An address of loopback is for everybody on this machine. Elsewhere it shows its certificate, and
    /// wants one of the network, or from the authorities of the files; without files it is on loopback only. Plain HTTP is answered by
    /// address, by `localhost` and by the name in `address` only, so that no foreign page reads it under a name of its own.
    ///
    /// # Errors
    /// [`Code::BadConfiguration`] if nothing can listen there, or may; [`Code::BadFile`] if the certificate cannot be used.
    pub(crate) async fn serve(
        address: &str,
        watched: Arc<dyn Watched>,
        papers: PageCredentials,
    ) -> Result<Self, Rejection> {
        let listening = Doors::listen(address, "admin.listen").await?;
        let bound = listening.1;
        let tls = secured(bound, papers)?;
        // By TLS a browser would need a certificate, and would compare the name with that of the node.
        let names = tls.is_none().then(|| Arc::new(Names::new([host_of(address).to_owned()], false)));
        let room = Room { all_max: OPEN_MAX, each_max: OPEN_MAX, life_max: LIFE_MAX, tls, wants_certificate: true };
        let doors = Doors::open(listening, room);
        let page = Router::new()
            .route("/livez", get(live))
            .route("/readyz", get(ready))
            .route("/metrics", get(figures))
            .with_state(watched);
        let page = match names {
            Some(names) => page.layer(from_fn_with_state(names, guarded)),
            None => page,
        };
        let serving = tokio::spawn(async move {
            if let Err(error) = axum::serve(doors, page).await {
                tracing::error!(%error, "monitoring endpoint failed");
            }
        });
        tracing::info!(address = %bound, "monitoring endpoint listening: /livez, /readyz, /metrics");
        Ok(Self { address: bound, serving })
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

/// TLS for a page that listens there; none for plain HTTP.
fn secured(address: SocketAddr, papers: PageCredentials) -> Result<Option<ServerConfig>, Rejection> {
    let mut config = match papers {
        PageCredentials::OfFiles(page) if page.is_secured() => of_files(&page)?,
        _ if address.ip().is_loopback() => return Ok(None),
        PageCredentials::OfNetwork(identity, trust) => {
            server_config(identity, trust).map_err(|error| Rejection::new(Code::BadFile, error.to_string()))?
        }
        PageCredentials::OfFiles(_) => return Err(only_on_loopback(address)),
    };
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(Some(config))
}

fn of_files(page: &BridgePage) -> Result<ServerConfig, Rejection> {
    const FILES: TlsFiles = TlsFiles("admin");
    let provider = Arc::new(ring::default_provider());
    let clients = FILES.clients(&page.clients, Arc::clone(&provider))?;
    let (chain, key) = (FILES.chain(&page.certificate)?, FILES.key(&page.key)?);
    let config = ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&TLS13])
        .map_err(|error| Rejection::new(Code::Internal, error.to_string()))?
        .with_client_cert_verifier(clients)
        .with_single_cert(chain, key);
    let mut config = config.map_err(|error| FILES.unusable(&page.certificate, &error.to_string()))?;
    config.send_tls13_tickets = 0;
    Ok(config)
}

fn only_on_loopback(address: SocketAddr) -> Rejection {
    Rejection::new(
        Code::BadConfiguration,
        "without a certificate, the monitoring endpoint of a bridge is limited to \
                                            its own machine",
    )
    .found(format!("admin.listen = {:?}", address.to_string()))
    .wanted("a loopback address, for example \"127.0.0.1:9465\"; or TLS")
    .next("set certificate, key and clients in [admin] (docs/metrics.md), or run the bridge inside a node")
}

/// Rejects requests by a foreign name, and from pages of browsers.
async fn guarded(State(names): State<Arc<Names>>, request: Request, next: Next) -> Response {
    match names.origin(request.headers(), request.method()) {
        Some(_) => next.run(request).await,
        None => foreign("this page", "use an address, or the name in [admin] listen"),
    }
}

/// Does the process answer? A supervisor that restarts it otherwise asks this, and nothing else.
async fn live() -> &'static str {
    "ok\n"
}

fn is_well(checks: &[Check]) -> bool {
    checks.iter().all(Check::is_ok)
}

/// Can it do its work? With `?verbose` every check is told, otherwise only those that failed.
async fn ready(State(watched): State<Arc<dyn Watched>>, RawQuery(query): RawQuery) -> Response {
    let verbose = query.is_some_and(|query| query.split('&').any(|word| word.split('=').next() == Some("verbose")));
    let checks = watched.checks();
    let is_ready = is_well(&checks);
    let shown = checks.iter().filter(|check| verbose || !check.is_ok());
    let mut text: String = shown.map(ToString::to_string).collect();
    text.push_str(if is_ready { "ready\n" } else { "not ready\n" });
    let code = if is_ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    (code, text).into_response()
}

async fn figures(State(watched): State<Arc<dyn Watched>>, headers: HeaderMap) -> Response {
    let form = Exposition::accepted(&headers);
    match encoded(&*watched) {
        Ok(text) => ([(CONTENT_TYPE, form.content_type()), (VARY, "accept")], form.render(text)).into_response(),
        Err(fault) => (StatusCode::INTERNAL_SERVER_ERROR, format!("{fault}\n")).into_response(),
    }
}

/// The figures as OpenMetrics.
fn encoded(watched: &dyn Watched) -> Result<String, Rejection> {
    let mut registry = Registry::with_prefix("ledgerd");
    watched.register(&mut registry)?;
    let mut text = String::new();
    encode(&mut text, &registry).map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
    Ok(text)
}
