//! The end of a replay, for people and programs.

use crate::output::{Facts, Table};
use serde::Serialize;
use std::io::{self, Write};
use std::path::Path;

/// A replay that has ended.
#[derive(Debug, Serialize)]
pub(super) struct Replayed {
    file: String,
    domain: u16,
    pub(super) topics: Vec<Count>,
    /// Messages that are none.
    pub(super) unusable: u64,
    /// Messages for which a subscriber was too slow.
    pub(super) unheard: u64,
    /// The file ends in the middle of something.
    #[serde(rename = "incomplete")]
    pub(super) is_cut: bool,
}

/// One topic of it.
#[derive(Debug, Serialize)]
pub(super) struct Count {
    pub(super) topic: String,
    #[serde(rename = "type")]
    pub(super) type_name: String,
    pub(super) recorded: u64,
    pub(super) published: u64,
    /// Subscribers at the end.
    pub(super) subscribers: usize,
}

impl Replayed {
    pub(super) fn new(file: &Path, domain: u16) -> Self {
        let file = file.display().to_string();
        Self { file, domain, topics: Vec::new(), unusable: 0, unheard: 0, is_cut: false }
    }

    /// How many messages were published.
    pub(super) fn messages(&self) -> u64 {
        self.topics.iter().map(|topic| topic.published).sum()
    }
}

impl Facts for Replayed {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::new(["TOPIC", "TYPE", "PUBLISHED", "RECORDED", "SUBSCRIBERS"]);
        for Count { topic, type_name, recorded, published, subscribers } in &self.topics {
            table.row([
                topic.clone(),
                type_name.clone(),
                published.to_string(),
                recorded.to_string(),
                subscribers.to_string(),
            ]);
        }
        table.write(out, 0)?;
        if self.unheard > 0 {
            writeln!(out, "{} messages were not published: a subscriber did not keep up", self.unheard)?;
        }
        if self.unusable > 0 {
            writeln!(out, "{} messages are not CDR, and were omitted", self.unusable)?;
        }
        if self.is_cut {
            writeln!(out, "the file is truncated: its recorder was killed, or it is damaged")?;
        }
        Ok(())
    }
}
