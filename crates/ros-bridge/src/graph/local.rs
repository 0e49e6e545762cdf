//! The presence of a bridge in the local graph: every topic over the middleware, and beside it in shared memory.

mod iceoryx2;
mod input;
mod output;
mod rtps;
mod transport;
#[cfg(feature = "zenoh")]
mod zenoh;

use std::sync::Arc;

use tokio::sync::watch;

pub(crate) use self::{
    input::TopicInput,
    output::TopicOutput,
    transport::{
        Caller, Client, Input, InputSettings, Middleware, Number, Output, OutputSettings, Reply, Request, Server,
        Transport,
    },
};
use super::{
    choice::MiddlewareChoice,
    dds::Participant,
    loop_filter::{Delivered, LoopFilter},
    mark::Mark,
    names::{TopicName, TypeName},
    qos::Qos,
    queue::Limits,
    reach::Reach,
    shm,
};
use crate::error::{Error, Result};

/// Our presence in the local graph: one identity and one origin for all routes, so that nothing a bridge publishes is taken in by it
/// again.
#[derive(Clone)]
pub(crate) struct LocalGraph {
    middleware: Arc<dyn Middleware>,
    /// Shared memory, if it is used.
    beside: Option<Arc<dyn Transport>>,
    delivered: Arc<Delivered>,
}

impl LocalGraph {
    /// Joins a ROS domain.
    ///
    /// # Errors
    /// As [`Participant::join`], or as the middleware refuses; without shared memory only the middleware is used.
    pub(crate) async fn join(
        domain: u16,
        (choice, reach): (&MiddlewareChoice, &Reach),
        node_name: &str,
        shared_memory: bool,
    ) -> Result<Self> {
        let middleware = joined(domain, choice, reach, node_name).await?;
        let beside = match shared_memory {
            true => {
                let (origin, name) = (middleware.identity(), shm::bridge_name(node_name, middleware.identity()));
                let node = or_without("any topic", &*middleware, shm::Node::open(domain, &name, origin).await);
                node.map(|node| -> Arc<dyn Transport> { Arc::new(node) })
            }
            false => None,
        };
        Ok(Self { middleware, beside, delivered: Arc::default() })
    }

    /// The middleware, which carries the whole graph.
    pub(crate) fn middleware(&self) -> &Arc<dyn Middleware> {
        &self.middleware
    }

    /// The known deliveries of bridges to this graph.
    pub(crate) fn delivered(&self) -> &Arc<Delivered> {
        &self.delivered
    }

    /// Reads a topic behind a filter. It follows the quality of service.
    ///
    /// # Errors
    /// As [`Transport::input`] of the middleware.
    pub(crate) async fn input(
        &self,
        topic: &TopicName,
        message: &TypeName,
        qos: watch::Receiver<Qos>,
        limits: Limits,
        filter: Arc<LoopFilter>,
    ) -> Result<TopicInput> {
        let settings = InputSettings { topic: topic.clone(), message: message.clone(), limits, filter: Some(filter) };
        let first = *qos.borrow();
        let mut input = TopicInput::open(&self.middleware, settings.clone(), qos).await?;
        if let Some(beside) = &self.beside {
            input.add(or_without(topic.as_str(), &*self.middleware, beside.input(&settings, &first).await));
        }
        Ok(input)
    }

    /// Writes on a topic, with the mark of a service.
    ///
    /// # Errors
    /// As [`Transport::output`] of the middleware.
    pub(crate) async fn output(
        &self,
        topic: &TopicName,
        message: &TypeName,
        qos: &Qos,
        mark: Mark,
    ) -> Result<TopicOutput> {
        self.delivered.begins(mark);
        let settings = OutputSettings { topic: topic.clone(), message: message.clone(), mark: Some(mark) };
        let delivered = Arc::clone(&self.delivered);
        let mut output = TopicOutput::open(&self.middleware, (settings.clone(), mark), qos, delivered).await?;
        if let Some(beside) = &self.beside {
            output.add(or_without(topic.as_str(), &*self.middleware, beside.output(&settings, qos).await));
        }
        Ok(output)
    }
}

/// Joins the domain over the chosen middleware.
async fn joined(domain: u16, choice: &MiddlewareChoice, reach: &Reach, node_name: &str) -> Result<Arc<dyn Middleware>> {
    match choice {
        MiddlewareChoice::Dds => Ok(Arc::new(Participant::join(domain, node_name, reach).await?)),
        #[cfg(feature = "zenoh")]
        MiddlewareChoice::Zenoh(settings) => {
            Ok(Arc::new(super::zenoh::Session::join(domain, node_name, settings, reach).await?))
        }
        #[cfg(not(feature = "zenoh"))]
        MiddlewareChoice::Zenoh(_) => Err(Error::Setting(super::choice::without_zenoh())),
    }
}

/// Shared memory that cannot be used does not keep a topic from the middleware.
fn or_without<T>(topic: &str, middleware: &dyn Middleware, opened: Result<T>) -> Option<T> {
    let warn = |error: &Error| {
        let only = middleware.name();
        tracing::warn!(topic, %error, "shared memory is not used for {topic}, only {only}, until this bridge starts again");
    };
    opened.inspect_err(warn).ok()
}
