//! `readers`: who reads a confidential service.

use crate::answer;
use crate::command::message::enter;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::{ABAC, Session};
use crate::words::Words;
use bytes::Bytes;
use ledger_contract::{ReaderTold, Readers as Listed};
use serde::Serialize;
use std::io::{self, Write};

/// The words of the command line where the chaincode has other names.
const WORDS: Words = Words { arguments: &[("SERVICE", "the service")], help: "ledgerctl readers" };

/// Show the readers of a confidential service, register as a reader, or leave.
///
/// Messages of a service with confidential=true are encrypted for its readers. A reader registers with a key that is
/// generated on this machine, next to the certificate. `echo`, `record` and bridges register automatically. Policies
/// decide who may read; admins, nodes and robots of the owner always may. A reader that policies no longer permit stays
/// on the list, but gets no new keys.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl readers Turtlebot4/camera
  ledgerctl readers Turtlebot4/camera --enter
  ledgerctl readers Turtlebot4/camera --remove Org1/Salma")]
pub(crate) struct Readers {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT/TOPIC")]
    service: String,
    /// Register as a reader
    #[arg(long, conflicts_with_all = ["leave", "remove"])]
    enter: bool,
    /// Stop being a reader
    #[arg(long, conflicts_with = "remove")]
    leave: bool,
    /// Remove this reader; for admins of the owner
    #[arg(long, value_name = "ORG/NAME")]
    remove: Option<String>,
}

#[derive(Serialize)]
struct Shown(Listed);

impl Facts for Shown {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Listed { service, readers, .. } = &self.0;
        if readers.is_empty() {
            return writeln!(out, "{service} has no readers");
        }
        let mut table = Table::new(["READER", "MAY READ", "KEY"]);
        for reader in readers {
            let may_read = if reader.may_read { "yes" } else { "no" };
            table.row([reader.reader.clone(), may_read.to_owned(), reader.key.chars().take(16).collect()]);
        }
        table.write(out, 0)
    }
}

#[derive(Serialize)]
struct Changed(ReaderTold);

impl Facts for Changed {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let ReaderTold { service, reader, change } = &self.0;
        writeln!(out, "{reader} has {change} as a reader of {service}")
    }
}

impl Readers {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let named = Bytes::from(self.service.clone());
        let args = match (&self.remove, self.leave) {
            (Some(reader), _) => Some(vec![named.clone(), Bytes::from("none"), Bytes::from(reader.clone())]),
            (None, true) => Some(vec![named.clone(), Bytes::from("none")]),
            (None, false) => None,
        };
        if let Some(args) = args {
            let done = session.call(ABAC, "reader", args).await.map_err(|refused| WORDS.told(refused))?;
            return output.show(&Changed(answer::parse(&done.response, "a change of readers")?));
        }
        if self.enter {
            enter(&session, &self.service).await.map_err(|refused| WORDS.told(refused))?;
        }
        let readers = session.ask(ABAC, "readers", vec![named]).await.map_err(|refused| WORDS.told(refused))?;
        output.show(&Shown(answer::parse(&readers, "readers")?))
    }
}
