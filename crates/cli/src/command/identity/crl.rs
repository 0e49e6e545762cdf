//! `identity crl`: revocation lists of a CA that is another software.

use crate::answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::{MSP, Session, argument};
use crate::time;
use ledger::msp::{KnownList, RecordList, RecordedList, SetStale, Stale};
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;

/// Record the newest revocation list of your CA; without a file, show the recorded lists.
///
/// For admins of the organisation of the CA. Every certificate on the list is revoked, and its grants end in the same
/// block. A list never undoes a revocation: certificates that a newer list omits stay revoked, and the output says so.
/// The list must be newer than the previous one of the same key.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl identity crl crl.pem
  ledgerctl identity crl --when-ended refuse
  ledgerctl identity crl")]
pub(crate) struct Crl {
    /// The list, in PEM or DER
    file: Option<PathBuf>,
    /// Behaviour when the list has expired and no new one was recorded: warn, or refuse the members of your
    /// organisation
    #[arg(long, value_name = "warn|refuse", value_parser = stale, conflicts_with = "file")]
    when_ended: Option<Stale>,
}

fn stale(text: &str) -> Result<Stale, String> {
    match text {
        "warn" => Ok(Stale::Warn),
        "refuse" => Ok(Stale::Refuse),
        _ => Err("wanted warn or refuse".to_owned()),
    }
}

impl Crl {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let list = self.file.as_deref().map(fabric::list).transpose()?;
        let session = Session::open(global).await?;
        if let Some(stale) = self.when_ended {
            let done = session.call(MSP, "set_stale_lists", vec![argument(&SetStale { stale })?]).await?;
            return output.show(&WhenEnded(answer::parse(&done.response, "the setting")?));
        }
        let Some(list) = list else {
            let known = answer::parse(&session.ask(MSP, "revocation_lists", vec![]).await?, "the revocation lists")?;
            return output.show(&Known { lists: known, now: session.client.now() });
        };
        let record = RecordList { list: hex::encode(list) };
        let done = session.call(MSP, "record_revocation_list", vec![argument(&record)?]).await?;
        let recorded = answer::parse(&done.response, "the recorded list")?;
        output.show(&Recorded(recorded))
    }
}

#[derive(Serialize)]
struct WhenEnded(SetStale);

impl Facts for WhenEnded {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        match self.0.stale {
            Stale::Warn => writeln!(out, "when a revocation list expires, nodes and ledgerctl warn"),
            Stale::Refuse => {
                writeln!(
                    out,
                    "when a revocation list expires, the members of the organisation are rejected until a \
                               new list is recorded"
                )
            }
        }
    }
}

#[derive(Serialize)]
struct Recorded(RecordedList);

impl Facts for Recorded {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let RecordedList { list, serials, left_out, restarted } = &self.0;
        let (subject, listed) = (crate::output::printable(&list.subject), list.listed);
        writeln!(out, "recorded the revocation list of {subject} in block {}: {listed} certificates", list.height)?;
        for serial in serials {
            writeln!(out, "revoked serial {serial}")?;
        }
        for serial in left_out {
            writeln!(out, "serial {serial} is no longer on the list, and stays revoked")?;
        }
        if *restarted {
            writeln!(
                out,
                "its number is not higher than that of the previous list; it is accepted because it was \
                           issued later"
            )?;
        }
        if list.partial {
            writeln!(out, "it covers only some certificates or reasons, so it does not replace the complete list")?;
        }
        Ok(())
    }
}

#[derive(Serialize)]
#[serde(transparent)]
struct Known {
    lists: Vec<KnownList>,
    #[serde(skip)]
    now: u64,
}

impl Facts for Known {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::new(["ORGANISATION", "CA", "CERTIFICATES", "MADE", "ENDS", "WHEN ENDED"]);
        for KnownList { list, stale } in &self.lists {
            let ends = match list.next_update {
                None => "never".to_owned(),
                Some(end) if end < self.now => format!("ended {}", time::relative(end, self.now)),
                Some(end) => time::moment(end),
            };
            table.row([
                list.organisation.clone(),
                list.subject.clone(),
                list.listed.to_string(),
                time::moment(list.this_update),
                ends,
                match stale {
                    Stale::Warn => "warn",
                    Stale::Refuse => "refuse",
                }
                .to_owned(),
            ]);
        }
        table.write(out, 0)
    }
}
