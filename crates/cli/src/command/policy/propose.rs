//! `policy propose|proposals|approve|withdraw|approvals`: sets to which others must agree.

use super::WORDS;
use super::set::Set;
use crate::answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, printable, printable_lines};
use crate::session::{self, ABAC, Session};
use crate::time;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyApprovals, PolicyDraft, PolicyNeed, PolicyProposal, PolicyProposalTexts};
use serde::Serialize;
use std::io::{self, Write};

/// Fewest digits by which a proposal is named.
const DIGITS_MIN: usize = 8;

/// Propose a complete set of policies for your organisation; for admins.
///
/// The proposal counts as your approval. Once it is approved, an admin of your organisation applies it. It can only
/// replace the set that is in force now.
#[derive(Debug, clap::Args)]
#[command(mut_arg("files", |files| files.required_unless_present_any(["built_in", "restore"])))]
#[command(after_help = "\
Example:
  ledgerctl policy propose night.cedar guests.cedar -m 'guests until Friday'
  ledgerctl policy propose --restore 3")]
pub(crate) struct Propose {
    #[command(flatten)]
    set: Set,
    /// Propose the policies of an earlier version
    #[arg(long, value_name = "VERSION", conflicts_with_all = ["files", "built_in"])]
    restore: Option<u64>,
    /// Evaluate the set in parallel with the one in force, and leave approvals for later
    #[arg(long)]
    shadow: bool,
}

/// List the proposed policy sets, or show one with its texts.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl policy proposals\n  ledgerctl policy proposals 3f9a0c77")]
pub(crate) struct Proposals {
    /// Id of a proposal, or at least its first 8 digits
    id: Option<String>,
}

/// Approve a proposed policy set; for admins.
///
/// The approval is for exactly this set, and expires after seven days. Read the set first: `ledgerctl policy proposals
/// ID`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl policy approve 3f9a0c77")]
pub(crate) struct Approve {
    /// Id of the proposal, or at least its first 8 digits
    id: String,
}

/// Withdraw a proposed set of your organisation, or your approval of another's; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl policy withdraw 3f9a0c77")]
pub(crate) struct Withdraw {
    /// Id of the proposal, or at least its first 8 digits
    id: String,
}

/// Show which approvals the policies of an organisation need.
///
/// An organisation sets its own rule with `policy apply --approvals QUORUM`. The rule of the network applies to all
/// organisations; it is set with `network propose abac set_policy_approvals QUORUM`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl policy approvals\n  ledgerctl policy approvals Org2")]
pub(crate) struct Approvals {
    /// The organisation; your own by default
    #[arg(value_name = "ORG")]
    organisation: Option<String>,
}

/// The arguments of a call with a set.
pub(super) fn arguments(verb: &'static str, draft: &PolicyDraft) -> Result<Vec<Bytes>, Rejection> {
    Ok(vec![Bytes::from_static(verb.as_bytes()), session::argument(draft)?])
}

/// The id of the proposal that these digits begin.
pub(super) async fn resolve(session: &Session, digits: &str) -> Result<String, Failure> {
    let all: Vec<PolicyProposal> = session.list(ABAC, "policy_proposals").await?;
    let mut named = all.iter().filter(|proposal| proposal.id.starts_with(digits));
    match (named.next(), named.next()) {
        (Some(one), None) if digits.len() >= DIGITS_MIN => Ok(one.id.clone()),
        (found, _) => {
            let message = match found {
                Some(_) => "the id matches several proposals",
                None => "no proposed policy set has this id",
            };
            Err(Rejection::new(Code::NotFound, message)
                .found(digits)
                .wanted(format!("an id, or at least its first {DIGITS_MIN} digits"))
                .next("ledgerctl policy proposals")
                .into())
        }
    }
}

/// The ids of the sets that are proposed for the own organisation.
pub(super) async fn of_own_organisation(session: &Session) -> Result<Vec<String>, Rejection> {
    let all: Vec<PolicyProposal> = session.list(ABAC, "policy_proposals").await?;
    let own = &session.context().organisation;
    Ok(all.into_iter().filter(|proposal| proposal.organisation == *own).map(|proposal| proposal.id).collect())
}

/// A proposed set with its texts.
pub(super) async fn whole(session: &Session, id: String) -> Result<PolicyProposalTexts, Rejection> {
    let response = session.ask(ABAC, "policy_proposal", vec![Bytes::from(id)]).await?;
    answer::parse(&response, "a proposed set of policies")
}

impl Propose {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let args = arguments("propose", &self.set.checked(&session, self.restore).await?)?;
        let done = if self.shadow { "shadow" } else { "proposed" };
        call(&session, output, args, done).await
    }
}

impl Approve {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        on(global, output, &self.id, "approve", "approved").await
    }
}

impl Withdraw {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        on(global, output, &self.id, "withdraw", "withdrawn").await
    }
}

impl Proposals {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let Some(id) = self.id else {
            return output.show(&Standing(session.list(ABAC, "policy_proposals").await?));
        };
        let id = resolve(&session, &id).await?;
        output.show(&Whole(whole(&session, id).await?))
    }
}

impl Approvals {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let organisation = match self.organisation {
            Some(organisation) => organisation,
            None => session.identity()?.organisation,
        };
        let response = session.ask(ABAC, "policy_approvals", vec![Bytes::from(organisation)]).await?;
        output.show(&Rules(answer::parse(&response, "the approval rules of policies")?))
    }
}

/// Calls a function about one proposal.
async fn on(
    global: &Global,
    output: &mut Output,
    id: &str,
    verb: &'static str,
    done: &'static str,
) -> Result<(), Failure> {
    let session = Session::open(global).await?;
    let id = Bytes::from(resolve(&session, id).await?);
    call(&session, output, vec![Bytes::from_static(verb.as_bytes()), id], done).await
}

async fn call(session: &Session, output: &mut Output, args: Vec<Bytes>, done: &'static str) -> Result<(), Failure> {
    let called = session.call(ABAC, "policy", args).await.map_err(|refused| WORDS.told(refused))?;
    let proposal = answer::parse(&called.response, "a proposed set of policies")?;
    output.show(&Done { proposal, done })
}

/// The first digits of an id: enough to name a proposal.
pub(super) fn short(id: &str) -> &str {
    id.get(..12).unwrap_or(id)
}

/// The rules that are not met yet, in words.
fn missing(needs: &[PolicyNeed]) -> String {
    let missing = needs.iter().filter(|need| need.missing > 0);
    let missing: Vec<String> =
        missing.map(|need| format!("{} more for {} ({})", need.missing, need.quorum, need.of)).collect();
    if missing.is_empty() { "none".to_owned() } else { missing.join("; ") }
}

fn approvers(proposal: &PolicyProposal) -> String {
    let names: Vec<&str> = proposal.approved.iter().map(|approval| approval.who.as_str()).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Writes a proposal as facts.
fn facts(proposal: &PolicyProposal, out: &mut dyn Write) -> io::Result<()> {
    let names: Vec<&str> = proposal.policies.iter().map(|policy| policy.id.as_str()).collect();
    let mut table = Table::pairs();
    table.pair("by", &proposal.by).pair("at", time::moment(proposal.created));
    if !proposal.message.is_empty() {
        table.pair("message", &proposal.message);
    }
    table.pair("replaces", format!("version {}", proposal.base));
    table.pair("policies", if names.is_empty() { "the built-in policy".to_owned() } else { names.join(", ") });
    table.pair("SHA-256", &proposal.hash);
    if let Some(rule) = &proposal.approvals {
        table.pair("next needs", rule);
    }
    table.pair("approved by", approvers(proposal)).pair("waits for", missing(&proposal.needs));
    table.write(out, 2)
}

#[derive(Serialize)]
struct Done {
    #[serde(flatten)]
    proposal: PolicyProposal,
    #[serde(skip)]
    done: &'static str,
}

impl Facts for Done {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let (id, organisation) = (short(&self.proposal.id), printable(&self.proposal.organisation));
        let done = if self.done == "shadow" { "proposed" } else { self.done };
        writeln!(out, "{done}: policy set {id} of {organisation}")?;
        facts(&self.proposal, out)?;
        match (self.done, self.proposal.needs.iter().any(|need| need.missing > 0)) {
            ("withdrawn", _) => Ok(()),
            ("shadow", _) => {
                writeln!(
                    out,
                    "it is compared with the set in force from now on: ledgerctl policy shadow --proposal {id}"
                )
            }
            (_, true) => writeln!(out, "to approve: ledgerctl policy approve {id}"),
            (_, false) => {
                writeln!(out, "to apply it, an admin of {organisation} runs: ledgerctl policy apply --proposal {id}")
            }
        }
    }
}

#[derive(Serialize)]
struct Standing(Vec<PolicyProposal>);

impl Facts for Standing {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "no policy set is proposed");
        }
        let mut table = Table::new(["PROPOSAL", "FOR", "BY", "REPLACES", "APPROVED BY", "WAITS FOR", "MESSAGE"]);
        for proposal in &self.0 {
            table.row([
                short(&proposal.id).to_owned(),
                proposal.organisation.clone(),
                proposal.by.clone(),
                format!("version {}", proposal.base),
                approvers(proposal),
                missing(&proposal.needs),
                proposal.message.clone(),
            ]);
        }
        table.write(out, 0)
    }
}

#[derive(Serialize)]
struct Whole(PolicyProposalTexts);

impl Facts for Whole {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let PolicyProposalTexts { proposal, policies } = &self.0;
        writeln!(out, "policy set {} of {}", short(&proposal.id), printable(&proposal.organisation))?;
        facts(proposal, out)?;
        for policy in policies {
            writeln!(out, "\n// {}\n{}", printable(&policy.id), printable_lines(policy.text.trim()))?;
        }
        Ok(())
    }
}

#[derive(Serialize)]
struct Rules(PolicyApprovals);

impl Facts for Rules {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let PolicyApprovals { organisation, network, own } = &self.0;
        let alone = format!("none: one admin of {organisation} decides");
        let mut table = Table::pairs();
        table.pair("network", network.as_deref().unwrap_or("none"));
        table.pair(organisation, own.as_deref().unwrap_or(if network.is_none() { &alone } else { "none" }));
        table.write(out, 0)
    }
}
