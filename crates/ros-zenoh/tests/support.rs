//! A router, nodes, and waiting for things to happen.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use bytes::Bytes;
use ros_zenoh::{
    attachment::Attachment,
    gid::Gid,
    key::Subject,
    node::Node,
    qos::TokenQos,
    settings::{Mode, Settings},
    subscriber::{Incoming, Subscriber},
    token::Kind,
};

pub(crate) const DEADLINE: Duration = Duration::from_secs(20);
pub(crate) const DOMAIN: u16 = 7;
/// Largest message in these tests, in bytes.
pub(crate) const BYTES_MAX: usize = 1024;

/// An address of this host at which nobody listens.
pub(crate) fn free_endpoint() -> String {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    format!("tcp/{}", listener.local_addr().unwrap())
}

/// A router at that endpoint.
pub(crate) async fn router(endpoint: &str) -> Node {
    let settings = Settings { mode: Mode::Router, listen: vec![endpoint.parse().unwrap()], ..Settings::default() };
    Node::join(DOMAIN, "router", &settings).await.unwrap()
}

/// A client of that router.
pub(crate) fn client_of(endpoint: &str) -> Settings {
    Settings { connect: vec![endpoint.parse().unwrap()], ..Settings::default() }
}

/// A router, and two of its clients.
pub(crate) async fn graph() -> (Node, [Node; 2]) {
    let endpoint = free_endpoint();
    let router = router(&endpoint).await;
    let one = Node::join(DOMAIN, "one", &client_of(&endpoint)).await.unwrap();
    let other = Node::join(DOMAIN, "other", &client_of(&endpoint)).await.unwrap();
    (router, [one, other])
}

pub(crate) fn subject(name: &str) -> Subject {
    let hash = format!("RIHS01_{}", "0a".repeat(32));
    Subject { name: name.to_owned(), type_name: "geometry_msgs::msg::dds_::Vector3_".to_owned(), hash: Some(hash) }
}

pub(crate) fn latched(depth: usize) -> TokenQos {
    TokenQos { is_latched: true, depth: Some(depth), ..TokenQos::default() }
}

pub(crate) fn message(number: u8) -> Bytes {
    Bytes::from(vec![0, 1, 0, 0, number, number, number, number])
}

/// Waits for a condition.
pub(crate) async fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let done = async {
        while !holds() {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    assert!(tokio::time::timeout(DEADLINE, done).await.is_ok(), "{what}");
}

/// The endpoints of a kind and a name that a node sees.
pub(crate) fn seen(node: &Node, kind: Kind, name: &str) -> Vec<Gid> {
    let endpoints = node.graph().endpoints();
    let found = endpoints.iter().filter(|one| one.token.kind == kind && one.token.subject.name == name);
    found.map(|one| one.gid).collect()
}

/// A subscriber, and everything that it has received.
pub(crate) struct Received {
    _subscriber: Subscriber,
    taken: Arc<Mutex<Vec<Incoming>>>,
}

impl Received {
    pub(crate) fn open(node: &Node, subject: &Subject, qos: TokenQos) -> Self {
        let taken = Arc::new(Mutex::new(Vec::new()));
        let taking = Arc::clone(&taken);
        let subscriber =
            node.subscriber(subject, qos, BYTES_MAX, move |incoming| taking.lock().unwrap().push(incoming));
        Self { _subscriber: subscriber.unwrap(), taken }
    }

    pub(crate) fn count(&self) -> usize {
        self.taken.lock().unwrap().len()
    }

    /// Waits for so many, and takes them.
    pub(crate) async fn take(&self, count: usize) -> Vec<Incoming> {
        until(&format!("{count} messages"), || self.count() >= count).await;
        std::mem::take(&mut *self.taken.lock().unwrap())
    }

    /// Waits for so many messages, and takes them.
    pub(crate) async fn messages(&self, count: usize) -> Vec<(Bytes, Attachment)> {
        let only = |incoming| match incoming {
            Incoming::Message(message, attachment) => (message, attachment),
            other => unreachable!("{other:?}"),
        };
        self.take(count).await.into_iter().map(only).collect()
    }
}
