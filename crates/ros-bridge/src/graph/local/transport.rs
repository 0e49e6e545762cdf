//! The transports of the local graph, as routes use them. A route does not know which one it has.
//!
//! A [`Transport`] carries topics: DDS, zenoh, shared memory. A [`Middleware`] is one that carries the whole graph, with services and
//! discovery: DDS or zenoh.

use std::{collections::BTreeSet, net::Ipv4Addr, sync::Arc, time::Duration};

use bytes::Bytes;
use futures::{FutureExt, future::BoxFuture};
use ledger_gate::sample::Sample;
use tokio::sync::watch;

use crate::{
    error::Result,
    graph::{
        dds::{self, Change, Exchange, Matched},
        loop_filter::LoopFilter,
        mark::Mark,
        names::{TopicName, TypeName},
        qos::Qos,
        queue::{Incoming, Limits, Queue},
        shm::Peers,
    },
};

/// A topic that is read.
#[derive(Clone)]
pub(crate) struct InputSettings {
    pub(crate) topic: TopicName,
    pub(crate) message: TypeName,
    pub(crate) limits: Limits,
    /// Set where samples go to the ledger: only what it admits is given out, and other bridges see whose it is.
    pub(crate) filter: Option<Arc<LoopFilter>>,
}

/// A topic that is written.
#[derive(Clone)]
pub(crate) struct OutputSettings {
    pub(crate) topic: TopicName,
    pub(crate) message: TypeName,
    /// Set where samples come from the ledger: no bridge of that network takes them in.
    pub(crate) mark: Option<Mark>,
}

/// A transport of topics.
pub(crate) trait Transport: Send + Sync {
    /// Its name in messages.
    fn name(&self) -> &'static str;

    /// Starts to read a topic. Samples of the own outputs are never given out.
    fn input<'a>(&'a self, settings: &'a InputSettings, qos: &'a Qos) -> BoxFuture<'a, Result<Box<dyn Input>>>;

    /// Starts to write a topic.
    fn output<'a>(&'a self, settings: &'a OutputSettings, qos: &'a Qos) -> BoxFuture<'a, Result<Box<dyn Output>>>;
}

/// A transport that carries the whole graph.
pub(crate) trait Middleware: Transport {
    /// Unique in the world, new with every start.
    fn identity(&self) -> [u8; 16];

    /// The hosts of participants that exchange no message with this bridge, one for each.
    fn unreachable(&self) -> Vec<Ipv4Addr> {
        Vec::new()
    }

    /// Is this publisher of another in the graph?
    fn has_publisher(&self, publisher: &[u8; 16]) -> bool;

    /// Reports, as long as it runs, publishers and subscribers that come and leave. See [`dds::Participant::follow`].
    fn follow(
        &self,
        topics: watch::Receiver<BTreeSet<String>>,
        report: Box<dyn FnMut(Change) + Send>,
    ) -> BoxFuture<'static, ()>;

    /// Becomes a client of a service. Bridges of the mark's network are not called.
    fn client(&self, exchange: &Exchange, mark: Mark, bytes_max: usize) -> Result<Box<dyn Client>>;

    /// Starts to offer a service. Requests of bridges of the mark's network are not taken in.
    fn server(&self, exchange: &Exchange, mark: Mark, bytes_max: usize) -> Result<Box<dyn Server>>;

    /// Ends as a fault would end it.
    #[cfg(test)]
    fn break_down(&self);
}

/// Where samples of a topic come in; ends when dropped.
pub(crate) trait Input: Send + Sync {
    /// The samples that wait, and the count of those that were lost.
    fn queue(&self) -> &Queue;

    /// The publishers of others, if the transport carries the whole graph.
    fn matched(&self) -> Option<&Matched> {
        None
    }

    /// The publishers of others, if it is shared memory.
    fn in_memory(&self) -> Option<Peers> {
        None
    }
}

impl dyn Input {
    /// The next sample, as soon as there is one; none if the transport has ended. Cancelling it loses nothing.
    pub(crate) async fn next(&mut self) -> Option<Incoming> {
        self.queue().next().await
    }

    /// The next sample if one waits.
    pub(crate) fn try_next(&mut self) -> Option<Incoming> {
        self.queue().try_next()
    }

    /// Samples lost so far: too large, not readable, or replaced by newer ones.
    pub(crate) fn dropped(&self) -> u64 {
        self.queue().dropped()
    }
}

/// Where samples of a topic go out; leaves the graph when dropped.
pub(crate) trait Output: Send + Sync {
    /// Publishes a sample. It does not wait for subscribers.
    fn write(&self, sample: &Sample) -> Result<()>;

    /// Waits until reliable subscribers have everything, as far as the transport knows; false after `at_most`.
    fn flush(&self, _at_most: Duration) -> BoxFuture<'_, bool> {
        async { true }.boxed()
    }

    /// The subscribers of others, if the transport carries the whole graph.
    fn matched(&self) -> Option<&Matched> {
        None
    }

    /// The subscribers of others, if it is shared memory.
    fn in_memory(&self) -> Option<Peers> {
        None
    }
}

/// Calls a service; leaves the graph when dropped.
pub(crate) trait Client: Send + Sync {
    /// Calls the server.
    ///
    /// # Errors
    /// [`crate::error::Error::Unserved`] if there is none, [`crate::error::Error::Slow`], [`crate::error::Error::Dds`].
    fn call(&mut self, message: &[u8]) -> Result<Number>;

    /// The next reply to a request of this client; none if the middleware has ended. Cancelling it loses nothing.
    fn next(&mut self) -> BoxFuture<'_, Option<Reply>>;

    /// The servers of others.
    fn matched(&self) -> &Matched;
}

/// Serves a service; leaves the graph when dropped.
pub(crate) trait Server: Send + Sync {
    /// The next request; none if the middleware has ended. Cancelling it loses nothing.
    fn next(&mut self) -> BoxFuture<'_, Option<Request>>;

    /// Replies to a request.
    ///
    /// # Errors
    /// [`crate::error::Error::Slow`], [`crate::error::Error::Dds`].
    fn reply(&mut self, caller: &Caller, message: &[u8]) -> Result<()>;

    /// Is the client that has called still there?
    fn is_there(&self, caller: &Caller) -> bool;

    /// The clients of others.
    fn matched(&self) -> &Matched;
}

/// The number of a request of a client.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Number {
    Dds(dds::Number),
    #[cfg(feature = "zenoh")]
    Zenoh(i64),
}

/// A reply.
#[derive(Debug, Clone)]
pub(crate) struct Reply {
    /// The request.
    pub(crate) number: Number,
    /// The message, little endian CDR without its encapsulation header.
    pub(crate) message: Bytes,
}

/// A client that has called, and its request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Caller {
    Dds(dds::Caller),
    #[cfg(feature = "zenoh")]
    Zenoh(ros_zenoh::server::RequestId),
}

/// A request.
#[derive(Debug, Clone)]
pub(crate) struct Request {
    /// The message, little endian CDR without its encapsulation header.
    pub(crate) message: Bytes,
    /// To be named in the reply.
    pub(crate) caller: Caller,
}
