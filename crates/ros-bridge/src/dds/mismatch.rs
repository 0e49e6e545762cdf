//! Finds endpoints on our topics whose type is another: DDS never matches them, and says nothing.

use std::collections::BTreeSet;

use futures::StreamExt;
use rustdds::{DomainParticipantStatusEvent, EndpointDescription, StatusEvented};

use super::{Participant, prefix};
use crate::names::{TopicName, TypeName};

/// Most mismatches that are remembered, so that each is told once.
const TOLD_MAX: usize = 1024;

/// An endpoint of another node that is never matched with ours, because its type is another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mismatch {
    /// `publisher` or `subscriber`.
    pub role: &'static str,
    /// The DDS topic, `rt/cmd_vel`.
    pub topic: String,
    /// Its DDS type.
    pub found: String,
    /// The DDS types that were expected on this topic.
    pub wanted: String,
}

impl Participant {
    /// Tells, as long as it runs, of publishers and subscribers of others on these topics that have another type.
    /// One caller at a time: the news of a participant are given out once.
    pub async fn watch_types(&self, expected: &[(TopicName, TypeName)], mut tell: impl FnMut(Mismatch)) {
        let expected: Vec<(String, String)> =
            expected.iter().map(|(topic, message)| (topic.dds(), message.dds())).collect();
        let listener = self.dds.status_listener();
        let mut news = listener.as_async_status_stream();
        let mut told = BTreeSet::new();
        while let Some(event) = news.next().await {
            let (role, endpoint) = match &event {
                DomainParticipantStatusEvent::WriterDetected { writer } => ("publisher", writer),
                DomainParticipantStatusEvent::ReaderDetected { reader } => ("subscriber", reader),
                _ => continue,
            };
            let is_own = prefix(endpoint.guid) == self.guid_prefix();
            if is_own || !differs(endpoint, &expected) || told.len() >= TOLD_MAX {
                continue;
            }
            if told.insert(endpoint.guid.to_bytes()) {
                let wanted: Vec<&str> = wanted(endpoint, &expected).collect();
                tell(Mismatch {
                    role,
                    topic: endpoint.topic_name.clone(),
                    found: endpoint.type_name.clone(),
                    wanted: wanted.join(", "),
                });
            }
        }
    }
}

fn wanted<'a>(endpoint: &EndpointDescription, expected: &'a [(String, String)]) -> impl Iterator<Item = &'a str> {
    let topic = endpoint.topic_name.clone();
    expected.iter().filter(move |(known, _)| *known == topic).map(|(_, message)| message.as_str())
}

fn differs(endpoint: &EndpointDescription, expected: &[(String, String)]) -> bool {
    let mut wanted = wanted(endpoint, expected).peekable();
    wanted.peek().is_some() && !wanted.any(|message| message == endpoint.type_name)
}
