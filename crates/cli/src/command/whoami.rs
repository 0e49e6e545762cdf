//! `whoami`: as whom we act.

use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, attributes};
use crate::session::{ABAC, Session};
use crate::{context, time};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Class, Rejection};
use ledger_identity::Role;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};

/// Show the identity of the selected context: organisation, name, role, attributes, validity.
///
/// Read from the certificate on this machine. If a node answers, it also shows whether the ledger accepts the identity.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl whoami\n  ledgerctl whoami --context Salma -o json")]
pub(crate) struct Whoami {}

#[derive(Serialize)]
struct Who {
    context: String,
    id: String,
    organisation: String,
    name: String,
    role: Role,
    attributes: BTreeMap<String, String>,
    serial: String,
    fingerprint: Hash,
    not_before: u64,
    not_after: u64,
    network: Hash,
    label: String,
    nodes: Vec<String>,
    online: Online,
    #[serde(skip)]
    now: u64,
}

/// The report of a node about us.
#[derive(Serialize)]
#[serde(tag = "state", rename_all = "lowercase")]
enum Online {
    /// The ledger takes us for who we are.
    Accepted,
    /// The ledger refuses us.
    Refused { code: String, message: String },
    /// Nobody answered.
    Unreachable { code: String, message: String },
}

impl Online {
    fn of(outcome: Result<(), Rejection>) -> Self {
        match outcome {
            Ok(()) => Self::Accepted,
            Err(rejection) => {
                let (code, message) = (rejection.code.to_string(), rejection.message);
                match rejection.code.class() {
                    Class::Unreachable => Self::Unreachable { code, message },
                    _ => Self::Refused { code, message },
                }
            }
        }
    }
}

impl Facts for Who {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("identity", &self.id);
        table.pair("role", self.role);
        table.pair("attributes", attributes(&self.attributes));
        let (from, until) = (time::moment(self.not_before), time::moment(self.not_after));
        let remark = if self.now > self.not_after {
            format!("expired {}", time::relative(self.not_after, self.now))
        } else if self.now < self.not_before {
            format!("not valid yet: begins {}", time::relative(self.not_before, self.now))
        } else {
            format!("ends {}", time::relative(self.not_after, self.now))
        };
        table.pair("valid", format!("{from} to {until} ({remark})"));
        table.pair("serial", &self.serial);
        table.pair("fingerprint", self.fingerprint);
        table.pair("network", format!("{} {}", self.label, self.network).trim_start());
        table.pair("nodes", self.nodes.join(", "));
        table.pair("context", &self.context);
        let online = match &self.online {
            Online::Accepted => "accepted by the ledger".to_owned(),
            Online::Refused { code, message } => format!("rejected: {message} [{code}]"),
            Online::Unreachable { code, message } => format!("unknown: {message} [{code}]"),
        };
        table.pair("online", online);
        table.write(out, 0)
    }
}

impl Whoami {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let selected = context::selected(global)?;
        let identity = context::identity(&selected)?;
        let ask = async {
            let session = Session::open(global).await?;
            session.ask(ABAC, "GetSubmittingClientIdentity", vec![]).await.map(drop)
        };
        let online = Online::of(ask.await);
        let nodes = selected.addresses();
        output.show(&Who {
            id: identity.id(),
            organisation: identity.organisation,
            name: identity.name,
            role: identity.role,
            attributes: identity.attributes,
            serial: hex::encode(&identity.serial),
            fingerprint: Hash(identity.fingerprint),
            not_before: identity.not_before,
            not_after: identity.not_after,
            network: selected.network,
            label: selected.label,
            nodes,
            context: selected.name,
            online,
            now: time::now(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger_base::rejection::Code;

    #[test]
    fn silence_is_told_apart_from_refusal() {
        let of = |code| Online::of(Err(Rejection::new(code, "m")));
        assert!(matches!(of(Code::Unreachable), Online::Unreachable { .. }));
        assert!(matches!(of(Code::Timeout), Online::Unreachable { .. }));
        assert!(matches!(of(Code::Revoked), Online::Refused { .. }));
        assert!(matches!(Online::of(Ok(())), Online::Accepted));
    }
}
