//! Another ROS 2 node beside a bridge: over DDS, or over zenoh where [`TRANSPORT`] asks for it. The tests are the same.

use std::{sync::Arc, time::Duration};

use ledger_gate::sample::Sample;

use super::DOMAIN;
use crate::{
    error::Result,
    graph::{
        dds::{Matched, Participant},
        local::{Input, InputSettings, Middleware, Output, OutputSettings},
        names::{TopicName, TypeName},
        qos::Qos,
        queue::{Incoming, Limits},
    },
};

/// Set to `zenoh`, it runs these tests over zenoh, if this program has it.
const TRANSPORT: &str = "LEDGERD_TEST_TRANSPORT";

/// The middleware of these tests, as a line of a configuration.
pub(super) fn transport() -> &'static str {
    if is_zenoh() { "transport = 'zenoh'" } else { "transport = 'dds'" }
}

fn is_zenoh() -> bool {
    std::env::var(TRANSPORT).is_ok_and(|transport| transport == "zenoh")
}

/// Starts the router that zenoh needs.
pub(super) async fn prepare() {
    #[cfg(feature = "zenoh")]
    if is_zenoh() {
        zenoh::router().await;
    }
}

/// The node.
pub(super) struct Beside(Arc<dyn Middleware>);

impl Beside {
    pub(super) async fn open(name: &str) -> Self {
        #[cfg(feature = "zenoh")]
        if is_zenoh() {
            return Self(zenoh::node(name).await);
        }
        assert!(!is_zenoh(), "this program has no zenoh");
        Self(Arc::new(Participant::open(DOMAIN, name).await.unwrap()))
    }

    pub(super) async fn reader(
        &self,
        topic: &TopicName,
        message: &TypeName,
        qos: &Qos,
        limits: Limits,
    ) -> Result<Reader> {
        let settings = InputSettings { topic: topic.clone(), message: message.clone(), limits, filter: None };
        self.0.input(&settings, qos).await.map(Reader)
    }

    pub(super) async fn writer(&self, topic: &TopicName, message: &TypeName, qos: &Qos) -> Result<Writer> {
        let settings = OutputSettings { topic: topic.clone(), message: message.clone(), mark: None };
        self.0.output(&settings, qos).await.map(Writer)
    }
}

pub(super) struct Reader(Box<dyn Input>);

impl Reader {
    pub(super) async fn next(&mut self) -> Option<Incoming> {
        self.0.next().await
    }

    pub(super) fn matched(&self) -> &Matched {
        self.0.matched().unwrap()
    }
}

pub(super) struct Writer(Box<dyn Output>);

impl Writer {
    pub(super) fn write(&self, sample: &Sample) -> Result<()> {
        self.0.write(sample)
    }

    pub(super) async fn flush(&self, at_most: Duration) -> bool {
        self.0.flush(at_most).await
    }

    pub(super) fn matched(&self) -> &Matched {
        self.0.matched().unwrap()
    }
}

#[cfg(feature = "zenoh")]
mod zenoh {
    use std::sync::Arc;

    use ros_zenoh::{
        node::Node,
        settings::{Mode, Settings},
    };
    use tokio::sync::OnceCell;

    use super::DOMAIN;
    use crate::graph::{local::Middleware, reach::Reach, zenoh::Session};

    /// That of the default settings. Each test has a network of its own.
    const ENDPOINT: &str = "tcp/127.0.0.1:7447";

    static ROUTER: OnceCell<Node> = OnceCell::const_new();

    pub(super) async fn router() {
        let settings = Settings { mode: Mode::Router, listen: vec![ENDPOINT.parse().unwrap()], ..Settings::default() };
        ROUTER.get_or_init(|| async { Node::join(DOMAIN, "router", &settings).await.unwrap() }).await;
    }

    pub(super) async fn node(name: &str) -> Arc<dyn Middleware> {
        router().await;
        let settings = Settings { connect: vec![ENDPOINT.parse().unwrap()], ..Settings::default() };
        Arc::new(Session::join(DOMAIN, name, &settings, &Reach::default()).await.unwrap())
    }
}
