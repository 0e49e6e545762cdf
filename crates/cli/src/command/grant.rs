//! `acquire`, `renew`, `release`: who may use a service, and until when.

use crate::answer;
use crate::argument::span::Milliseconds;
use crate::cli::Global;
use crate::failure::Failure;
use crate::output::{Facts, Output};
use crate::session::{ABAC, Session};
use crate::time;
use crate::words::Words;
use bytes::Bytes;
use ledger_api::Committed;
use ledger_contract::{Capabilities, Fencing, Grant, Released};
use serde::Serialize;
use std::io::{self, Write};

/// Get the right to use a service of a robot.
///
/// While the grant lasts, nobody else's messages get through on an exclusive service. It is a lease: use and `renew`
/// extend it, `release` ends it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl acquire Turtlebot4
  ledgerctl acquire Turtlebot4/cmd_vel --for 30s")]
pub(crate) struct Acquire {
    #[command(flatten)]
    lease: Lease,
}

/// Extend a grant that you hold.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl renew Turtlebot4/cmd_vel --for 2m")]
pub(crate) struct Renew {
    #[command(flatten)]
    lease: Lease,
}

/// Give a service back; an admin of the robot's owner takes it back from whoever holds it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl release Turtlebot4/cmd_vel
  ledgerctl release Turtlebot4/cmd_vel --holder Org1/Salma")]
pub(crate) struct Release {
    /// The service; the robot alone is enough if it offers exactly one
    #[arg(value_name = "ROBOT[/TOPIC]")]
    service: String,
    /// Take back this holder's grant only; for admins of the robot's owner
    #[arg(long, value_name = "ORG/NAME")]
    holder: Option<String>,
}

#[derive(Debug, clap::Args)]
struct Lease {
    /// The service; the robot alone is enough if it offers exactly one
    #[arg(value_name = "ROBOT[/TOPIC]")]
    service: String,
    /// How long without use, such as 30s, 500ms or 2m; otherwise what the service says
    #[arg(long = "for", value_name = "SPAN")]
    span: Option<Milliseconds>,
}

/// A grant and the transaction that gave it.
#[derive(Serialize)]
struct Granted {
    #[serde(flatten)]
    grant: Grant,
    /// Block time of the transaction, microseconds.
    time: u64,
    height: u64,
    transaction: ledger_hash::Hash,
    #[serde(skip)]
    renewed: bool,
}

impl Facts for Granted {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Grant { service, holder, epoch, expires, mode, .. } = &self.grant;
        let is_alone = mode.known().and_then(Capabilities::of_mode).map(|known| known.fencing == Fencing::Newest);
        let what = match (self.renewed, is_alone) {
            (true, _) => "renewed".to_owned(),
            (false, Some(true)) => "is yours alone".to_owned(),
            (false, Some(false)) => "is yours, with everybody else who may".to_owned(),
            (false, None) => format!("is yours in mode {mode}"),
        };
        writeln!(out, "{service} {what}")?;
        let mut table = crate::output::Table::pairs();
        table.pair("holder", holder);
        table.pair("epoch", epoch);
        table.pair("expires", format!("{} ({})", time::moment(*expires), time::relative(*expires, self.time)));
        table.write(out, 2)
    }
}

/// The words of the command line where the chaincode has other names.
const ACQUIRE: Words = Words { arguments: &[("LEASE_MS", "--for")], help: "ledgerctl acquire" };
const RENEW: Words = Words { help: "ledgerctl renew", ..ACQUIRE };
const RELEASE: Words = Words { arguments: &[("HOLDER", "--holder")], help: "ledgerctl release" };

impl Lease {
    async fn run(self, function: &str, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let words = if function == "renew" { RENEW } else { ACQUIRE };
        let mut args = vec![Bytes::from(self.service)];
        args.extend(self.span.map(|span| Bytes::from(span.0.to_string())));
        let Committed { id, height, time, response, .. } =
            session.call(ABAC, function, args).await.map_err(|refused| words.told(refused))?;
        let grant = answer::parse(&response, "a grant")?;
        output.show(&Granted { grant, time, height, transaction: id, renewed: function == "renew" })
    }
}

impl Acquire {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        self.lease.run("acquire", global, output).await
    }
}

impl Renew {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        self.lease.run("renew", global, output).await
    }
}

/// The ended grants, and the transaction that ended them.
#[derive(Serialize)]
struct Ended {
    released: Vec<Released>,
    time: u64,
    height: u64,
    transaction: ledger_hash::Hash,
}

impl Facts for Ended {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.released.is_empty() {
            writeln!(out, "nobody held it")?;
        }
        for Released { service, holder, epoch, .. } in &self.released {
            writeln!(out, "{service} is released; {holder} held it with epoch {epoch}")?;
        }
        Ok(())
    }
}

impl Release {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let args = std::iter::once(self.service).chain(self.holder).map(Bytes::from).collect();
        let Committed { id, height, time, response, .. } =
            session.call(ABAC, "release", args).await.map_err(|refused| RELEASE.told(refused))?;
        let released = answer::parse(&response, "ended grants")?;
        output.show(&Ended { released, time, height, transaction: id })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_contract::{Mode, Told};

    fn granted(renewed: bool, mode: impl Into<Told<Mode>>) -> Granted {
        let grant = Grant {
            service: "Turtlebot4/cmd_vel".into(),
            holder: "Org1/Salma".into(),
            epoch: 3,
            expires: 1_700_000_010_000_000,
            mode: mode.into(),
            acquired_at: 1_700_000_000_000_000,
            lease_ms: 10_000,
            next_seq: 0,
        };
        Granted { grant, time: 1_700_000_000_000_000, height: 9, transaction: ledger_hash::Hash::ZERO, renewed }
    }

    fn text(facts: &impl Facts) -> String {
        let mut out = Vec::new();
        facts.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_grant_says_whose_which_epoch_and_how_long() {
        let shown = text(&granted(false, Mode::Exclusive));
        for part in ["Turtlebot4/cmd_vel is yours alone", "holder   Org1/Salma", "epoch    3", "(in 10 s)"] {
            assert!(shown.contains(part), "{part:?} in {shown}");
        }
        assert!(text(&granted(true, Mode::Exclusive)).contains("renewed"));
        assert!(text(&granted(false, Mode::Open)).contains("everybody else who may"));
        let newer = text(&granted(false, Told::Unknown("limited".into())));
        assert!(newer.contains("Turtlebot4/cmd_vel is yours in mode limited"), "{newer}");
    }

    #[test]
    fn a_grant_in_json_is_flat() {
        let value = serde_json::to_value(granted(false, Mode::Exclusive)).unwrap();
        for key in ["service", "holder", "epoch", "expires", "mode", "time", "height", "transaction"] {
            assert!(value.get(key).is_some(), "{key}");
        }
        assert!(value.get("renewed").is_none());
    }
}
