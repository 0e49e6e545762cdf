//! The server of a ROS 2 service.

use std::time::Instant;

use bytes::Bytes;
use ros_zenoh::{
    error::Error as Failure,
    node::Node,
    server::{RequestId, Server as Raw},
    token::Kind,
};

use super::{
    failure::zenoh_error,
    matching::Matching,
    session::{Session, mark_of, message_in, token_qos, wire_of},
};
use crate::{
    error::Result,
    graph::{
        dds::{Exchange, Matched},
        mark::Mark,
        qos::Qos,
    },
    log::LogLimiter,
};

/// Takes requests, and replies to them; leaves the graph when dropped.
pub(crate) struct Server {
    raw: Raw,
    node: Node,
    exchange: Exchange,
    mark: Mark,
    matching: Matching,
    /// Requests that were lost when last looked at.
    lost: u64,
    log_limiter: LogLimiter,
}

impl Session {
    /// Starts to offer a service. Requests of bridges of the mark's network are not taken in.
    pub(crate) fn server(&self, exchange: &Exchange, mark: Mark, bytes_max: usize) -> Result<Server> {
        let subject = self.service(exchange);
        let raw = self.node.server(&subject, token_qos(&Qos::default(), Some(mark)), bytes_max);
        let raw = raw.map_err(|error| zenoh_error(&format!("cannot serve {exchange}"), &error))?;
        let matching = Matching::follow(&self.node, (subject, Kind::Client), |_| (), || ());
        let (node, exchange, log_limiter) = (self.node.clone(), exchange.clone(), LogLimiter::default());
        Ok(Server { raw, node, exchange, mark, matching, lost: 0, log_limiter })
    }
}

impl Server {
    /// The next request, little endian CDR without its header; none if the session ended. Cancelling it loses nothing.
    pub(crate) async fn next(&mut self) -> Option<(RequestId, Bytes)> {
        loop {
            let request = tokio::select! {
                request = self.raw.next() => request?,
                () = self.matching.matched.clone().ended() => return None,
            };
            self.count_losses();
            match message_in(&request.message) {
                Some(message) if !self.is_bridge(&request.id) => return Some((request.id, message)),
                _ => self.raw.give_up(&request.id),
            }
        }
    }

    /// Replies to a request. A client that has left gets nothing.
    ///
    /// # Errors
    /// [`crate::error::Error::Zenoh`].
    pub(crate) fn reply(&mut self, id: &RequestId, message: &[u8]) -> Result<()> {
        match self.raw.reply(id, wire_of(message)) {
            Ok(()) | Err(Failure::NotWaiting) => Ok(()),
            Err(error) => Err(zenoh_error(&format!("cannot reply on {}", self.exchange), &error)),
        }
    }

    /// Is the client that has called still there, according to its token?
    pub(crate) fn is_there(&self, (client, _): &RequestId) -> bool {
        !self.node.graph().has_left(client)
    }

    /// The clients of others.
    pub(crate) fn matched(&self) -> &Matched {
        &self.matching.matched
    }

    /// Is the client a bridge of this network? Messages from the ledger do not go there again.
    fn is_bridge(&self, (client, _): &RequestId) -> bool {
        let mark = self.node.graph().endpoint(client).and_then(|client| mark_of(&client));
        mark.is_some_and(|mark| mark.is_of_network_of(self.mark))
    }

    fn count_losses(&mut self) {
        let lost = self.raw.dropped().saturating_sub(std::mem::replace(&mut self.lost, self.raw.dropped()));
        if lost > 0
            && let Some(not_logged) = self.log_limiter.admit("lost", Instant::now())
        {
            let service = self.exchange.to_string();
            tracing::warn!(service, lost, not_logged, "requests were dropped: too long, malformed, or too many");
        }
    }
}
