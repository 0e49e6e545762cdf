//! `identity registrar`: who may register members of a department.

use crate::answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, printable};
use crate::session::{MSP, Session, argument};
use ledger::msp::SetRegistrar;
use serde::Serialize;
use std::io::{self, Write};

/// Permit a member to register members of one department, with the named attributes only; without a name, list the
/// registrars.
///
/// For admins. A registrar uses `ledgerctl identity register NAME --affiliation DEPARTMENT`, and can cancel its own
/// registrations. It can assign no other role and no attribute that is not named here. Only an admin can register a
/// revoked name again.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl identity registrar Farhad --affiliation sales --attr Husky
  ledgerctl identity registrar Farhad --remove
  ledgerctl identity registrar")]
pub(crate) struct Registrar {
    /// A member of your organisation
    #[arg(requires = "change")]
    name: Option<String>,
    /// The department; `sales` includes `sales.north`
    #[arg(long, value_name = "DEPARTMENT", group = "change", requires = "name")]
    affiliation: Option<String>,
    /// Name of an attribute that it may assign
    #[arg(long = "attr", value_name = "KEY", requires = "affiliation")]
    attributes: Vec<String>,
    /// Remove the permission
    #[arg(long, group = "change", requires = "name")]
    remove: bool,
}

impl Registrar {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let Some(name) = self.name else {
            let known = session.ask(MSP, "registrars", vec![]).await?;
            return output.show(&Known(answer::parse(&known, "the registrars")?));
        };
        let set =
            SetRegistrar { name, affiliation: self.affiliation, attributes: self.attributes.into_iter().collect() };
        let done = session.call(MSP, "set_registrar", vec![argument(&set)?]).await?;
        output.show(&Set(answer::parse(&done.response, "the registrar")?))
    }
}

#[derive(Serialize)]
struct Set(SetRegistrar);

impl Facts for Set {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let SetRegistrar { name, affiliation, .. } = &self.0;
        let name = printable(name);
        match affiliation {
            Some(department) => writeln!(out, "{name} may register members of {}", printable(department)),
            None => writeln!(out, "{name} may no longer register members"),
        }
    }
}

#[derive(Serialize)]
struct Known(Vec<SetRegistrar>);

impl Facts for Known {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::new(["NAME", "DEPARTMENT", "ATTRIBUTES"]);
        for SetRegistrar { name, affiliation, attributes } in &self.0 {
            let attributes: Vec<&str> = attributes.iter().map(String::as_str).collect();
            table.row([name.clone(), affiliation.clone().unwrap_or_default(), attributes.join(", ")]);
        }
        table.write(out, 0)
    }
}
