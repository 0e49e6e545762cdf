//! `network add-org`: an organisation of another software, with the authorities it has.

use super::change::decide;
use super::json;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, attributes, warn};
use crate::session::Session;
use crate::time;
use fabric::MspDirectory;
use ledger::msp::AddOrganisation;
use ledger_base::rejection::Rejection;
use ledger_identity::Role;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::PathBuf;

/// Add a Fabric organisation, whose members keep their certificates; for admins, with approval.
///
/// Reads the MSP directory of the organisation: cacerts, intermediatecerts, crls, and the NodeOUs of config.yaml, which
/// map units (OU) to roles. The organisation operates no node here: its members use the nodes of others. An admin of
/// another organisation approves the proposal, or runs the same command with the same directory.
///
/// With --check, nothing is proposed and no network is needed: it checks whether a member of the organisation could
/// sign in.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl network add-org Org3 --msp org3.example.com/msp --check org3.example.com/users/salma/msp
  ledgerctl network add-org Org3 --msp org3.example.com/msp")]
pub(crate) struct AddOrg {
    /// Name of the organisation
    name: String,
    /// MSP directory of the organisation
    #[arg(long, value_name = "DIR")]
    msp: PathBuf,
    /// Only check whether this member could sign in: an MSP directory with signcerts, or a certificate in PEM
    #[arg(long, value_name = "DIR")]
    check: Option<PathBuf>,
}

/// A person who could sign in.
#[derive(Serialize)]
struct Checked {
    id: String,
    role: Role,
    attributes: BTreeMap<String, String>,
    not_before: u64,
    not_after: u64,
}

impl Facts for Checked {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{} could sign in", crate::output::printable(&self.id))?;
        let mut table = Table::pairs();
        table.pair("role", self.role);
        table.pair("attributes", attributes(&self.attributes));
        table.pair("valid until", time::moment(self.not_after));
        table.write(out, 2)
    }
}

impl AddOrg {
    /// Answers without a network, if that is all that was asked.
    pub(super) fn check(&self, global: &Global, output: &mut Output) -> Option<Result<(), Failure>> {
        self.check.as_deref().map(|person| {
            let (read, now) = (self.read(global)?, time::now());
            let found = read.person(person, now).map_err(|error| error.prefix("the member could not sign in: "))?;
            let (id, ledger_identity::Identity { role, attributes, not_before, not_after, .. }) = (found.id(), found);
            output.show(&Checked { id, role, attributes, not_before, not_after })
        })
    }

    fn read(&self, global: &Global) -> Result<MspDirectory, Rejection> {
        let read = MspDirectory::read(&self.msp, &self.name, time::now())?;
        for [warning, next] in &read.warnings {
            warn(global.format(), warning, next);
        }
        Ok(read)
    }

    pub(super) async fn run(self, session: &Session, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let read = self.read(global)?;
        let texts = |ders: &[Vec<u8>]| ders.iter().map(hex::encode).collect();
        let add = AddOrganisation {
            name: self.name.clone(),
            roots: texts(&read.roots),
            intermediates: texts(&read.intermediates),
            units: read.units,
            lists: texts(&read.lists),
        };
        let done = format!(
            "organisation {} is a member of the network; its members run: ledgerctl identity import",
            self.name
        );
        decide(session, output, "add_organisation", json(&add)?, done).await
    }
}
