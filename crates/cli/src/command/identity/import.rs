//! `identity import`: a context from a certificate and a key that exist, such as those of a Fabric user.

use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, attributes};
use crate::{context, time};
use ledger_api::{Context, Enrolment};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::key::{KEY_BYTES_MAX, SigningKey};
use rustls_pki_types::CertificateDer;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Create a context from an existing certificate and key, such as those of a Fabric user.
///
/// The organisation must be a member of the network: `ledgerctl network add-org`. Keys of P-256, P-384 and Ed25519 are
/// supported, in PKCS#8 or SEC1 without a passphrase. The CA that issued the certificate renews it: import the new one
/// with --force.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl identity import --cert msp/signcerts/cert.pem --key msp/keystore/priv_sk --node 10.0.0.4:7450 --ca-fingerprint 9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08")]
pub(crate) struct Import {
    /// The certificate in PEM; undeclared intermediate CAs may follow it
    #[arg(long, value_name = "FILE")]
    cert: PathBuf,
    /// Its private key in PEM
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// Address of a node of the network
    #[arg(long, value_name = "HOST:PORT")]
    node: String,
    /// SHA-256 of the CA's certificate of the organisation that operates the node
    #[arg(long, value_name = "SHA256")]
    ca_fingerprint: String,
    /// Replace a context of this name; its key is lost
    #[arg(long)]
    force: bool,
}

#[derive(Serialize)]
struct Imported {
    context: String,
    directory: PathBuf,
    id: String,
    role: Role,
    attributes: BTreeMap<String, String>,
    not_after: u64,
    network: Hash,
    nodes: Vec<String>,
}

impl Import {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let chain: Vec<_> = fabric::chain(&self.cert)?.into_iter().map(CertificateDer::from).collect();
        let key = read_key(&self.key)?;
        let fingerprint = Hash::from_hex(&self.ca_fingerprint).ok_or_else(|| {
            Rejection::new(Code::BadArgument, "the CA's fingerprint cannot be read")
                .found(format!("{:?}", self.ca_fingerprint))
                .wanted("SHA-256 of the CA's certificate: 64 hexadecimal digits")
                .next("ask an admin of the organisation that operates the node: ledgerctl network organisations")
        })?;
        let mut imported = Enrolment::new(&self.node, fingerprint).import(chain, key).await?;
        if let Some(name) = &global.context {
            name.clone_into(&mut imported.name);
        }
        let home = context::home()?;
        if !self.force && Context::list(&home)?.contains(&imported.name) {
            return Err(Rejection::new(Code::AlreadyExists, format!("the context {:?} exists already", imported.name))
                .found(format!("a key in {}", context::directory(&home, &imported.name).display()))
                .wanted("an unused name: the key would be lost")
                .next("choose another with --context NAME, or replace it with --force")
                .into());
        }
        imported.save(&home)?;
        let identity = context::identity(&imported)?;
        output.show(&Imported {
            directory: context::directory(&home, &imported.name),
            id: identity.id(),
            role: identity.role,
            attributes: identity.attributes,
            not_after: identity.not_after,
            network: imported.network,
            nodes: imported.nodes,
            context: imported.name,
        })
    }
}

/// A private key of limited size.
fn read_key(path: &Path) -> Result<SigningKey, Rejection> {
    let bad = |found: String| Rejection::new(Code::BadFile, format!("cannot use {}", path.display())).found(found);
    let mut text = String::new();
    let limit = KEY_BYTES_MAX as u64 + 1;
    let read = File::open(path).and_then(|file| file.take(limit).read_to_string(&mut text));
    read.map_err(|error| bad(error.to_string()).wanted("the private key of the certificate, in PEM"))?;
    SigningKey::from_pem(&text).map_err(|error| {
        let refused = bad(error.to_string()).wanted("a key of Ed25519, P-256 or P-384, in PKCS#8 or SEC1");
        refused.next("openssl pkey -in OLD -out NEW writes it without a passphrase")
    })
}

impl Facts for Imported {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "imported {} as context {}", crate::output::printable(&self.id), self.context)?;
        let mut table = Table::pairs();
        table.pair("role", self.role);
        table.pair("attributes", attributes(&self.attributes));
        table.pair("valid until", time::moment(self.not_after));
        table.pair("network", self.network);
        table.pair("nodes", self.nodes.join(", "));
        table.pair("stored in", self.directory.display());
        table.write(out, 2)
    }
}
