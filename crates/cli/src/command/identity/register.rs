//! `identity register`: a name with its role and attributes, and the line with which its owner enrols.

use super::robots;
use crate::argument::attribute::Attribute;
use crate::argument::span::Milliseconds;
use crate::command::ca;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, attributes};
use crate::session::Session;
use crate::time;
use crate::words::shell_word;
use ledger::msp::AFFILIATION;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::time::Duration;

/// Register an identity with its role and attributes; for admins, and for registrars within their department.
///
/// Prints a one-time secret and the command with which the identity enrols. The secret is shown only once.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl identity register Salma --attr Turtlebot4 --attr Husky
  ledgerctl identity register Turtlebot4 --role robot --attr model=lite
  ledgerctl identity register Nadia --affiliation sales
  ledgerctl identity register Salma --reissue")]
pub(crate) struct Register {
    /// The name, as in the certificate
    name: String,
    /// The role of the identity
    #[arg(long, value_name = "ROLE", default_value = "member", value_parser = role)]
    role: Role,
    /// Attribute to sign into the certificate; KEY alone means KEY=true
    #[arg(long = "attr", value_name = "KEY[=VALUE]")]
    attributes: Vec<Attribute>,
    /// Department, signed into the certificate as the attribute hf.Affiliation
    #[arg(long, value_name = "DEPARTMENT")]
    affiliation: Option<String>,
    /// Create a new secret for a registered name, and new attributes if any are given; its role stays
    ///
    /// Existing certificates stay valid: revoke them if they should not. With new attributes, they are revoked as soon
    /// as the name has enrolled again.
    #[arg(long, conflicts_with = "role")]
    reissue: bool,
    /// Validity of the secret, at most 8760h
    #[arg(long = "for", value_name = "SPAN", default_value = "168h")]
    span: Milliseconds,
}

fn role(text: &str) -> Result<Role, String> {
    [Role::Member, Role::Admin, Role::Node, Role::Robot]
        .into_iter()
        .find(|role| role.as_str() == text)
        .ok_or_else(|| "wanted member, admin, node or robot".to_owned())
}

/// A new registration, with all that its owner needs.
#[derive(Serialize)]
pub(in crate::command) struct Invitation {
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
    /// The name was registered before, and a context of it may exist.
    #[serde(skip)]
    reissue: bool,
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
        writeln!(out, "to enrol, {} runs:\n  {}", self.name, self.command)?;
        if self.reissue {
            writeln!(out, "  (--force replaces the key of a context with this name)")?;
        }
        Ok(())
    }
}

impl Register {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
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
    pub(in crate::command) async fn make(
        session: &Session,
        name: String,
        (role, reissue): (Role, bool),
        attributes: BTreeMap<String, String>,
        life: Duration,
    ) -> Result<Self, Rejection> {
        let registered = session.client.register_for(&name, Some(role).filter(|_| !reissue), &attributes, life).await?;
        // Registering works through any node; who enrols is sent to one that carries the CA, by an address of it.
        let (node, ca_fingerprint) = ca::door(session, &registered.organisation).await?;
        // Who enrols again has a context of this name.
        let force = if reissue { " --force" } else { "" };
        let command = format!(
            "ledgerctl enroll {} --node {node} --ca-fingerprint {ca_fingerprint} --secret {}{force}",
            shell_word(&name),
            shell_word(&registered.secret),
        );
        let (organisation, secret, expires) = (registered.organisation, registered.secret, registered.expires);
        Ok(Self { name, organisation, role, attributes, secret, expires, node, ca_fingerprint, command, reissue })
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
            reissue: false,
        };
        let mut out = Vec::new();
        invitation.text(&mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        for part in ["registered Org1/Salma", "Husky=true", "s3cret (shown once)", "  ledgerctl enroll Salma"] {
            assert!(text.contains(part), "{part:?} in {text}");
        }
    }

    #[test]
    fn roles_are_four_words() {
        assert_eq!(role("admin"), Ok(Role::Admin));
        assert!(role("boss").is_err_and(|error| error.contains("member, admin, node or robot")));
    }
}
