//! `identity register|registrar|list|show|cancel|revoke|renew|import|crl`: the people, nodes and robots of your organisation.

mod crl;
mod import;
mod list;
mod register;
mod registrar;
mod renew;
mod revoke;
mod robots;

use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, attributes};
use crate::session::Session;
use crate::time;
use ledger::msp::{IdentityRecord, IssuedCertificate};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
pub(in crate::command) use register::Invitation;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};

/// Register and revoke identities of your organisation, and renew your own.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Identity {
    Register(register::Register),
    Registrar(registrar::Registrar),
    List(list::List),
    Show(Show),
    Cancel(Cancel),
    Revoke(revoke::Revoke),
    Renew(renew::Renew),
    Import(import::Import),
    Crl(crl::Crl),
}

/// Show an identity with its certificates; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl identity show Salma")]
pub(crate) struct Show {
    /// The name
    name: String,
}

/// Cancel a registration: the one-time secret of a name that has not enrolled becomes invalid. For admins.
///
/// It also removes a revoked name that has never signed anything, so that the name can be registered again.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl identity cancel Salma")]
pub(crate) struct Cancel {
    /// The name
    name: String,
}

impl Identity {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        match self {
            Self::Register(command) => command.run(global, output).await,
            Self::Registrar(command) => command.run(global, output).await,
            Self::List(command) => command.run(global, output).await,
            Self::Show(command) => {
                let session = Session::open(global).await?;
                output.show(&find(&session, &command.name).await?)
            }
            Self::Cancel(command) => command.run(global, output).await,
            Self::Revoke(command) => command.run(global, output).await,
            Self::Renew(command) => command.run(global, output).await,
            Self::Import(command) => command.run(global, output).await,
            Self::Crl(command) => command.run(global, output).await,
        }
    }
}

async fn identities(session: &Session) -> Result<Vec<Person>, Rejection> {
    let now = session.client.now();
    Ok(session.client.identities("").await?.into_iter().map(|record| Person::of(record, now)).collect())
}

/// The registered identity of that name; a near match is suggested for an unknown one.
async fn find(session: &Session, name: &str) -> Result<Person, Rejection> {
    let now = session.client.now();
    if let Some(record) = session.client.identities(name).await?.into_iter().find(|record| record.name == name) {
        return Ok(Person::of(record, now));
    }
    let known = identities(session).await?;
    let names = known.iter().map(|person| person.name.as_str());
    Err(Rejection::new(Code::NotFound, format!("no identity {name:?} is registered"))
        .found(name)
        .wanted("the name of a registered identity")
        .next(ledger_base::nearest::did_you_mean(name, names, "ledgerctl identity list")))
}

/// A registered identity.
#[derive(Serialize)]
struct Person {
    name: String,
    organisation: String,
    role: Role,
    attributes: BTreeMap<String, String>,
    enrolled: bool,
    /// Until when its secret can be used, if it can, microseconds since the UNIX epoch.
    #[serde(skip_serializing_if = "Option::is_none")]
    secret_expires: Option<u64>,
    /// The node that alone knows the secret, if it was made at that node's machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    secret_at: Option<String>,
    registered_by: String,
    certificates: Vec<IssuedCertificate>,
    /// Now, for what has expired.
    #[serde(skip)]
    now: u64,
}

impl Person {
    fn of(record: IdentityRecord, now: u64) -> Self {
        let secret_expires = record.pending(now);
        let local = record.local.filter(|local| local.expires >= now);
        Self {
            name: record.name,
            organisation: record.organisation,
            role: record.role,
            attributes: record.attributes,
            enrolled: !record.certificates.is_empty(),
            secret_expires,
            secret_at: local.map(|local| local.at),
            registered_by: record.by,
            certificates: record.certificates,
            now,
        }
    }

    /// One or a few words for the list.
    fn state(&self) -> String {
        let live = |issued: &&IssuedCertificate| !issued.revoked && issued.not_after >= self.now;
        let state = match (self.certificates.iter().any(|issued| live(&issued)), self.certificates.last()) {
            (true, _) => "enrolled",
            (false, Some(newest)) if newest.revoked => "revoked",
            (false, Some(_)) => "expired",
            (false, None) if self.secret_expires.is_some() => "",
            (false, None) => "never enrolled, secret invalid",
        };
        let pending = self.secret_expires.map(|end| format!("can enrol until {}", time::moment(end)));
        [Some(state.to_owned()).filter(|state| !state.is_empty()), pending]
            .into_iter()
            .flatten()
            .collect::<Vec<_>>()
            .join(", ")
    }
}

impl Facts for Person {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("name", &self.name);
        table.pair("organisation", &self.organisation);
        table.pair("role", self.role);
        table.pair("attributes", attributes(&self.attributes));
        table.pair("state", self.state());
        table.pair("registered by", &self.registered_by);
        table.pair(
            "secret",
            self.secret_at.as_ref().map_or_else(String::new, |at| format!("created at {at}, valid only there")),
        );
        table.write(out, 0)?;
        if self.certificates.is_empty() {
            return Ok(());
        }
        writeln!(out)?;
        let mut table = Table::new(["SERIAL", "VALID FROM", "VALID UNTIL", "STATE"]);
        for certificate in &self.certificates {
            table.row([
                certificate.serial.clone(),
                time::moment(certificate.not_before),
                time::moment(certificate.not_after),
                match certificate {
                    IssuedCertificate { revoked: true, .. } => "revoked",
                    IssuedCertificate { not_after, .. } if *not_after < self.now => "expired",
                    _ => "valid",
                }
                .to_owned(),
            ]);
        }
        table.write(out, 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger_base::hash::Hash;

    #[test]
    fn the_state_tells_pending_enrolled_expired_and_revoked() {
        let certificate = |revoked, not_after| IssuedCertificate {
            serial: "01".into(),
            issuer: Hash::ZERO,
            fingerprint: Hash::ZERO,
            not_before: 0,
            not_after,
            via: String::new(),
            recorded: 0,
            revoked,
        };
        let state = |secret_expires: Option<u64>, certificates: &[IssuedCertificate]| {
            let person = Person {
                name: "Salma".into(),
                organisation: "Org1".into(),
                role: Role::Member,
                attributes: BTreeMap::new(),
                enrolled: !certificates.is_empty(),
                secret_expires,
                secret_at: None,
                registered_by: "Org1/Admin".into(),
                certificates: certificates.to_vec(),
                now: 10,
            };
            person.state()
        };
        let (good, revoked, expired) = (certificate(false, 20), certificate(true, 20), certificate(false, 9));
        assert_eq!(state(Some(15), &[]), format!("can enrol until {}", time::moment(15)));
        assert_eq!(state(None, &[]), "never enrolled, secret invalid");
        assert_eq!(state(None, std::slice::from_ref(&good)), "enrolled");
        assert_eq!(state(None, &[revoked.clone(), good.clone()]), "enrolled");
        assert_eq!(state(None, &[revoked]), "revoked");
        assert_eq!(state(None, std::slice::from_ref(&expired)), "expired");
        assert!(state(Some(15), &[expired]).starts_with("expired, can enrol until"));
    }
}
