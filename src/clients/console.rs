//! The console: a web application for people with a browser, served by the node itself (docs/console.md).
//!
//! A browser has no client certificate that a page may choose. So it proves its identity in the page: its key signs a challenge and
//! opens a session, which lives in the page's memory. Under the session it uses the [HTTP API](crate::clients::http). Nothing can be written
//! that is not signed by the browser's key.
//!
//! ```text
//! console      the listener, and what is behind it
//!   guard      rejects other hosts and origins; headers of every answer
//!   files      the application
//!   opening    challenges and sessions over HTTP
//!     challenge  a challenge that nobody needs to remember
//!     sessions   the sessions that are open
//!   calls      the HTTP API under a session
//!   secured    its certificate
//! ```

mod calls;
mod challenge;
mod files;
mod guard;
mod opening;
mod secured;
mod sessions;

#[cfg(test)]
pub(crate) use opening::SESSION_ENDPOINTS;

use crate::clients::gateway::GatewayService;
use crate::clients::http::{Names, elsewhere, other_method};
use crate::process::config;
use crate::process::page_connections::{Doors, Room, Source};
use crate::trust::enrolment::{EnrolmentService, Tries};
use axum::extract::ConnectInfo;
use axum::middleware::from_fn_with_state;
use axum::serve::Listener;
use axum::{Extension, Router};
use challenge::Challenges;
use hyper::server::conn::http1::Builder;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use ledger_api::tls::TrustSource;
use ledger_base::rejection::{Code, Rejection};
use sessions::{LIFE_MAX, Sessions};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::task::{JoinHandle, JoinSet};

/// Most connections at a time: a browser opens up to six.
const OPEN_MAX: usize = 256;
/// Most connections of one address.
const EACH_MAX: usize = 64;
/// Longest time in which the head of a request has to arrive, and that a connection may be idle.
const HEAD_TIME_MAX: Duration = Duration::from_secs(60);

/// The parts of a node that the console shows.
pub(crate) struct Parts {
    /// Answers calls.
    pub(crate) gateway: GatewayService,
    /// Enrols browsers.
    pub(crate) enrolment: EnrolmentService,
    /// Knows who is who.
    pub(crate) trust: Arc<dyn TrustSource>,
}

/// The console, as long as it is served. It ends when it is dropped.
pub(crate) struct Console {
    address: String,
    serving: JoinHandle<()>,
}

/// The parts that the handlers share.
struct Shared {
    parts: Parts,
    names: Names,
    challenges: Challenges,
    sessions: Sessions,
    /// Sessions that were refused lately.
    tries: Mutex<Tries>,
}

impl Console {
    /// Serves the console of a node that others reach at `reached`, `HOST:PORT`.
    ///
    /// # Errors
    /// [`Code::BadConfiguration`] if nothing can listen there; [`Code::BadFile`] if the certificate cannot be used.
    pub(crate) async fn serve(settings: &config::Console, reached: &str, parts: Parts) -> Result<Self, Rejection> {
        let listening = Doors::listen(&settings.listen, "console.listen").await?;
        let hosts = guard::hosts(settings, reached);
        let tls = secured::tls(settings, listening.1, &hosts)?;
        let names = Names::new(hosts, tls.is_some());
        let names = if tls.is_some() { names } else { names.proxied(&settings.name) };
        let address = guard::address(names.scheme(), settings, reached, listening.1);
        let room = Room {
            all_max: OPEN_MAX,
            each_max: each_max(listening.1),
            life_max: LIFE_MAX,
            tls,
            wants_certificate: false,
        };
        let doors = Doors::open(listening, room);
        let challenges = Challenges::new().ok_or_else(|| {
            Rejection::new(
                Code::Internal,
                "the operating system \
                                                                                         provides no randomness",
            )
        })?;
        let shared = Shared { parts, names, challenges, sessions: Sessions::default(), tries: Mutex::default() };
        let serving = tokio::spawn(connections(doors, router(Arc::new(shared))));
        tracing::info!(%address, "console listening");
        Ok(Self { address, serving })
    }

    /// Where browsers find it, such as `http://127.0.0.1:7452`.
    pub(crate) fn address(&self) -> &str {
        &self.address
    }
}

impl Drop for Console {
    fn drop(&mut self) {
        self.serving.abort();
    }
}

/// On loopback, all browsers have the same address.
fn each_max(address: SocketAddr) -> usize {
    if address.ip().is_loopback() { OPEN_MAX } else { EACH_MAX }
}

/// Serves each connection until it ends. All end with this future.
async fn connections(mut doors: Doors, router: Router) {
    let mut http = Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME_MAX);
    let mut open = JoinSet::new();
    loop {
        let (io, from) = doors.accept().await;
        while open.try_join_next().is_some() {}
        let service = router.clone().layer(Extension(ConnectInfo(Source(from.ip()))));
        open.spawn(http.serve_connection(TokioIo::new(io), TowerToHyperService::new(service)).into_future());
    }
}

fn router(shared: Arc<Shared>) -> Router {
    let (calls, opening) = (calls::router(&shared), opening::router(Arc::clone(&shared)));
    let router = files::router().merge(opening).merge(calls);
    let router = router.method_not_allowed_fallback(other_method).fallback(elsewhere);
    router.layer(from_fn_with_state(shared, guard::guarded))
}
