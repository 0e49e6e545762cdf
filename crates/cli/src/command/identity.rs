//! `identity register|list|show|revoke|renew`: the people, nodes and robots of your organisation.

mod renew;

use crate::argument::attribute::Attribute;
use crate::cli::Global;
use crate::failure::Failure;
use crate::output::{Facts, Output, Table, attributes};
use crate::session::{MSP, Session};
use crate::time;
use ledger::identity::Role;
use ledger::{Bytes, Code, Hash, Rejection};
use ledger_api::v1;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};

/// Register identities of your organisation, revoke them, renew your own.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Identity {
    Register(Register),
    List(List),
    Show(Show),
    Revoke(Revoke),
    Renew(renew::Renew),
}

/// Register a name with its role and attributes; for admins.
///
/// Prints a one-time secret and the command with which its owner enrols. The secret is shown once.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl identity register Salma --attr Turtlebot4 --attr Husky
  ledgerctl identity register Turtlebot4 --role robot --attr model=lite
  ledgerctl identity register Salma --reissue")]
pub(crate) struct Register {
    /// The name, as it will stand in the certificate
    name: String,
    /// What the identity is for
    #[arg(long, value_name = "ROLE", default_value = "member", value_parser = role)]
    role: Role,
    /// An attribute to sign into the certificate; KEY alone means KEY=true
    #[arg(long = "attr", value_name = "KEY[=VALUE]")]
    attributes: Vec<Attribute>,
    /// Give a registered name a new secret, and new attributes if any are named; its role stays
    ///
    /// Certificates issued before stay valid: revoke them if they should not.
    #[arg(long, conflicts_with = "role")]
    reissue: bool,
}

/// List the identities of your organisation; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl identity list")]
pub(crate) struct List {}

/// Show one identity with its certificates; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl identity show Salma")]
pub(crate) struct Show {
    /// The name
    name: String,
}

/// Revoke an identity's certificates; its grants end in the same block. For admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl identity revoke Salma
  ledgerctl identity revoke Salma --serial 5ab3f0 --reason 'laptop stolen'")]
pub(crate) struct Revoke {
    /// The name
    name: String,
    /// Only the certificate with this serial number
    #[arg(long, value_name = "HEX")]
    serial: Option<String>,
    /// Why; stays on the ledger
    #[arg(long, value_name = "TEXT")]
    reason: Option<String>,
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
            Self::List(_) => {
                let session = Session::open(global).await?;
                output.show(&Registered(identities(&session).await?))
            }
            Self::Show(command) => {
                let session = Session::open(global).await?;
                output.show(&find(&session, &command.name).await?)
            }
            Self::Revoke(command) => command.run(global, output).await,
            Self::Renew(command) => command.run(global, output).await,
        }
    }
}

async fn identities(session: &Session) -> Result<Vec<Person>, Rejection> {
    Ok(session.client.identities("").await?.into_iter().map(Person::from).collect())
}

/// The registered identity of that name; a near match is suggested for an unknown one.
async fn find(session: &Session, name: &str) -> Result<Person, Rejection> {
    let mut known = identities(session).await?;
    if let Some(index) = known.iter().position(|person| person.name == name) {
        return Ok(known.swap_remove(index));
    }
    let near = known.iter().map(|person| (strsim::jaro_winkler(&person.name, name), &person.name));
    let near = near.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(score, _)| *score > 0.8);
    Err(Rejection::new(Code::NotFound, format!("no identity {name:?} is registered"))
        .found(name)
        .wanted("the name of a registered identity")
        .next(near.map_or_else(|| "ledgerctl identity list".to_owned(), |(_, near)| format!("did you mean {near:?}?"))))
}

/// A new registration, with all that its owner needs.
#[derive(Serialize)]
struct Invitation {
    name: String,
    organisation: String,
    role: Role,
    attributes: BTreeMap<String, String>,
    secret: String,
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
        table.write(out, 2)?;
        writeln!(out, "next, {} types:\n  {}", self.name, self.command)
    }
}

impl Register {
    async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let mut wanted = BTreeMap::new();
        for Attribute { key, value } in self.attributes {
            if let Some(first) = wanted.insert(key.clone(), value.clone()) {
                return Err(Rejection::new(Code::BadArgument, format!("attribute {key:?} is given twice"))
                    .found(format!("{key}={first} and {key}={value}"))
                    .wanted("each attribute once")
                    .into());
            }
        }
        let session = Session::open(global).await?;
        let registered = if self.reissue {
            session.client.reissue(&self.name, &wanted).await?
        } else {
            session.client.register(&self.name, self.role, &wanted).await?
        };
        let node = session.client.node().to_string();
        // The CA of the node's own organisation is what the node can prove at first contact, also where it carries
        // the CAs of several.
        let ca_fingerprint = session.ca_fingerprint(&session.client.status().await?.organisation)?;
        let command = format!(
            "ledgerctl enroll {} --node {node} --ca-fingerprint {ca_fingerprint} --secret {}",
            shell_word(&self.name),
            shell_word(&registered.secret),
        );
        output.show(&Invitation {
            name: self.name,
            organisation: registered.organisation,
            role: self.role,
            attributes: wanted,
            secret: registered.secret,
            node,
            ca_fingerprint,
            command,
        })
    }
}

/// The text as one word of a shell.
fn shell_word(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:@%+=,".contains(c);
    if !text.is_empty() && text.chars().all(plain) && !text.starts_with('-') {
        text.to_owned()
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

/// A registered identity.
#[derive(Serialize)]
struct Person {
    name: String,
    organisation: String,
    role: String,
    attributes: BTreeMap<String, String>,
    enrolled: bool,
    certificates: Vec<Certificate>,
}

#[derive(Serialize)]
struct Certificate {
    serial: String,
    issuer: String,
    fingerprint: String,
    not_before: u64,
    not_after: u64,
    revoked: bool,
}

impl From<v1::RegisteredIdentity> for Person {
    fn from(identity: v1::RegisteredIdentity) -> Self {
        Self {
            name: identity.name,
            organisation: identity.organisation,
            role: identity.role,
            attributes: identity.attributes.into_iter().collect(),
            enrolled: identity.enrolled,
            certificates: identity.certificates.into_iter().map(Certificate::from).collect(),
        }
    }
}

impl From<v1::IssuedCertificate> for Certificate {
    fn from(certificate: v1::IssuedCertificate) -> Self {
        Self {
            serial: hex::encode(certificate.serial),
            issuer: hex::encode(certificate.issuer),
            fingerprint: hex::encode(certificate.fingerprint),
            not_before: certificate.not_before,
            not_after: certificate.not_after,
            revoked: certificate.revoked,
        }
    }
}

impl Person {
    /// One word for the list.
    fn state(&self) -> &'static str {
        let live = self.certificates.iter().any(|certificate| !certificate.revoked);
        match (self.enrolled, live, self.certificates.is_empty()) {
            (false, _, true) => "registered",
            (_, true, _) | (true, _, true) => "enrolled",
            (_, false, false) => "revoked",
        }
    }
}

#[derive(Serialize)]
struct Registered(Vec<Person>);

impl Facts for Registered {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::new(["NAME", "ORGANISATION", "ROLE", "STATE", "ATTRIBUTES"]);
        for person in &self.0 {
            table.row([
                person.name.clone(),
                person.organisation.clone(),
                person.role.clone(),
                person.state().to_owned(),
                attributes(&person.attributes),
            ]);
        }
        table.write(out, 0)
    }
}

impl Facts for Person {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("name", &self.name);
        table.pair("organisation", &self.organisation);
        table.pair("role", &self.role);
        table.pair("attributes", attributes(&self.attributes));
        table.pair("state", self.state());
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
                if certificate.revoked { "revoked" } else { "valid" }.to_owned(),
            ]);
        }
        table.write(out, 0)
    }
}

/// Certificates that were revoked.
#[derive(Serialize)]
struct Revoked {
    name: String,
    certificates: Vec<RevokedCertificate>,
}

#[derive(Serialize)]
struct RevokedCertificate {
    serial: String,
    height: u64,
    transaction: Hash,
}

impl Facts for Revoked {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        for certificate in &self.certificates {
            writeln!(out, "revoked {} serial {} in block {}", self.name, certificate.serial, certificate.height)?;
        }
        Ok(())
    }
}

impl Revoke {
    async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let person = find(&session, &self.name).await?;
        let serial = self.serial.map(|serial| serial.to_lowercase().replace(':', ""));
        let chosen: Vec<_> = person
            .certificates
            .iter()
            .filter(|certificate| !certificate.revoked && serial.as_ref().is_none_or(|s| *s == certificate.serial))
            .collect();
        if chosen.is_empty() {
            let serials: Vec<_> =
                person.certificates.iter().filter(|c| !c.revoked).map(|c| c.serial.as_str()).collect();
            return Err(Rejection::new(Code::NotFound, format!("{} has no such certificate to revoke", self.name))
                .found(if serials.is_empty() { "no valid certificate".to_owned() } else { serials.join(", ") })
                .wanted(serial.unwrap_or_else(|| "a certificate that is not revoked".to_owned()))
                .next(format!("ledgerctl identity show {}", shell_word(&self.name)))
                .into());
        }
        let mut certificates = Vec::new();
        for certificate in chosen {
            let args = [Some(&certificate.issuer), Some(&certificate.serial), self.reason.as_ref()];
            let args = args.into_iter().flatten().cloned().map(Bytes::from).collect();
            let done = session.call(MSP, "revoke", args).await?;
            certificates.push(RevokedCertificate {
                serial: certificate.serial.clone(),
                height: done.height,
                transaction: done.id,
            });
        }
        output.show(&Revoked { name: self.name, certificates })
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
    fn the_state_tells_registered_enrolled_and_revoked() {
        let certificate = |revoked| v1::IssuedCertificate { revoked, ..Default::default() };
        let state = |enrolled, certificates: &[bool]| {
            let certificates = certificates.iter().map(|revoked| certificate(*revoked)).collect();
            Person::from(v1::RegisteredIdentity { enrolled, certificates, ..Default::default() }).state()
        };
        assert_eq!(state(false, &[]), "registered");
        assert_eq!(state(true, &[false]), "enrolled");
        assert_eq!(state(true, &[true, false]), "enrolled");
        assert_eq!(state(true, &[true]), "revoked");
    }

    #[test]
    fn roles_are_four_words() {
        assert_eq!(role("admin"), Ok(Role::Admin));
        assert!(role("boss").is_err_and(|error| error.contains("member, admin, node or robot")));
    }
}
