//! A client of a ROS 2 service.

use bytes::Bytes;
use ledger_base::hash::Hash;
use rtps::guid::{Guid, SampleIdentity, SequenceNumber};

use super::{
    arrival::{Arrival, Side},
    exchange::Exchange,
    link::{Link, LinkTopics},
    mapping::{Header, Mapping, named},
};
use crate::{
    error::{Error, Explained, Result},
    graph::{
        dds::{matched::Matched, participant::Participant},
        mark::Mark,
    },
};

/// Calls a service; leaves the graph when dropped.
pub struct Client {
    link: Link,
    exchange: Exchange,
    mark: Mark,
    /// The number of this client in front of messages.
    own: u64,
    /// The number of the last request that went out with one in front.
    last: i64,
}

/// The number of a request of this client.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Number(Mapping, i64);

/// A reply.
#[derive(Debug, Clone)]
pub struct Reply {
    /// The request.
    pub number: Number,
    /// The message, little endian CDR without its encapsulation header.
    pub message: Bytes,
}

impl Participant {
    /// Becomes a client of a service. Bridges of the mark's network are not called.
    pub fn client(&self, exchange: &Exchange, mark: Mark, bytes_max: usize) -> Result<Client> {
        let reads = (exchange.replies(), exchange.reply_type());
        let writes = (exchange.requests(), exchange.request_type());
        let link = Link::open(self, LinkTopics { reads, writes, of: Side::Client }, mark, bytes_max)?;
        let [_, writer] = link.guids();
        let own = Hash::of(&[&writer.to_bytes()]).0.first_chunk().copied().map_or(0, u64::from_le_bytes);
        Ok(Client { link, exchange: exchange.clone(), mark, own, last: 0 })
    }
}

impl Client {
    /// Calls the server.
    ///
    /// # Errors
    /// [`Error::Unserved`] if there is none, [`Error::Slow`], [`Error::Dds`].
    pub fn call(&mut self, message: &[u8]) -> Result<Number> {
        match self.server().ok_or_else(|| self.unserved())? {
            Mapping::InFront => {
                self.last = self.last.saturating_add(1);
                let header = Header { client: self.own, number: self.last };
                self.link.write(header.before(message), None)?;
                Ok(Number(Mapping::InFront, self.last))
            }
            Mapping::NearbyEndpoint => {
                let [reader, _] = self.link.guids();
                let related = SampleIdentity { writer: reader, sequence: SequenceNumber::UNKNOWN };
                let sent = self.link.write(Bytes::copy_from_slice(message), Some(related))?;
                Ok(Number(Mapping::NearbyEndpoint, sent.sequence.0))
            }
        }
    }

    /// The next reply to a request of this client; none if DDS ended. Cancelling it loses nothing.
    pub async fn next(&mut self) -> Option<Reply> {
        loop {
            let arrival = self.link.next().await?;
            if let Some(reply) = self.reply(arrival) {
                return Some(reply);
            }
        }
    }

    /// The servers of others, as far as their replies go.
    pub fn matched(&self) -> &Matched {
        self.link.matched()
    }

    /// The mapping of the server, if there is one that hears this client and is heard by it.
    fn server(&self) -> Option<Mapping> {
        let (topic, of) = (self.exchange.requests(), self.exchange.request_type().dds());
        let is_bridge = |mark: Option<Mark>| mark.is_some_and(|mark| mark.is_of_network_of(self.mark));
        let mut found = self.link.participant().subscribers();
        let found = found.find(|other| {
            let serves = other.topic == topic && other.type_name == of;
            let guid = Guid::from_bytes(other.guid);
            let is_found = || self.link.hearers().has(guid) && self.link.matched().of_participant(guid.prefix) > 0;
            serves && !is_bridge(other.mark) && is_found()
        })?;
        Some(Mapping::of(Guid::from_bytes(found.guid)))
    }

    fn unserved(&self) -> Error {
        let what = format!("nobody serves {}", self.exchange);
        Error::Unserved(Explained::new(what, "no server", "a node that serves it in this domain", "start the node"))
    }

    /// The reply in a message, if it is for this client.
    fn reply(&self, Arrival { message, writer, related, .. }: Arrival) -> Option<Reply> {
        match Mapping::of(writer) {
            Mapping::InFront => {
                let (header, message) = Header::split(&message)?;
                let number = Number(Mapping::InFront, header.number);
                (header.client == self.own).then_some(Reply { number, message })
            }
            Mapping::NearbyEndpoint => {
                let is_own = |named: Guid| self.link.guids().contains(&named);
                named(related).filter(|named| is_own(*named))?;
                Some(Reply { number: Number(Mapping::NearbyEndpoint, related?.sequence.0), message })
            }
        }
    }
}
