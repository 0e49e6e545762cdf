//! `network invite --list|--cancel`: the invitations that can still be answered.

use crate::command::network::{ask, json};
use crate::output::{Facts, Table, printable};
use crate::session::{MSP, Session};
use crate::time;
use ledger::msp::{CancelInvitation, Invitation};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use serde::Serialize;
use std::io::{self, Write};

/// An invitation that can still be answered.
#[derive(Serialize)]
struct Open {
    /// `node` or `organisation`.
    what: &'static str,
    name: String,
    /// The inviting admin.
    by: String,
    /// Until when, microseconds since the UNIX epoch.
    expires: u64,
}

/// All of them.
#[derive(Serialize)]
pub(super) struct Standing(Vec<Open>);

impl Facts for Standing {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "no pending invitations (those that wait for approval: ledgerctl network proposals)");
        }
        let mut table = Table::new(["INVITED", "NAME", "BY", "UNTIL"]);
        for open in &self.0 {
            table.row([
                open.what.to_owned(),
                printable(&open.name).to_string(),
                open.by.clone(),
                time::moment(open.expires),
            ]);
        }
        table.write(out, 0)
    }
}

/// Nodes of the own organisation that have not enrolled with their token, and organisations.
pub(super) async fn standing(session: &Session) -> Result<Standing, Rejection> {
    let now = session.client.now();
    let mut open = Vec::new();
    for record in session.client.identities("").await?.into_iter().filter(|record| record.role == Role::Node) {
        if let Some(expires) = record.pending(now) {
            open.push(Open { what: "node", name: record.id(), by: record.by, expires });
        }
    }
    let invitations: Vec<Invitation> = ask(session, "invitations", vec![], "the invitations").await?;
    open.extend(invitations.into_iter().map(|invitation| Open {
        what: "organisation",
        name: invitation.name,
        by: invitation.by,
        expires: invitation.expires,
    }));
    Ok(Standing(open))
}

/// An invitation that is good for nothing any more.
#[derive(Serialize)]
pub(super) struct Cancelled {
    what: &'static str,
    name: String,
}

impl Facts for Cancelled {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(
            out,
            "the invitation of {} {} is cancelled, and its token is invalid",
            self.what,
            printable(&self.name)
        )
    }
}

/// Cancels the invitation of a node of the own organisation, else that of an organisation.
pub(super) async fn cancel(session: &Session, name: &str) -> Result<Cancelled, Rejection> {
    let own = session.identity()?.organisation;
    let node = name.strip_prefix(&format!("{own}/")).unwrap_or(name);
    let now = session.client.now();
    let record = session.client.identities(node).await?.into_iter().find(|record| record.role == Role::Node);
    if record.is_some_and(|record| record.pending(now).is_some()) {
        session.client.cancel_registration(node).await?;
        return Ok(Cancelled { what: "node", name: format!("{own}/{node}") });
    }
    let argument = json(&CancelInvitation { name: name.to_owned() })?;
    match session.call(MSP, "cancel_invitation", argument).await {
        Ok(_) => Ok(Cancelled { what: "organisation", name: name.to_owned() }),
        Err(refused) if refused.code == Code::NotFound => {
            Err(Rejection::new(Code::NotFound, "there is no such invitation to cancel")
                .found(format!("{name:?}"))
                .wanted("a node of your organisation, or an organisation, with a pending invitation")
                .next("ledgerctl network invite --list"))
        }
        Err(refused) => Err(refused),
    }
}
