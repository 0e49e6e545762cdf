//! Recordings and bags of others, read from the beginning. A file without an end is read as far as it goes.

use super::items::{Fault, Item, Reader};
use ledger_base::rejection::{Code, Rejection};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// A channel of a file.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    /// Its topic.
    pub(crate) topic: String,
    /// The name of its type; empty if the file does not say it.
    pub(crate) type_name: String,
    /// The encoding of its messages.
    pub(crate) encoding: String,
    /// Everything that its writer added.
    pub(crate) about: BTreeMap<String, String>,
}

/// A message of a file.
#[derive(Debug)]
pub(crate) struct Found {
    /// The number of its channel.
    pub(crate) channel: u16,
    /// Nanoseconds since the UNIX epoch.
    pub(crate) log_time: u64,
    /// Its bytes.
    pub(crate) data: Vec<u8>,
}

/// A file that is being read.
pub(crate) struct Reading {
    path: PathBuf,
    reader: Reader<BufReader<File>>,
    schemas: BTreeMap<u16, String>,
    sources: BTreeMap<u16, Source>,
    is_cut: bool,
}

impl Reading {
    /// Opens a file.
    ///
    /// # Errors
    /// [`Code::BadFile`].
    pub(crate) fn open(path: &Path) -> Result<Self, Rejection> {
        let file = File::open(path).map_err(|error| crate::failure::unreadable(path, &error))?;
        let reader = Reader::new(BufReader::new(file));
        let (schemas, sources) = (BTreeMap::new(), BTreeMap::new());
        Ok(Self { path: path.to_owned(), reader, schemas, sources, is_cut: false })
    }

    /// The channels that were seen so far, by number.
    pub(crate) fn sources(&self) -> &BTreeMap<u16, Source> {
        &self.sources
    }

    /// Did it end in the middle of something?
    pub(crate) fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// The next message; none at the end.
    ///
    /// # Errors
    /// [`Code::BadFile`] if the file is no MCAP file, or damaged.
    pub(crate) fn next(&mut self) -> Result<Option<Found>, Rejection> {
        loop {
            match self.reader.read() {
                Ok(None) => return Ok(None),
                Err(Fault::Cut) => {
                    self.is_cut = true;
                    return Ok(None);
                }
                Err(fault) => return Err(self.refused(fault)),
                Ok(Some(Item::Schema(id, name))) => {
                    self.schemas.insert(id, name);
                }
                Ok(Some(Item::Channel { id, schema, topic, encoding, about })) => {
                    let type_name = self.schemas.get(&schema).cloned().unwrap_or_default();
                    self.sources.insert(id, Source { topic, type_name, encoding, about });
                }
                Ok(Some(Item::Message { channel, log_time, data })) => {
                    return Ok(Some(Found { channel, log_time, data }));
                }
            }
        }
    }

    fn refused(&self, fault: Fault) -> Rejection {
        let refused = Rejection::new(Code::BadFile, format!("cannot read {} as a recording", self.path.display()));
        let (found, wanted, next) = match fault {
            Fault::Io(error) => return crate::failure::unreadable(&self.path, &error),
            Fault::NotMcap => ("other bytes at its beginning".to_owned(), "an MCAP file", "ledgerctl record makes one"),
            Fault::Compressed(name) => (
                format!("chunks that are compressed by {name}"),
                "chunks without compression, as ledgerctl record and ros2 bag record write them",
                "mcap compress --compression none FILE -o OTHER.mcap",
            ),
            Fault::Damaged(what) => {
                (what, "an MCAP file without damage", "mcap recover FILE -o OTHER.mcap keeps what is whole")
            }
            Fault::Cut => ("its end".to_owned(), "an MCAP file", ""),
        };
        refused.found(found).wanted(wanted).next(next)
    }
}
