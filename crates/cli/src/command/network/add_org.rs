//! `network add-org`: an organisation of another software, with the authorities it has.

use super::change::decide;
use super::json;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Output, warn};
use crate::session::Session;
use fabric::MspDirectory;
use ledger::msp::AddOrganisation;
use std::path::PathBuf;

/// Let the people of a Fabric organisation in, with the certificates that they have; for admins, with approval.
///
/// Reads the MSP directory of the organisation: cacerts, intermediatecerts, crls, and NodeOUs of config.yaml, which say
/// which unit (OU) is which role. The organisation runs no node here: its people use those of others. An admin of another
/// organisation approves what is proposed, or types the same command with the same directory.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ledgerctl network add-org Org3 --msp organizations/peerOrganizations/org3.example.com/msp"
)]
pub(crate) struct AddOrg {
    /// Name of the organisation
    name: String,
    /// Its MSP directory
    #[arg(long, value_name = "DIR")]
    msp: PathBuf,
}

impl AddOrg {
    pub(super) async fn run(self, session: &Session, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let read = MspDirectory::read(&self.msp, &self.name)?;
        for [warning, next] in &read.warnings {
            warn(global.format(), warning, next);
        }
        let texts = |ders: &[Vec<u8>]| ders.iter().map(hex::encode).collect();
        let add = AddOrganisation {
            name: self.name.clone(),
            roots: texts(&read.roots),
            intermediates: texts(&read.intermediates),
            units: read.units,
            lists: texts(&read.lists),
        };
        let done = format!("organisation {} belongs to the network; its people: ledgerctl identity import", self.name);
        decide(session, output, "add_organisation", json(&add)?, done).await
    }
}
