//! Publishes raw messages on a topic.

use std::{
    sync::atomic::{AtomicI64, Ordering},
    time::Duration,
};

use bytes::Bytes;
use zenoh::{
    Wait,
    bytes::ZBytes,
    pubsub::Publisher as Plain,
    qos::{CongestionControl, Reliability},
};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

use crate::{
    attachment::Attachment,
    endpoint::{Announced, now},
    error::{Error, failed},
    gid::Gid,
    key::Subject,
    node::Node,
    qos::TokenQos,
    token::Kind,
};

/// Between two announcements of the last number of a latched topic, as in `rmw_zenoh`.
const HEARTBEAT: Duration = Duration::from_millis(500);

/// Publishes on one topic; leaves the graph when dropped. Writing does not wait for subscribers: what a link cannot take now is lost.
pub struct Publisher {
    node: Node,
    output: Output,
    announced: Announced,
    last: AtomicI64,
}

/// The publisher of zenoh. A latched one keeps the last messages for those who come late.
enum Output {
    Plain(Box<Plain<'static>>),
    Latched(Box<AdvancedPublisher<'static>>),
}

impl Node {
    /// Starts to publish a topic.
    ///
    /// # Errors
    /// If the session has ended.
    pub fn publisher(&self, subject: &Subject, qos: TokenQos) -> Result<Publisher, Error> {
        let reliability = if qos.is_reliable { Reliability::Reliable } else { Reliability::BestEffort };
        let publisher = self.inner.session.declare_publisher(subject.key(self.inner.identity.domain));
        let publisher = publisher.reliability(reliability).congestion_control(CongestionControl::Drop);
        let output = if qos.is_latched {
            let kept = CacheConfig::default().max_samples(qos.depth.unwrap_or(usize::MAX));
            let mut latched = publisher.cache(kept).publisher_detection();
            if qos.is_reliable {
                latched = latched.sample_miss_detection(MissDetectionConfig::default().sporadic_heartbeat(HEARTBEAT));
            }
            Output::Latched(Box::new(latched.wait().map_err(failed)?))
        } else {
            Output::Plain(Box::new(publisher.wait().map_err(failed)?))
        };
        let announced = self.announce(Kind::Publisher, subject, qos)?;
        Ok(Publisher { node: self.clone(), output, announced, last: AtomicI64::new(0) })
    }
}

impl Publisher {
    /// Publishes a message: CDR with its encapsulation header.
    ///
    /// # Errors
    /// If the session has ended.
    pub fn publish(&self, message: Bytes) -> Result<(), Error> {
        if self.node.is_ended() {
            return Err(Error::Ended);
        }
        let sequence = self.last.fetch_add(1, Ordering::Relaxed).wrapping_add(1);
        let attachment = Attachment { sequence, time: now(), gid: self.announced.gid }.to_bytes();
        let (message, attachment) = (ZBytes::from(message), ZBytes::from(attachment.to_vec()));
        match &self.output {
            Output::Plain(plain) => plain.put(message).attachment(attachment).wait(),
            Output::Latched(latched) => latched.put(message).attachment(attachment).wait(),
        }
        .map_err(failed)
    }

    /// Its identifier, which its messages carry.
    pub fn gid(&self) -> Gid {
        self.announced.gid
    }
}
