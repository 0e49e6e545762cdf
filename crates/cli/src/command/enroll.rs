//! `enroll`: from a one-time secret to a certificate and a context.

use crate::command::context::rule;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, attributes};
use crate::{context, time};
use ledger_api::context::{PendingEnrolment, RenewalRule};
use ledger_api::{Context, Enrolment};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Class, Code, Rejection};
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::PathBuf;

/// Get a certificate with a one-time secret, and store it as a context.
///
/// The key is generated on this machine and never leaves it. An admin runs `ledgerctl identity register NAME`, which
/// prints the whole command. If interrupted, run the command again: for 15 minutes, the same secret returns the same
/// certificate.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl enroll Salma --node 10.0.0.4:7450 --ca-fingerprint 9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08 --secret u7Qm-2fKx
  ledgerctl enroll Salma --node 10.0.0.4:7450 --ca-fingerprint 9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08 --secret @salma.secret")]
pub(crate) struct Enroll {
    /// The registered name, or ORGANISATION/NAME if a node serves several organisations; also the name of the context
    name: String,
    /// Address of a node of your organisation
    #[arg(long, value_name = "HOST:PORT")]
    node: String,
    /// SHA-256 of the CA's certificate, from the admin
    #[arg(long, value_name = "SHA256")]
    ca_fingerprint: String,
    /// The one-time secret; @FILE for the first line of a file, - for standard input. Other users of this machine can
    /// read arguments
    #[arg(long, value_name = "SECRET")]
    secret: String,
    /// Kind of key: ed25519 (default), p256 or p384
    #[arg(long, value_name = "KIND")]
    key: Option<KeyKind>,
    /// Whether the certificate is renewed when it is used in the last third of its validity: auto or never
    #[arg(long, value_name = "RULE", default_value = "auto", value_parser = rule)]
    renew: RenewalRule,
    /// Replace a context of this name; its key is lost
    #[arg(long)]
    force: bool,
}

#[derive(Serialize)]
struct Enrolled {
    context: String,
    directory: PathBuf,
    id: String,
    role: Role,
    attributes: BTreeMap<String, String>,
    not_after: u64,
    network: Hash,
    label: String,
    nodes: Vec<String>,
    selected: bool,
}

impl Facts for Enrolled {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "enrolled {}, stored as context {}", self.id, self.context)?;
        let mut table = Table::pairs();
        table.pair("role", self.role);
        table.pair("attributes", attributes(&self.attributes));
        table.pair("valid until", time::moment(self.not_after));
        table.pair("network", format!("{} {}", self.label, self.network).trim_start());
        table.pair("nodes", self.nodes.join(", "));
        table.pair("stored in", self.directory.display());
        table.write(out, 2)?;
        if self.selected {
            writeln!(out, "next\n  ledgerctl robot list")
        } else {
            writeln!(out, "next\n  ledgerctl context use {0}\n  ledgerctl --context {0} robot list", self.context)
        }
    }
}

impl Enroll {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        // The environment variable chooses whom to act as; it must not decide where a new identity is stored.
        let plain = self.name.rsplit('/').next().unwrap_or(&self.name);
        let name = global.context.as_deref().unwrap_or(plain);
        let home = context::home()?;
        if !self.force && Context::list(&home)?.iter().any(|known| known == name) {
            return Err(Rejection::new(Code::AlreadyExists, format!("the context {name:?} exists already"))
                .found(format!("a key in {}", context::directory(&home, name).display()))
                .wanted("an unused name: the key would be lost")
                .next("choose another with --context NAME, or replace it with --force")
                .into());
        }
        let fingerprint = Hash::from_hex(&self.ca_fingerprint).ok_or_else(|| {
            Rejection::new(Code::BadArgument, "the CA's fingerprint cannot be read")
                .found(format!("{:?}", self.ca_fingerprint))
                .wanted("SHA-256 of the CA's certificate: 64 hexadecimal digits")
                .next("copy the whole command that `ledgerctl identity register` printed")
        })?;
        let secret = ledger_api::secret(&self.secret)?;
        // Everything that could fail on this machine fails before the secret is sent, or can be done again.
        let pending = PendingEnrolment::begin(&home, name, (&self.name, fingerprint), self.key)?;
        let enrolled = Enrolment::new(&self.node, fingerprint).enrol_key(&self.name, &secret, pending.key()?).await;
        let mut enrolled = enrolled.map_err(|refused| match refused.code.class() {
            Class::Unreachable if refused.own_advice().is_empty() => {
                refused.next("run the same command again: the key is kept, and the secret remains valid")
            }
            _ => refused,
        })?;
        name.clone_into(&mut enrolled.name);
        enrolled.renew = self.renew;
        enrolled.save(&home).map_err(|full| {
            let first = if full.advice().is_empty() { "fix that" } else { full.advice() };
            let next =
                format!("{first}; then run the same command again within 15 minutes to get the same certificate");
            full.next(next)
        })?;
        pending.finish();
        let selected = Context::current(&home)?.as_deref() == Some(name);
        let identity = context::identity(&enrolled)?;
        output.show(&Enrolled {
            context: name.to_owned(),
            directory: context::directory(&home, name),
            id: identity.id(),
            role: identity.role,
            attributes: identity.attributes,
            not_after: identity.not_after,
            network: enrolled.network,
            label: enrolled.label,
            nodes: enrolled.nodes,
            selected,
        })
    }
}
