//! `network invite`: a token with which a node, or an organisation with its first node, joins.

use super::decision::waiting;
use super::json;
use crate::answer;
use crate::argument::span::Milliseconds;
use crate::failure::Failure;
use crate::nodes::nodes;
use crate::output::{Facts, Output, Table, printable};
use crate::session::{MSP, Session};
use crate::time;
use ledger::msp::{Decision, InviteOrganisation, NodeRecord, NodeRole};
use ledger_api::context::msps_of;
use ledger_api::token::{ADDRESSES_MAX, JoinKind, JoinToken};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::key::SigningKey;
use ring::rand::{SecureRandom, SystemRandom};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::time::Duration;
use tokio::net::TcpStream;

/// How long the machine of a node may take to accept a connection.
const ANSWER_TIME_MAX: Duration = Duration::from_secs(2);

/// Invite a node of your organisation, or another organisation; for admins.
///
/// Prints a token for `ledgerd join`: a secret that is valid once. A node joins as a learner. Another organisation can
/// join once more than half of the organisations have approved; it creates its own CA on its own machine.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("who").required(true).args(["node", "organisation", "list", "cancel"]))]
#[command(after_help = "\
Example:
  ledgerctl network invite --node node2
  ledgerctl network invite --organisation Org2
  ledgerctl network invite --organisation Org2 --first-node edge --for 24h
  ledgerctl network invite --list
  ledgerctl network invite --cancel node2")]
pub(crate) struct Invite {
    /// Name of a new node of your organisation, or of one whose disk is lost
    #[arg(long, value_name = "NAME")]
    node: Option<String>,
    /// Name of another organisation
    #[arg(long, value_name = "NAME")]
    organisation: Option<String>,
    /// List the pending invitations
    #[arg(long)]
    list: bool,
    /// Cancel the invitation of a node of your organisation, or of an organisation that yours invited
    #[arg(long, value_name = "NAME")]
    cancel: Option<String>,
    /// Name of that organisation's first node
    #[arg(long, value_name = "NAME", default_value = "node1", conflicts_with = "node")]
    first_node: String,
    /// Validity of an organisation's invitation, at most 720h
    #[arg(long = "for", value_name = "SPAN", default_value = "168h", conflicts_with = "node")]
    span: Milliseconds,
}

mod standing;

/// A token, and what it still waits for.
#[derive(Serialize)]
struct Invited {
    organisation: String,
    node: String,
    token: String,
    /// End of the invitation, microseconds since the UNIX epoch.
    #[serde(skip_serializing_if = "Option::is_none")]
    expires: Option<u64>,
    /// The decision of the organisations; none for a node.
    #[serde(skip_serializing_if = "Option::is_none")]
    decision: Option<Decision>,
    command: String,
}

impl Facts for Invited {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let what = if self.decision.is_some() { "organisation" } else { "node" };
        let name = format!("{}/{}", self.organisation, self.node);
        writeln!(
            out,
            "invited {what} {}",
            printable(if self.decision.is_some() { &self.organisation } else { &name })
        )?;
        let mut table = Table::pairs();
        table.pair("token", "in the command below; valid once, for its bearer");
        table.pair("until", self.expires.map_or_else(String::new, time::moment));
        table.write(out, 2)?;
        if let Some(decision) = self.decision.as_ref().filter(|decision| !decision.executed) {
            waiting(decision, out)?;
            writeln!(out, "then, on the machine of {}:\n  {}", printable(&name), self.command)
        } else {
            writeln!(out, "next, on the machine of {}:\n  {}", printable(&name), self.command)
        }
    }
}

impl Invite {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        if self.list {
            return output.show(&standing::standing(session).await?);
        }
        if let Some(name) = &self.cancel {
            return output.show(&standing::cancel(session, name).await?);
        }
        let door = Door::of(session).await?;
        let invited = match (&self.node, &self.organisation) {
            (Some(node), _) => invite_node(session, door, node).await?,
            (None, organisation) => {
                let organisation = organisation.clone().unwrap_or_default();
                self.invite_organisation(session, door, organisation).await?
            }
        };
        output.show(&invited)
    }

    async fn invite_organisation(
        self,
        session: &Session,
        door: Door,
        organisation: String,
    ) -> Result<Invited, Rejection> {
        let failed = |what: &str| Rejection::new(Code::Internal, format!("a key cannot be generated: {what}"));
        let mut seed = [0; 32];
        SystemRandom::new().fill(&mut seed).map_err(|error| failed(&error.to_string()))?;
        let key = SigningKey::from_seed(&seed).map_err(|error| failed(&error.to_string()))?;
        let key = Hash::from_slice(key.public_key().bytes()).ok_or_else(|| failed("too short"))?;
        let expires = session.client.now().saturating_add(self.span.0.saturating_mul(1000));
        let invite = InviteOrganisation { name: organisation.clone(), key, expires };
        let done = session.call(MSP, "invite_organisation", json(&invite)?).await?;
        let decision = answer::parse(&done.response, "the decision")?;
        let token = door.token(organisation, self.first_node, JoinKind::Organisation, hex::encode(seed));
        Ok(invited(&token, Some(expires), Some(decision)))
    }
}

/// The refusal to read the registry, in the words of the command that needs it.
fn may_not_invite(mut refused: Rejection) -> Rejection {
    if refused.code == Code::NotAdmin {
        refused.message = refused.message.replace("read the registered identities", "invite nodes");
    }
    refused
}

/// Registers the node at the CA of the caller's organisation, or gives it a new secret.
async fn invite_node(session: &Session, door: Door, name: &str) -> Result<Invited, Rejection> {
    let known = session.client.identities(name).await.map_err(may_not_invite)?;
    let registered = match known.first() {
        None => session.client.register(name, Role::Node, &BTreeMap::new()).await?,
        Some(known) if known.role == Role::Node => {
            check_away(session, &known.organisation, name).await?;
            session.client.reissue(name, &BTreeMap::new()).await?
        }
        Some(known) => {
            return Err(Rejection::new(
                Code::AlreadyRegistered,
                format!(
                    "{name} is registered with another role than \
                                                                        node"
                ),
            )
            .found(format!("role {}", known.role))
            .wanted("an unused name, or that of a node"));
        }
    };
    let token = door.token(registered.organisation, name.to_owned(), JoinKind::Node, registered.secret);
    Ok(invited(&token, Some(registered.expires), None))
}

/// Rejects to invite a node that is a member and runs: its token would change nothing.
async fn check_away(session: &Session, organisation: &str, name: &str) -> Result<(), Rejection> {
    let status = session.client.status().await?;
    let nodes = nodes(session).await?.nodes;
    let is_meant =
        |node: &&NodeRecord| node.organisation == organisation && node.name == name && node.role != NodeRole::Removed;
    let Some(node) = nodes.iter().find(is_meant) else { return Ok(()) };
    let is_connected = status.peers.iter().any(|peer| peer.node_id == node.id && peer.connected);
    // The other nodes notice late that a machine is gone.
    let connected = tokio::time::timeout(ANSWER_TIME_MAX, TcpStream::connect(node.address.as_str()));
    if node.id != status.node_id && !(is_connected && matches!(connected.await, Ok(Ok(_)))) {
        return Ok(());
    }
    Err(Rejection::new(Code::AlreadyExists, format!("node {} is running: it cannot join again", node.full_name()))
        .found(format!("node {}, a {}, which answers at {}", node.id, node.role, node.address))
        .wanted("a new name, or a node that is lost")
        .next(
            "for a new certificate of this node, on its machine: ledgerd renew --config ledgerd.toml; if its disk \
               is lost, stop it first",
        ))
}

fn invited(token: &JoinToken, expires: Option<u64>, decision: Option<Decision>) -> Invited {
    Invited {
        organisation: token.organisation.clone(),
        node: token.node.clone(),
        token: token.to_string(),
        expires,
        decision,
        command: format!("ledgerd join {token}"),
    }
}

/// Where a newcomer knocks: the nodes of one organisation, and its CA.
struct Door {
    network: Hash,
    ca: Hash,
    addresses: Vec<String>,
}

impl Door {
    /// The node that we are connected to, and the others of its organisation.
    async fn of(session: &Session) -> Result<Self, Rejection> {
        let status = session.client.status().await?;
        let msps = msps_of(&session.client.network().await?.organisations)?;
        let root = msps.get(&status.organisation).and_then(|msp| msp.roots().next().map(|root| Hash::of(&[root])));
        let ca = match root {
            Some(root) => root,
            None => session.ca_fingerprint(&status.organisation)?,
        };
        let nodes = nodes(session).await?.nodes;
        let addresses = addresses(&nodes, &status.organisation, status.node_id);
        // A node that has not caught up with its own joining.
        let addresses = if addresses.is_empty() { vec![session.client.node().to_string()] } else { addresses };
        Ok(Self { network: session.context().network, ca, addresses })
    }

    fn token(self, organisation: String, node: String, kind: JoinKind, secret: String) -> JoinToken {
        let Self { network, ca, addresses } = self;
        JoinToken { network, addresses, ca, organisation, node, kind, secret }
    }
}

/// The addresses of an organisation's nodes, this one's first.
fn addresses(nodes: &[NodeRecord], organisation: &str, first: u64) -> Vec<String> {
    let mut nodes: Vec<_> =
        nodes.iter().filter(|node| node.organisation == organisation && node.role != NodeRole::Removed).collect();
    nodes.sort_by_key(|node| (node.id != first, node.id));
    nodes.into_iter().map(|node| node.address.clone()).take(ADDRESSES_MAX).collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn door() -> Door {
        Door { network: Hash([1; 32]), ca: Hash([2; 32]), addresses: vec!["10.0.0.4:7450".into()] }
    }

    fn told(invited: &Invited) -> String {
        let mut out = Vec::new();
        invited.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_token_is_told_with_the_command_that_uses_it() {
        let token = door().token("Org1".into(), "node2".into(), JoinKind::Node, "s3cret".into());
        let text = told(&invited(&token, None, None));
        assert!(text.starts_with("invited node Org1/node2\n"), "{text}");
        let command = text.lines().last().unwrap().trim();
        let word = command.strip_prefix("ledgerd join ").unwrap();
        assert_eq!(word.parse::<JoinToken>().unwrap(), token);
    }

    #[test]
    fn an_organisation_that_waits_for_approvals_is_told_so() {
        let token = door().token("Org3".into(), "node1".into(), JoinKind::Organisation, "00".repeat(32));
        let argument = format!(r#"{{"name":"Org3","key":"{}","expires":9}}"#, Hash::ZERO);
        let function = "invite_organisation".into();
        let call = ledger::Call { chaincode: "msp".into(), function, args: vec![argument.into()] };
        let proposal = ledger::msp::Proposal {
            id: Hash([0xab; 32]),
            call,
            by: "Org1/admin".into(),
            organisation: "Org1".into(),
            approvals: ["Org1".to_owned()].into(),
            created: 0,
            expires: 1,
            approved_by: vec![],
            failed: None,
        };
        let (proposal, pending) = (Some(proposal), vec!["Org2".to_owned()]);
        let decision = Decision { executed: false, proposal, missing: 1, pending, quorum: None };
        let text = told(&invited(&token, Some(9), Some(decision.clone())));
        for part in ["invited organisation Org3\n", "approve abababababab\n", "then, on the machine of Org3/node1:\n"] {
            assert!(text.contains(part), "{part:?} in {text}");
        }
        let text = told(&invited(&token, Some(9), Some(Decision { executed: true, ..decision })));
        assert!(!text.contains("approve") && text.contains("next, on the machine of Org3/node1"), "{text}");
    }

    #[test]
    fn a_newcomer_tries_the_node_first_that_made_the_token() {
        let node = |id: u64, organisation: &str, role| NodeRecord {
            id,
            name: format!("node{id}"),
            organisation: organisation.into(),
            address: format!("node{id}:7450"),
            role,
            speaks: None,
        };
        let nodes = [
            node(1, "Org1", NodeRole::Voter),
            node(2, "Org2", NodeRole::Voter),
            node(3, "Org1", NodeRole::Removed),
            node(4, "Org1", NodeRole::Learner),
        ];
        assert_eq!(addresses(&nodes, "Org1", 4), ["node4:7450", "node1:7450"]);
    }
}
