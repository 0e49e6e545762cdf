//! Subscriptions that resume where they were cut off.

mod since;

use super::Client;
use super::retry::{RETRY_AFTER, is_final};
use super::uplink::Uplink;
use crate::v1;
use ledger_base::rejection::{Code, Rejection};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep, timeout, timeout_at};
use tonic::Streaming;

/// Heartbeats that may be missing before the connection counts as broken.
const HEARTBEATS_MISSED_MAX: u32 = 3;
/// Shortest heartbeat that nodes send, in milliseconds.
const HEARTBEAT_MIN_MS: u32 = 50;
/// No shorter silence counts as a broken connection.
const SILENCE_MIN: Duration = Duration::from_millis(500);
/// How long a node may take to accept a subscription.
const ACCEPT_MAX: Duration = Duration::from_secs(3);

/// Which events are wanted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Subscription {
    /// First height of interest; 0 = the next block.
    pub from_height: u64,
    /// Only events of this chaincode; empty = of all.
    pub chaincode: String,
    /// Only events about these subjects, such as the service `Turtlebot4/cmd_vel`; empty = all.
    pub subjects: Vec<String>,
    /// Only events of these names, such as `message`; empty = all.
    pub names: Vec<String>,
    /// The node sends a delivery without events when it sent nothing else for this long, in milliseconds. A silence of
    /// three times as long makes the stream resume through another connection. 0 = never.
    pub heartbeat: u32,
    /// Also hear of calls that end control for safety before they are ordered: deliveries with `early` set. They have not happened,
    /// nothing proves them, and they come again in their block. A robot may stop for one.
    pub early: bool,
    /// Deliveries of certified blocks come with a proof, and wait for it: [`Client::believe`].
    pub proofs: bool,
    /// Deliveries come with the hashes of all blocks before them.
    pub heads: bool,
}

/// A stream of deliveries, in block order, each block once. If a node told of blocks that do not exist, what it delivered may come
/// again through another one.
pub struct EventStream {
    client: Client,
    wanted: Subscription,
    /// The next height of interest; 0 = not known yet.
    next_height: u64,
    /// The node that told the newest height, and where the stream was before it told any.
    told: Option<(Arc<str>, Before)>,
    open: Option<Open>,
}

/// Where a stream goes on if a node has told of blocks that do not exist.
#[derive(Clone, Copy)]
enum Before {
    /// At this height.
    Height(u64),
    /// It began then, and only that node's word says at which height.
    Moment(Instant),
}

struct Open {
    /// The connection.
    up: Uplink,
    deliveries: Streaming<v1::Delivery>,
}

impl Client {
    /// Subscribes to events. The connection is made at the first [`EventStream::next`].
    pub fn subscribe(&self, wanted: Subscription) -> EventStream {
        EventStream { client: self.clone(), next_height: wanted.from_height, wanted, told: None, open: None }
    }
}

impl EventStream {
    /// The next delivery: the events of one block, or a heartbeat without events. Waits as long as it takes, through
    /// as many connections as it takes; a delivery counts as handled when the next one is asked for. Safe to cancel.
    ///
    /// # Errors
    /// Why there will be no more: this identity may not read (any more), or no node accepts it.
    pub async fn next(&mut self) -> Result<v1::Delivery, Rejection> {
        loop {
            if self.open.is_none() {
                match self.subscribe().await {
                    Ok(open) => self.open = Some(open),
                    Err(refused) if is_final(&refused) => return Err(refused),
                    Err(refused) => {
                        tracing::debug!(code = refused.code.name(), reason = %refused.message, "resubscribing");
                        sleep(RETRY_AFTER).await;
                        continue;
                    }
                }
            }
            let Some(open) = &mut self.open else { continue };
            let received = match silence_max(self.wanted.heartbeat) {
                Some(silence) => timeout(silence, open.deliveries.message()).await,
                None => Ok(open.deliveries.message().await),
            };
            let leave = match received {
                Ok(Ok(Some(delivery))) if delivery.early => {
                    // Not asked for, it would be taken for what has happened.
                    if self.wanted.early {
                        return Ok(delivery);
                    }
                    continue;
                }
                Ok(Ok(Some(delivery))) => {
                    let node = Arc::clone(&open.up.connection.address);
                    let other = self.told.as_ref().filter(|(by, _)| *by != node);
                    // Seldom: a node that follows has soon what another one has told.
                    if other.is_some() && delivery.height.saturating_add(1) < self.next_height {
                        let up = open.up.clone();
                        if self.doubt_height(&up).await {
                            self.open = None;
                            continue;
                        }
                    }
                    if self.accept(&delivery, node) {
                        return Ok(delivery);
                    }
                    continue;
                }
                // The node ends a stream of its own accord when its reader is too slow, or when it stops.
                Ok(Ok(None)) => false,
                Ok(Err(status)) => {
                    let refused = open.up.connection.refusal(&status);
                    if is_final(&refused) {
                        return Err(refused);
                    }
                    refused.code == Code::ShuttingDown
                }
                Err(_silent) => true,
            };
            // A connection that broke is replaced without our asking.
            if leave {
                self.client.session.leave(open.up.number);
            }
            self.open = None;
            sleep(RETRY_AFTER).await;
        }
    }

    /// Subscribes now, so that a refusal is heard before anything else. Without this the first [`EventStream::next`] does
    /// it, and goes on trying for as long as it takes.
    ///
    /// # Errors
    /// Why no node accepts it: at once if waiting does not cure it, otherwise when the client's deadline has passed.
    pub async fn open(&mut self) -> Result<(), Rejection> {
        let deadline = Instant::now() + self.client.session.options.deadline;
        let mut last = None;
        while self.open.is_none() {
            let refused = match timeout_at(deadline, self.subscribe()).await {
                Ok(Ok(open)) => {
                    self.open = Some(open);
                    break;
                }
                Ok(Err(refused)) if is_final(&refused) => return Err(refused),
                Ok(Err(refused)) => last.insert(refused),
                Err(_) => return Err(last.unwrap_or_else(|| self.client.session.no_connection())),
            };
            tracing::debug!(code = refused.code.name(), reason = %refused.message, "resubscribing");
            sleep(RETRY_AFTER).await;
        }
        Ok(())
    }

    /// The height from which this stream would be resumed: one after the last delivery.
    pub fn next_height(&self) -> u64 {
        self.next_height
    }

    /// Notes a delivery of a node; false if its block was delivered before.
    fn accept(&mut self, delivery: &v1::Delivery, node: Arc<str>) -> bool {
        self.client.session.see(delivery.height);
        self.client.session.knows(delivery.height, &delivery.block_hash);
        let repeated = delivery.height < self.next_height && !delivery.events.is_empty();
        let next = delivery.height.saturating_add(1);
        if next > self.next_height {
            if self.told.as_ref().is_none_or(|(by, _)| *by != node) {
                self.told = Some((node, Before::Height(self.next_height)));
            }
            self.next_height = next;
        }
        !repeated
    }

    /// Did another node tell of a block above the newest one that is committed here? Then the stream goes on from where it was
    /// before that node: rather twice than not at all.
    async fn doubt_height(&mut self, up: &Uplink) -> bool {
        let committed = since::committed(up).await.filter(|height| height.saturating_add(1) < self.next_height);
        let (Some(committed), Some((by, before))) = (committed, self.told.clone()) else { return false };
        let next = match before {
            Before::Height(height) => Some(height),
            Before::Moment(begun) => since::first_since(up, begun, committed).await,
        };
        let Some(next) = next else { return false };
        let told = self.next_height - 1;
        tracing::warn!(node = &*by, told, committed, "a node reported a block that does not exist");
        (self.next_height, self.told) = (next, None);
        true
    }

    async fn subscribe(&mut self) -> Result<Open, Rejection> {
        let up = self.client.session.up().await?;
        if self.next_height == 0 {
            // Pinned down now: were the connection lost before the first delivery, "the next block" would be another.
            let begun = Instant::now();
            self.next_height = since::height(&up).await?.saturating_add(1);
            self.told = Some((Arc::clone(&up.connection.address), Before::Moment(begun)));
        }
        if self.wanted.heartbeat == 0 && self.told.as_ref().is_some_and(|(by, _)| *by != up.connection.address) {
            // Without heartbeats this node would say nothing before there is a block of that height.
            self.doubt_height(&up).await;
        }
        let request = v1::SubscribeRequest {
            from_height: self.next_height,
            chaincode: self.wanted.chaincode.clone(),
            subjects: self.wanted.subjects.clone(),
            names: self.wanted.names.clone(),
            heartbeat_ms: match self.wanted.heartbeat {
                0 => 0,
                often => often.max(HEARTBEAT_MIN_MS),
            },
            early: self.wanted.early,
            proofs: self.wanted.proofs,
            heads: self.wanted.heads,
        };
        let mut gateway = up.gateway();
        match timeout(ACCEPT_MAX, gateway.subscribe(request)).await {
            Ok(Ok(answer)) => Ok(Open { up, deliveries: answer.into_inner() }),
            Ok(Err(status)) => Err(up.connection.refusal(&status)),
            Err(_) => {
                self.client.session.leave(up.number);
                Err(crate::connect::unreachable(&up.connection.address, "no answer to a subscription"))
            }
        }
    }
}

/// How long a stream may be silent; half a second at least, because a node may be busy.
fn silence_max(heartbeat: u32) -> Option<Duration> {
    (heartbeat > 0).then(|| {
        let heartbeat = Duration::from_millis(u64::from(heartbeat.max(HEARTBEAT_MIN_MS)));
        (heartbeat * HEARTBEATS_MISSED_MAX).max(SILENCE_MIN)
    })
}
