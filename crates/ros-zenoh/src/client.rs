//! Calls a service.

use std::{
    sync::{
        Arc,
        atomic::{AtomicI64, AtomicU64, AtomicUsize, Ordering},
    },
    time::Duration,
};

use bytes::Bytes;
use tokio::sync::mpsc;
use zenoh::{
    Wait,
    bytes::ZBytes,
    query::{ConsolidationMode, QueryTarget},
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
    subscriber::bytes_of,
    token::Kind,
};

/// A reply.
#[derive(Debug)]
pub struct Reply {
    /// The number of the request, as [`Client::call`] has returned it.
    pub number: i64,
    /// The message: CDR with its encapsulation header.
    pub message: Bytes,
}

/// Calls one service; leaves the graph when dropped.
pub struct Client {
    node: Node,
    subject: Subject,
    announced: Announced,
    last: AtomicI64,
    bytes_max: usize,
    /// How long zenoh waits for a reply.
    timeout: Duration,
    pending: Arc<AtomicUsize>,
    replies: mpsc::Receiver<Reply>,
    sender: mpsc::Sender<Reply>,
    dropped: Arc<AtomicU64>,
}

/// Counts a call until zenoh forgets it.
struct Pending(Arc<AtomicUsize>);

impl Drop for Pending {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Node {
    /// Becomes a client of a service. A reply that takes longer than `timeout` does not come.
    ///
    /// # Errors
    /// If the session has ended.
    pub fn client(
        &self,
        subject: &Subject,
        qos: TokenQos,
        bytes_max: usize,
        timeout: Duration,
    ) -> Result<Client, Error> {
        let announced = self.announce(Kind::Client, subject, qos)?;
        let (sender, replies) = mpsc::channel(WAITING_MAX);
        Ok(Client {
            node: self.clone(),
            subject: subject.clone(),
            announced,
            last: AtomicI64::new(0),
            bytes_max,
            timeout,
            pending: Arc::default(),
            replies,
            sender,
            dropped: Arc::default(),
        })
    }
}

impl Client {
    /// Calls all servers of the service. Returns the number of the request.
    ///
    /// # Errors
    /// [`Error::Busy`] if too many calls wait for replies; [`Error::Ended`].
    pub fn call(&self, message: Bytes) -> Result<i64, Error> {
        if self.node.is_ended() {
            return Err(Error::Ended);
        }
        let pending = Pending(Arc::clone(&self.pending));
        if self.pending.fetch_add(1, Ordering::Relaxed) >= PENDING_MAX {
            return Err(Error::Busy(PENDING_MAX));
        }
        let number = self.last.fetch_add(1, Ordering::Relaxed).wrapping_add(1);
        let attachment = Attachment { sequence: number, time: now(), gid: self.announced.gid }.to_bytes();
        let (sender, dropped, bytes_max) = (self.sender.clone(), Arc::clone(&self.dropped), self.bytes_max);
        let take = move |reply: zenoh::query::Reply| {
            let _until_forgotten = &pending;
            let Ok(sample) = reply.result() else { return };
            // Its place in the query says which request it is for, whatever the attachment says.
            let reply =
                (sample.payload().len() <= bytes_max).then(|| Reply { number, message: bytes_of(sample.payload()) });
            if reply.is_none_or(|reply| sender.try_send(reply).is_err()) {
                dropped.fetch_add(1, Ordering::Relaxed);
            }
        };
        let query = self.node.inner.session.get(self.key()).payload(ZBytes::from(message));
        let query = query.attachment(ZBytes::from(attachment.to_vec())).target(QueryTarget::AllComplete);
        let query = query.consolidation(ConsolidationMode::None).timeout(self.timeout);
        query.allowed_destination(Locality::Remote).callback(take).wait().map_err(failed)?;
        Ok(number)
    }

    /// The key of the request. A server of one hash is not asked by a key of any hash, so a hash that is not known is that of a server.
    fn key(&self) -> String {
        let Subject { name, type_name, hash } = &self.subject;
        let endpoints = self.node.graph().endpoints();
        let servers = endpoints.iter().map(|endpoint| &endpoint.token).filter(|token| token.kind == Kind::Server);
        let mut hashes =
            servers.filter(|server| server.subject.meets(&self.subject)).map(|server| &server.subject.hash);
        let hash = hash.clone().or_else(|| hashes.find_map(Clone::clone));
        Subject { name: name.clone(), type_name: type_name.clone(), hash }.key(self.node.identity().domain)
    }

    /// The next reply. Cancelling it loses nothing. It never returns if the session ends.
    pub async fn next(&mut self) -> Option<Reply> {
        self.replies.recv().await
    }

    /// Its identifier, which its requests carry.
    pub fn gid(&self) -> Gid {
        self.announced.gid
    }

    /// Replies lost here: too long, or too many waited.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}
