//! A zenoh session as a ROS 2 node.

use std::{
    fmt,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use ros2_client::zenoh::{Context, ContextOptions};
use tokio::runtime::{Handle, RuntimeFlavor};
use zenoh::{Config, Session, Wait, liveliness::LivelinessToken, pubsub::Subscriber, sample::SampleKind};

use crate::{
    error::{Error, failed},
    graph::Graph,
    limits::MESSAGE_BYTES_MAX,
    settings::{Endpoint, Mode, Settings},
    token::{NodeIdentity, all_of},
};

/// The number of the only node of a session.
const NODE_NUMBER: u64 = 0;

/// A node in the graph. Cloning shares it; it leaves when the last clone and the last endpoint are gone.
#[derive(Clone)]
pub struct Node {
    pub(crate) inner: Arc<Inner>,
}

pub(crate) struct Inner {
    pub(crate) session: Session,
    pub(crate) identity: NodeIdentity,
    graph: Graph,
    /// The next number of an endpoint.
    next: AtomicU64,
    _token: LivelinessToken,
    _tokens: Subscriber<()>,
    _context: Context,
}

impl Node {
    /// Joins the graph of a domain. A client waits for its router, as long as zenoh's timeout says.
    ///
    /// # Errors
    /// If a setting is refused, no router answers, an address to listen at is taken, or the tokio runtime has no worker threads.
    pub async fn join(domain: u16, name: &str, settings: &Settings) -> Result<Self, Error> {
        if Handle::current().runtime_flavor() == RuntimeFlavor::CurrentThread {
            return Err(Error::Zenoh("zenoh needs a tokio runtime with worker threads".to_owned()));
        }
        let (name, settings) = (name.to_owned(), settings.clone());
        // It waits for the network.
        tokio::task::spawn_blocking(move || Self::open(domain, name, &settings)).await.map_err(failed)?
    }

    fn open(domain: u16, name: String, settings: &Settings) -> Result<Self, Error> {
        let options = ContextOptions::new().domain_id(domain).zenoh_config(config(settings)?);
        let context = Context::with_options(options).map_err(failed)?;
        let session = context.session().clone();
        let identity = NodeIdentity {
            domain,
            session: session.zid().to_string(),
            number: NODE_NUMBER,
            namespace: "/".to_owned(),
            name,
        };
        let graph = Graph::new(&identity.session);
        let known = graph.clone();
        let tokens = session.liveliness().declare_subscriber(all_of(domain)).history(true);
        let tokens = tokens.callback(move |sample| match sample.kind() {
            SampleKind::Put => known.add(sample.key_expr().as_str()),
            SampleKind::Delete => known.remove(sample.key_expr().as_str()),
        });
        let tokens = tokens.wait().map_err(failed)?;
        let token = session.liveliness().declare_token(identity.token()).wait().map_err(failed)?;
        let next = AtomicU64::new(NODE_NUMBER + 1);
        let inner = Inner { session, identity, graph, next, _token: token, _tokens: tokens, _context: context };
        Ok(Self { inner: Arc::new(inner) })
    }

    /// The endpoints of others.
    pub fn graph(&self) -> &Graph {
        &self.inner.graph
    }

    /// The node as its token names it.
    pub fn identity(&self) -> &NodeIdentity {
        &self.inner.identity
    }

    /// Has the session ended?
    pub fn is_ended(&self) -> bool {
        self.inner.session.is_closed()
    }

    /// Ends the session. Nothing passes any more.
    pub fn end(&self) {
        if let Err(error) = self.inner.session.close().wait() {
            tracing::debug!(%error, "the zenoh session was not closed in order");
        }
    }

    /// The next number of an endpoint.
    pub(crate) fn next_number(&self) -> u64 {
        self.inner.next.fetch_add(1, Ordering::Relaxed)
    }
}

impl fmt::Debug for Node {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Node").field("identity", &self.inner.identity).finish_non_exhaustive()
    }
}

/// The configuration of zenoh for these settings, without scouting by multicast: every link is named.
fn config(settings: &Settings) -> Result<Config, Error> {
    let mut config = Config::default();
    let mut set = |key: &str, value: String| {
        config.insert_json5(key, &value).map_err(|error| Error::Zenoh(format!("{key} = {value}: {error}")))
    };
    let is_client = settings.mode == Mode::Client;
    set("mode", text(settings.mode.name()))?;
    set("connect/endpoints", list(&settings.connect))?;
    set("listen/endpoints", list(if is_client { &[] } else { &settings.listen }))?;
    set("scouting/multicast/enabled", "false".to_owned())?;
    // Peers learn of each other through their router, as in rmw_zenoh.
    set("scouting/gossip/enabled", (!is_client).to_string())?;
    // Late subscribers get samples in the order of their times.
    set("timestamping/enabled", "true".to_owned())?;
    set("transport/link/rx/max_message_size", MESSAGE_BYTES_MAX.to_string())?;
    set("transport/shared_memory/enabled", "false".to_owned())?;
    let tls = &settings.tls;
    for (key, path) in [
        ("root_ca_certificate", &tls.ca),
        ("connect_certificate", &tls.certificate),
        ("connect_private_key", &tls.key),
        ("listen_certificate", &tls.certificate),
        ("listen_private_key", &tls.key),
    ] {
        if let Some(path) = path {
            set(&format!("transport/link/tls/{key}"), text(&path_text(path)?))?;
        }
    }
    set("transport/link/tls/enable_mtls", tls.certificate.is_some().to_string())?;
    if let Some(rules) = &settings.access_control {
        set("access_control", rules.clone())?;
    }
    Ok(config)
}

fn path_text(path: &Path) -> Result<String, Error> {
    path.to_str().map(str::to_owned).ok_or_else(|| Error::Zenoh(format!("{} is no UTF-8", path.display())))
}

fn list(endpoints: &[Endpoint]) -> String {
    let texts: Vec<String> = endpoints.iter().map(|endpoint| text(&endpoint.to_string())).collect();
    format!("[{}]", texts.join(","))
}

/// A text as JSON has it.
fn text(plain: &str) -> String {
    let mut quoted = "\"".to_owned();
    for c in plain.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => quoted.push_str(&format!("\\u{:04x}", u32::from(c))),
            c => quoted.push(c),
        }
    }
    quoted.push('"');
    quoted
}
