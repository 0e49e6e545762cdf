//! A client of a ROS 2 service.

use std::time::Duration;

use bytes::Bytes;
use ros_zenoh::{client::Client as Raw, key::Subject, node::Node, token::Kind};

use super::{
    failure::zenoh_error,
    matching::Matching,
    session::{Session, mark_of, message_in, token_qos, wire_of},
};
use crate::{
    error::{Error, Explained, Result},
    graph::{
        dds::{Exchange, Matched},
        mark::Mark,
        qos::Qos,
    },
};

/// How long zenoh waits for a reply: as long as a route may at most. Until then it remembers the call.
const TIMEOUT: Duration = Duration::from_secs(3600);
/// The same for the result of a goal.
const RESULT_TIMEOUT: Duration = Duration::from_secs(24 * 3600);
/// The end of the name of the service for results.
const RESULTS: &str = "/_action/get_result";

/// Calls a service; leaves the graph when dropped.
pub(crate) struct Client {
    raw: Raw,
    node: Node,
    subject: Subject,
    exchange: Exchange,
    mark: Mark,
    matching: Matching,
}

impl Session {
    /// Becomes a client of a service. Bridges of the mark's network are not called.
    pub(crate) fn client(&self, exchange: &Exchange, mark: Mark, bytes_max: usize) -> Result<Client> {
        let subject = self.service(exchange);
        let timeout = if subject.name.ends_with(RESULTS) { RESULT_TIMEOUT } else { TIMEOUT };
        let raw = self.node.client(&subject, token_qos(&Qos::default(), Some(mark)), bytes_max, timeout);
        let raw = raw.map_err(|error| zenoh_error(&format!("cannot call {exchange}"), &error))?;
        let matching = Matching::follow(&self.node, (subject.clone(), Kind::Server), |_| (), || ());
        Ok(Client { raw, node: self.node.clone(), subject, exchange: exchange.clone(), mark, matching })
    }
}

impl Client {
    /// Calls the server.
    ///
    /// # Errors
    /// [`Error::Unserved`] if there is none, [`Error::Slow`], [`Error::Zenoh`].
    pub(crate) fn call(&mut self, message: &[u8]) -> Result<i64> {
        let endpoints = self.node.graph().endpoints();
        let is_bridge = |mark: Option<Mark>| mark.is_some_and(|mark| mark.is_of_network_of(self.mark));
        let serves = |kind, subject: &Subject| kind == Kind::Server && subject.meets(&self.subject);
        let mut servers = endpoints.iter().filter(|one| serves(one.token.kind, &one.token.subject));
        if !servers.any(|server| !is_bridge(mark_of(server))) {
            let what = format!("nobody serves {}", self.exchange);
            let hint = "start the node";
            return Err(Error::Unserved(Explained::new(
                what,
                "no server",
                "a node that serves it in this domain",
                hint,
            )));
        }
        self.raw.call(wire_of(message)).map_err(|error| zenoh_error(&format!("cannot call {}", self.exchange), &error))
    }

    /// The next reply, and the number of its request; none if the session ended. Cancelling it loses nothing.
    pub(crate) async fn next(&mut self) -> Option<(i64, Bytes)> {
        loop {
            tokio::select! {
                reply = self.raw.next() => {
                    let reply = reply?;
                    if let Some(message) = message_in(&reply.message) {
                        return Some((reply.number, message));
                    }
                }
                () = self.matching.matched.clone().ended() => return None,
            }
        }
    }

    /// The servers of others.
    pub(crate) fn matched(&self) -> &Matched {
        &self.matching.matched
    }
}
