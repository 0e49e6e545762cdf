//! `identity register|registrar|list|show|cancel|revoke|renew|import|crl`: the people, nodes and robots of your organisation.

mod crl;
mod import;
mod list;
mod registrar;
mod renew;
mod revoke;
mod robots;

use crate::argument::attribute::Attribute;
use crate::argument::span::Milliseconds;
use crate::command::ca;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, attributes};
use crate::session::Session;
use crate::time;
use crate::words::shell_word;
use ledger::msp::{AFFILIATION, IdentityRecord, IssuedCertificate};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::time::Duration;

/// Register identities of your organisation, revoke them, renew your own.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Identity {
    Register(Register),
    Registrar(registrar::Registrar),
    List(list::List),
    Show(Show),
    Cancel(Cancel),
    Revoke(revoke::Revoke),
    Renew(renew::Renew),
    Import(import::Import),
    Crl(crl::Crl),
}

/// Register a name with its role and attributes; for admins, and for registrars in their department.
///
/// Prints a one-time secret and the command with which its owner enrols. The secret is shown once.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl identity register Salma --attr Turtlebot4 --attr Husky
  ledgerctl identity register Turtlebot4 --role robot --attr model=lite
  ledgerctl identity register Nadia --affiliation sales
  ledgerctl identity register Salma --reissue")]
pub(crate) struct Register {
    /// The name, as it will stand in the certificate
    name: String,
    /// The role of the identity
    #[arg(long, value_name = "ROLE", default_value = "member", value_parser = role)]
    role: Role,
    /// An attribute to sign into the certificate; KEY alone means KEY=true
    #[arg(long = "attr", value_name = "KEY[=VALUE]")]
    attributes: Vec<Attribute>,
    /// The department, signed into the certificate as the attribute hf.Affiliation
    #[arg(long, value_name = "DEPARTMENT")]
    affiliation: Option<String>,
    /// Give a registered name a new secret, and new attributes if any are named; its role stays
    ///
    /// Certificates issued before stay valid: revoke them if they should not. With new attributes they are revoked as soon
    /// as the name has enrolled again.
    #[arg(long, conflicts_with = "role")]
    reissue: bool,
    /// How long the secret can be used, at most 8760h
    #[arg(long = "for", value_name = "SPAN", default_value = "168h")]
    span: Milliseconds,
}

/// Show one identity with its certificates; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl identity show Salma")]
pub(crate) struct Show {
    /// The name
    name: String,
}

/// Cancel a registration: the one-time secret of a name that has not enrolled is void. For admins.
///
/// It also forgets a revoked name that has never signed anything, so that the name can be registered again.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl identity cancel Salma")]
pub(crate) struct Cancel {
    /// The name
    name: String,
}

fn role(text: &str) -> Result<Role, String> {
    [Role::Member, Role::Admin, Role::Node, Role::Robot]
        .into_iter()
        .find(|role| role.as_str() == text)
        .ok_or_else(|| "wanted member, admin, node or robot".to_owned())
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

/// A new registration, with all that its owner needs.
#[derive(Serialize)]
pub(super) struct Invitation {
    name: String,
    organisation: String,
    role: Role,
    attributes: BTreeMap<String, String>,
    secret: String,
    /// Until when, microseconds since the UNIX epoch.
    expires: u64,
    node: String,
    ca_fingerprint: Hash,
    command: String,
}

impl Facts for Invitation {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "registered {}/{}", self.organisation, self.name)?;
        let mut table = Table::pairs();
        table.pair("role", self.role);
        table.pair("attributes", attributes(&self.attributes));
        table.pair("secret", format!("{} (shown once)", self.secret));
        table.pair("until", time::moment(self.expires));
        table.write(out, 2)?;
        writeln!(out, "next, {} types:\n  {}", self.name, self.command)
    }
}

impl Register {
    async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let department = self.affiliation.map(|value| Attribute { key: AFFILIATION.to_owned(), value });
        let mut wanted = BTreeMap::new();
        for Attribute { key, value } in self.attributes.into_iter().chain(department) {
            if let Some(first) = wanted.insert(key.clone(), value.clone()) {
                return Err(Rejection::new(Code::BadArgument, format!("attribute {key:?} is given twice"))
                    .found(format!("{key}={first} and {key}={value}"))
                    .wanted("each attribute once")
                    .into());
            }
        }
        let session = Session::open(global).await?;
        if !self.reissue {
            robots::check_name(&session, &self.name, self.role, output).await?;
        }
        let life = Duration::from_millis(self.span.0);
        output.show(&Invitation::make(&session, self.name, (self.role, self.reissue), wanted, life).await?)
    }
}

impl Invitation {
    /// Registers a name, or gives it a new secret.
    pub(super) async fn make(
        session: &Session,
        name: String,
        (role, reissue): (Role, bool),
        attributes: BTreeMap<String, String>,
        life: Duration,
    ) -> Result<Self, Rejection> {
        let registered = session.client.register_for(&name, Some(role).filter(|_| !reissue), &attributes, life).await?;
        // Registering works through any node; who enrols is sent to one that carries the CA, by an address of it.
        let (node, ca_fingerprint) = ca::door(session, &registered.organisation).await?;
        let command = format!(
            "ledgerctl enroll {} --node {node} --ca-fingerprint {ca_fingerprint} --secret {}",
            shell_word(&name),
            shell_word(&registered.secret),
        );
        let (organisation, secret, expires) = (registered.organisation, registered.secret, registered.expires);
        Ok(Self { name, organisation, role, attributes, secret, expires, node, ca_fingerprint, command })
    }
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
            (false, None) => "never enrolled, secret void",
        };
        let pending = self.secret_expires.map(|end| format!("may enrol until {}", time::moment(end)));
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
            self.secret_at.as_ref().map_or_else(String::new, |at| format!("made at {at}, good there only")),
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
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn words_survive_the_shell() {
        for (text, wanted) in [("Salma", "Salma"), ("", "''"), ("a b", "'a b'"), ("it's", r"'it'\''s'"), ("-x", "'-x'")]
        {
            assert_eq!(shell_word(text), wanted);
        }
    }

    #[test]
    fn an_invitation_holds_the_whole_command() {
        let invitation = Invitation {
            name: "Salma".into(),
            organisation: "Org1".into(),
            role: Role::Member,
            attributes: [("Husky".to_owned(), "true".to_owned())].into(),
            secret: "s3cret".into(),
            expires: 0,
            node: "127.0.0.1:7450".into(),
            ca_fingerprint: Hash::ZERO,
            command: "ledgerctl enroll Salma".into(),
        };
        let mut out = Vec::new();
        invitation.text(&mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        for part in ["registered Org1/Salma", "Husky=true", "s3cret (shown once)", "  ledgerctl enroll Salma"] {
            assert!(text.contains(part), "{part:?} in {text}");
        }
    }

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
        assert_eq!(state(Some(15), &[]), format!("may enrol until {}", time::moment(15)));
        assert_eq!(state(None, &[]), "never enrolled, secret void");
        assert_eq!(state(None, std::slice::from_ref(&good)), "enrolled");
        assert_eq!(state(None, &[revoked.clone(), good.clone()]), "enrolled");
        assert_eq!(state(None, &[revoked]), "revoked");
        assert_eq!(state(None, std::slice::from_ref(&expired)), "expired");
        assert!(state(Some(15), &[expired]).starts_with("expired, may enrol until"));
    }

    #[test]
    fn roles_are_four_words() {
        assert_eq!(role("admin"), Ok(Role::Admin));
        assert!(role("boss").is_err_and(|error| error.contains("member, admin, node or robot")));
    }
}
