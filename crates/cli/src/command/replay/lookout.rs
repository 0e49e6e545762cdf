//! Looking out for bridges: where one has a topic, a replay would go around the ledger, or into it under somebody's name.

use ledger_base::rejection::{Code, Rejection};
use ros_bridge::dds::{Change, Neighbour, Participant, Role};
use std::collections::BTreeSet;
use tokio::sync::{mpsc, watch};

/// Watches these topics of a domain.
pub(super) struct Lookout {
    participant: Participant,
    topics: BTreeSet<String>,
}

impl Lookout {
    /// Over these DDS topics.
    pub(super) fn over(participant: Participant, topics: BTreeSet<String>) -> Self {
        Self { participant, topics }
    }

    /// Waits for a bridge on one of the topics; for ever if none comes.
    pub(super) async fn bridge(&self, domain: u16) -> Rejection {
        // Endpoints with a mark are told of on every topic; those without are no bridge's.
        let (_topics, none) = watch::channel(BTreeSet::new());
        let (tell, mut told) = mpsc::unbounded_channel();
        let follow = self.participant.follow(none, |change| {
            if let Change::Came(neighbour) = change
                && self.concerns(&neighbour)
            {
                // Its reader is there as long as this future is.
                let _told = tell.send(neighbour);
            }
        });
        tokio::select! {
            () = follow => std::future::pending().await,
            Some(neighbour) = told.recv() => refused(domain, &neighbour),
        }
    }

    fn concerns(&self, neighbour: &Neighbour) -> bool {
        neighbour.mark.is_some() && self.topics.contains(&neighbour.topic)
    }
}

fn refused(domain: u16, neighbour: &Neighbour) -> Rejection {
    let topic = neighbour.topic.strip_prefix("rt").unwrap_or(&neighbour.topic);
    let (found, why) = match neighbour.role {
        Role::Publisher => ("a bridge that publishes there", "a robot listens there that the ledger guards"),
        Role::Subscriber => ("a bridge that subscribes there", "it would sign the messages for its user"),
    };
    Rejection::new(Code::BadArgument, format!("{topic} in ROS domain {domain} belongs to a bridge: {why}"))
        .found(found)
        .wanted("a topic without a bridge, so that the replay does not go around the ledger")
        .next("another --domain, or another name for the topic: --topic FROM:=TO")
}
