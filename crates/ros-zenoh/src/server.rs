//! Serves a service.

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use bytes::Bytes;
use tokio::sync::mpsc;
use zenoh::{
    Wait,
    bytes::ZBytes,
    query::{Query, Queryable},
    sample::Locality,
};

use crate::{
    attachment::Attachment,
    endpoint::{Announced, now},
    error::{Error, failed},
    gid::Gid,
    key::Subject,
    limits::{PENDING_MAX, WAITING_MAX},
    node::Node,
    qos::TokenQos,
    subscriber::{attachment, bytes_of},
    token::Kind,
};

/// The client of a request, and its number of the request.
pub type RequestId = (Gid, i64);

/// A request.
#[derive(Debug)]
pub struct Request {
    /// To be named in the reply.
    pub id: RequestId,
    /// The message: CDR with its encapsulation header.
    pub message: Bytes,
}

/// Serves one service; leaves the graph when dropped.
pub struct Server {
    key: String,
    announced: Announced,
    _queries: Queryable<()>,
    arrivals: mpsc::Receiver<(Request, Query)>,
    /// Requests without a reply, in the order in which they came.
    pending: BTreeMap<u64, (RequestId, Query)>,
    /// The number of the next one.
    next: u64,
    dropped: Arc<AtomicU64>,
}

impl Node {
    /// Starts to serve a service.
    ///
    /// # Errors
    /// If the session has ended.
    pub fn server(&self, subject: &Subject, qos: TokenQos, bytes_max: usize) -> Result<Server, Error> {
        let (sender, arrivals) = mpsc::channel(WAITING_MAX);
        let dropped = Arc::new(AtomicU64::new(0));
        let (key, lost) = (subject.key(self.inner.identity.domain), Arc::clone(&dropped));
        let take = move |query: Query| {
            let arrived = request(&query, bytes_max).map(|request| (request, query));
            if arrived.is_none_or(|arrived| sender.try_send(arrived).is_err()) {
                lost.fetch_add(1, Ordering::Relaxed);
            }
        };
        let queries = self.inner.session.declare_queryable(&key).complete(true);
        let queries = queries.allowed_origin(Locality::Remote).callback(take).wait().map_err(failed)?;
        let announced = self.announce(Kind::Server, subject, qos)?;
        Ok(Server { key, announced, _queries: queries, arrivals, pending: BTreeMap::new(), next: 0, dropped })
    }
}

impl Server {
    /// The next request. Cancelling it loses nothing. It waits for ever if the session ends.
    pub async fn next(&mut self) -> Option<Request> {
        let (request, query) = self.arrivals.recv().await?;
        if self.pending.len() >= PENDING_MAX {
            // Its client gets no reply, as if the server had ended.
            self.pending.pop_first();
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        self.pending.insert(self.next, (request.id, query));
        self.next = self.next.wrapping_add(1);
        Some(request)
    }

    /// Replies to a request.
    ///
    /// # Errors
    /// [`Error::NotWaiting`]; a failure of zenoh.
    pub fn reply(&mut self, id: &RequestId, message: Bytes) -> Result<(), Error> {
        let (gid, sequence) = *id;
        // The oldest of them, if a client uses a number twice.
        let found = self.pending.iter().find(|(_, (pending, _))| pending == id).map(|(number, _)| *number);
        let (_, query) = found.and_then(|number| self.pending.remove(&number)).ok_or(Error::NotWaiting)?;
        let attachment = Attachment { sequence, time: now(), gid }.to_bytes();
        // The key of the query may be the one of any hash.
        let key = if self.key.ends_with('*') { query.key_expr().as_str() } else { &self.key };
        let reply = query.reply(key, ZBytes::from(message)).attachment(ZBytes::from(attachment.to_vec()));
        reply.wait().map_err(failed)
    }

    /// Gives up a request: its client gets no reply.
    pub fn give_up(&mut self, id: &RequestId) {
        self.pending.retain(|_, (pending, _)| pending != id);
    }

    /// Its identifier.
    pub fn gid(&self) -> Gid {
        self.announced.gid
    }

    /// Requests lost here: too long, malformed, too many waited, or too many had no reply.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

fn request(query: &Query, bytes_max: usize) -> Option<Request> {
    let payload = query.payload().filter(|payload| payload.len() <= bytes_max)?;
    let Attachment { sequence, gid, .. } = query.attachment().and_then(attachment)?;
    Some(Request { id: (gid, sequence), message: bytes_of(payload) })
}
