//! `identity revoke`, `identity cancel`: what ends the rights of a name.

use super::{Cancel, find};
use crate::answer;
use crate::argument::span::Milliseconds;
use crate::failure::Failure;
use crate::global::Global;
use crate::in_force::{Described, until_in_force};
use crate::output::{Facts, Output};
use crate::session::{MSP, Session};
use crate::time;
use crate::words::shell_word;
use bytes::Bytes;
use ledger::msp::{Organisation, RevokedIdentity};
use ledger_api::Committed;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use std::io::{self, Write};
use std::time::Duration;

/// Revoke an identity: its certificates and, if it has not enrolled, its secret. Its grants end in the same block.
///
/// For admins, through any node of the network. Earlier secrets become invalid. If the organisation has an external CA,
/// such as Fabric's, all certificates of the name whose validity begins before now are rejected from then on.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl identity revoke Salma
  ledgerctl identity revoke Salma --serial 5ab3f0 --reason 'laptop stolen'")]
pub(crate) struct Revoke {
    /// The name
    name: String,
    /// Revoke only the certificate with this serial number
    #[arg(long, value_name = "HEX")]
    serial: Option<String>,
    /// Reason; recorded on the ledger
    #[arg(long, value_name = "TEXT")]
    reason: Option<String>,
    /// Give up after this time, with an error if it is not in force by then [default: never]
    #[arg(long, value_name = "TIME")]
    timeout: Option<Milliseconds>,
}

/// The revoked certificates.
#[derive(Serialize)]
struct Revoked {
    name: String,
    certificates: Vec<RevokedCertificate>,
    /// A secret that could still be used is void.
    cancelled: bool,
    /// Certificates of the name that begin at this time or before are refused, microseconds since the UNIX epoch.
    #[serde(skip_serializing_if = "Option::is_none")]
    barred: Option<u64>,
}

#[derive(Serialize)]
struct RevokedCertificate {
    serial: String,
    height: u64,
    transaction: Hash,
    certified: bool,
}

impl Facts for Revoked {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        for certificate in &self.certificates {
            writeln!(
                out,
                "revoked {} serial {} in block {}: in force",
                self.name, certificate.serial, certificate.height
            )?;
        }
        if self.cancelled {
            writeln!(out, "the secret of {} is invalid", self.name)?;
        }
        if let Some(barred) = self.barred {
            let (name, until) = (&self.name, time::moment(barred));
            writeln!(
                out,
                "certificates of {name} whose validity begins before {until} are rejected; to readmit it, \
                           its CA issues a new one"
            )?;
            if self.certificates.is_empty() {
                writeln!(out, "the ledger has no other certificate of this name: check the spelling")?;
            }
        }
        Ok(())
    }
}

impl Cancel {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        session.client.cancel_registration(&self.name).await?;
        output.show(&Revoked { name: self.name, certificates: Vec::new(), cancelled: true, barred: None })
    }
}

impl Revoke {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let typed = shell_word(&self.name);
        let described = Described {
            what: format!("the revocation of {}", self.name),
            command: match &self.serial {
                Some(serial) => format!("ledgerctl identity revoke {typed} --serial {serial}"),
                None => format!("ledgerctl identity revoke {typed}"),
            },
            robot: None,
        };
        let timeout = self.timeout.map(|Milliseconds(ms)| Duration::from_millis(ms));
        let Some(serial) = self.serial.as_ref().map(|serial| serial.to_lowercase().replace(':', "")) else {
            let reason = self.reason.unwrap_or_default();
            // An unknown name is answered with the nearest one, where there is a registry.
            if !is_imported(&session).await? {
                find(&session, &self.name).await?;
            }
            let attempt = || session.client.revoke_identity(&self.name, &reason);
            let revoked = until_in_force(&session, &described, timeout, output, attempt).await?;
            let (revoked, done) = revoked;
            session.warn_uncertified(&done);
            let Committed { height, id: transaction, certified, .. } = done;
            let RevokedIdentity { certificates, cancelled, barred } = revoked;
            let certificates = certificates.into_iter().map(|issued| issued.serial);
            let certificates =
                certificates.map(|serial| RevokedCertificate { serial, height, transaction, certified }).collect();
            return output.show(&Revoked { name: self.name, certificates, cancelled, barred });
        };
        let person = find(&session, &self.name).await?;
        let live: Vec<_> = person.certificates.iter().filter(|issued| !issued.revoked).collect();
        let Some(chosen) = live.iter().find(|issued| issued.serial == serial) else {
            let serials: Vec<_> = live.iter().map(|issued| issued.serial.as_str()).collect();
            return Err(Rejection::new(Code::NotFound, format!("{} has no such certificate to revoke", self.name))
                .found(serial)
                .wanted(if serials.is_empty() {
                    "a certificate that is not revoked; there is none".to_owned()
                } else {
                    format!("one of {}", serials.join(", "))
                })
                .next(format!("ledgerctl identity show {}", shell_word(&self.name)))
                .into());
        };
        let args = [Some(chosen.issuer.to_string()), Some(serial.clone()), self.reason];
        let args: Vec<_> = args.into_iter().flatten().map(Bytes::from).collect();
        let attempt = || session.call(MSP, "revoke", args.clone());
        let done = until_in_force(&session, &described, timeout, output, attempt).await?;
        let (height, transaction, certified) = (done.height, done.id, done.certified);
        let revoked = RevokedCertificate { serial, height, transaction, certified };
        output.show(&Revoked { name: self.name, certificates: vec![revoked], cancelled: false, barred: None })
    }
}

/// Is the CA of the caller's organisation another software, so that the ledger registers nobody of it?
async fn is_imported(session: &Session) -> Result<bool, Rejection> {
    let name = session.identity()?.organisation.into();
    let known: Organisation = answer::parse(&session.ask(MSP, "organisation", vec![name]).await?, "the organisation")?;
    Ok(known.units.is_some())
}
