//! The server of a ROS 2 service.

use bytes::Bytes;
use rtps::guid::SampleIdentity;

use super::{
    arrival::{Arrival, Side},
    exchange::Exchange,
    link::{Link, LinkTopics},
    mapping::{Caller, Header, Mapping, Named, named},
};
use crate::{
    error::Result,
    graph::{
        dds::{matched::Matched, participant::Participant},
        mark::Mark,
    },
};

/// Takes requests, and replies to them; leaves the graph when dropped.
pub struct Server(Link);

/// A request.
#[derive(Debug, Clone)]
pub struct Request {
    /// The message, little endian CDR without its encapsulation header.
    pub message: Bytes,
    /// To be named in the reply.
    pub caller: Caller,
}

impl Participant {
    /// Starts to offer a service. Requests of bridges of the mark's network are not taken in.
    pub fn server(&self, exchange: &Exchange, mark: Mark, bytes_max: usize) -> Result<Server> {
        let reads = (exchange.requests(), exchange.request_type());
        let writes = (exchange.replies(), exchange.reply_type());
        Ok(Server(Link::open(self, LinkTopics { reads, writes, of: Side::Server }, mark, bytes_max)?))
    }
}

impl Server {
    /// The next request; none if DDS ended. It comes when its client can hear a reply, or after a second. Cancelling it
    /// loses nothing.
    pub async fn next(&mut self) -> Option<Request> {
        loop {
            if let Some(request) = request(self.0.next().await?) {
                return Some(request);
            }
        }
    }

    /// Replies to a request.
    ///
    /// # Errors
    /// [`crate::error::Error::Slow`], [`crate::error::Error::Dds`].
    pub fn reply(&self, caller: &Caller, message: &[u8]) -> Result<()> {
        match &caller.request {
            Named::InFront(header) => self.0.write(header.before(message), None),
            Named::NearbyEndpoint(request) => self.0.write(Bytes::copy_from_slice(message), Some(*request)),
        }
        .map(drop)
    }

    /// Is the client that has called still there?
    pub fn is_there(&self, caller: &Caller) -> bool {
        self.0.matched().has(caller.writer)
    }

    /// The clients of others.
    pub fn matched(&self) -> &Matched {
        self.0.matched()
    }
}

/// The request in a message; none if it is too short to be one.
fn request(Arrival { message, writer, sequence, related }: Arrival) -> Option<Request> {
    let (request, message) = match Mapping::of(writer) {
        Mapping::InFront => {
            let (header, message) = Header::split(&message)?;
            (Named::InFront(header), message)
        }
        Mapping::NearbyEndpoint => {
            let named = named(related).unwrap_or(writer);
            (Named::NearbyEndpoint(SampleIdentity { writer: named, sequence }), message)
        }
    };
    Some(Request { message, caller: Caller { writer, request } })
}
