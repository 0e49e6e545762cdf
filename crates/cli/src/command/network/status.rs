//! `network status`: how every node is, asked one by one.

use super::nodes::{absent, actual};
use crate::answer;
use crate::failure::Failure;
use crate::health::{
    Attention, Check, Voters, certificate_ends, certificate_text, certificates, disk, disk_free, own_certificate,
    print_attention,
};
use crate::nodes::current;
use crate::output::{Facts, Output, Table};
use crate::session::{MSP, Session};
use crate::time;
use ledger::msp::{AttestationRecord, NodeRecord, NodeRole, Nodes};
use ledger_api::facts::{CRITICAL, CertificateFacts, CertificateRuleFacts, DiskFacts};
use ledger_api::{Client, Context, Credentials, Options, v1};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::time::Duration;
use tokio::task::JoinSet;

/// How long one node has to answer.
const PATIENCE: Duration = Duration::from_secs(3);

/// Show the state of every node of the network.
///
/// Each node is asked for its own state. ROLE is its current role in the ordering, TARGET the role on the ledger.
/// REPLICATED is the last block that the leader has replicated to it, SIGNED UP TO the last height whose state it has
/// signed. Exits with 4 if nothing can be ordered: no majority of the voters answers, or there is no leader.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl network status
  ledgerctl network status --check")]
pub(crate) struct Status {
    #[command(flatten)]
    check: Check,
}

/// The network as its nodes see it.
#[derive(Serialize)]
pub(crate) struct Overview {
    network: Hash,
    label: String,
    /// 0 = nobody knows one.
    leader_id: u64,
    term: u64,
    /// Greatest height that a node has executed.
    pub(crate) height: u64,
    #[serde(flatten)]
    pub(crate) quorum: Voters,
    /// How many signatures make a certificate, and the faults that the voters survive.
    pub(crate) certificate_rule: CertificateRuleFacts,
    pub(crate) nodes: Vec<Node>,
    /// Those of the CAs, and the own one; each node has its own.
    pub(crate) certificates: Vec<CertificateFacts>,
    /// Problems, with the nodes that report them.
    pub(crate) attention: Vec<Attention>,
    /// When it was asked.
    #[serde(skip)]
    now: u64,
}

/// A node.
#[derive(Serialize)]
pub(crate) struct Node {
    id: u64,
    name: String,
    pub(crate) organisation: String,
    pub(crate) address: String,
    /// Its wanted role.
    wanted: NodeRole,
    /// Its present role: voter, learner, joining or removed.
    pub(crate) role: String,
    leader: bool,
    pub(crate) reachable: bool,
    /// Why it is not reachable.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub(crate) reason: String,
    /// Its own report; none if it is not reachable.
    pub(crate) height: Option<u64>,
    committed: Option<u64>,
    first_height: Option<u64>,
    snapshot_height: Option<u64>,
    pub(crate) catching_up_to: Option<u64>,
    pub(crate) version: Option<String>,
    #[serde(skip_serializing_if = "String::is_empty")]
    pub(crate) divergence: String,
    /// Newest height for which it has a certificate.
    certified: Option<u64>,
    /// Members that have lied, by proof.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub(crate) lies: String,
    /// Members that have signed two different results of one block.
    #[serde(skip_serializing_if = "String::is_empty")]
    faults: String,
    /// How much of the log is on its disk, as the leader knows.
    matched: Option<u64>,
    /// Last height that it has attested.
    attested: Option<u64>,
    pub(crate) disk: Option<DiskFacts>,
    pub(crate) certificate: Option<CertificateFacts>,
    /// Problems by its own report.
    #[serde(skip)]
    attention: Vec<Attention>,
    /// The clock of its machine as seen from this one's, microseconds, and how far off that may be.
    pub(crate) clock_offset_us: Option<i64>,
    pub(crate) clock_error_us: Option<u64>,
}

impl Status {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let overview = asked(session).await?;
        output.show(&overview)?;
        self.check.judge(overview.quorum.quorum, &overview.attention)
    }
}

/// Asks every node how it is, and collects what needs attention.
pub(crate) async fn asked(session: &Session) -> Result<Overview, Rejection> {
    let known: Nodes = glance(session, "nodes", "the nodes").await?;
    let attestations: Vec<AttestationRecord> = glance(session, "attestations", "the attestations").await?;
    let credentials = current(session).await?.credentials()?;
    let answers = everybody(&known, &credentials).await;
    let mut overview = overview(session.context(), &known, &attestations, answers);
    let own = own_certificate(&session.identity()?);
    overview.look(&own, time::now());
    overview.certificates.push(own);
    Ok(overview)
}

/// The state of the node, however old: without a leader no node could confirm that it is the newest.
async fn glance<T: DeserializeOwned>(session: &Session, function: &str, what: &str) -> Result<T, Rejection> {
    answer::parse(&session.client.query_at(0, MSP, function, vec![]).await?.response, what)
}

/// The report of a node, and this machine's time when it was asked for and when it came.
struct Answer {
    status: v1::StatusResponse,
    asked: u64,
    came: u64,
}

impl Answer {
    /// The clock of the node's machine as seen from this one's, and how far off that may be: half of the way there and back.
    fn clock(&self) -> (i64, u64) {
        let doubt = self.came.saturating_sub(self.asked) / 2;
        let here = self.asked.saturating_add(doubt);
        (i64::try_from(i128::from(self.status.wall_clock) - i128::from(here)).unwrap_or_default(), doubt)
    }
}

type Answers = BTreeMap<u64, Result<Answer, Rejection>>;

/// Asks all nodes at once.
async fn everybody(known: &Nodes, credentials: &Credentials) -> Answers {
    let mut asked = JoinSet::new();
    for node in known.nodes.iter().filter(|node| shown(known, node)) {
        let (id, address, credentials) = (node.id, node.address.clone(), credentials.clone());
        let options = Options { deadline: PATIENCE, connect: PATIENCE, ..Options::default() };
        asked.spawn(async move {
            let ask = async {
                let client = Client::connect_with(vec![address], credentials, options).await?;
                let asked = time::now();
                Ok(Answer { status: client.status().await?, asked, came: time::now() })
            };
            (id, ask.await)
        });
    }
    let mut answers = Answers::new();
    while let Some(answer) = asked.join_next().await {
        answers.extend(answer.ok());
    }
    answers
}

fn shown(known: &Nodes, node: &NodeRecord) -> bool {
    node.role != NodeRole::Removed || known.members.contains(node.id)
}

fn overview(context: &Context, known: &Nodes, attestations: &[AttestationRecord], mut answers: Answers) -> Overview {
    let reports = || answers.values().flatten().map(|answer| &answer.status);
    let newest = reports().max_by_key(|status| (status.term, status.leader_id != 0));
    let (leader_id, term) = newest.map_or((0, 0), |status| (status.leader_id, status.term));
    let leader = answers.get(&leader_id).and_then(|answer| answer.as_ref().ok()).map(|answer| &answer.status);
    let matched: BTreeMap<u64, u64> =
        leader.map(|leader| leader.peers.iter().map(|peer| (peer.node_id, peer.matched)).collect()).unwrap_or_default();
    let height = reports().map(|status| status.height).max().unwrap_or_default();
    let mut certificates: Vec<CertificateFacts> =
        reports().flat_map(certificates).filter(|found| found.kind == "ca").collect();
    certificates.sort();
    certificates.dedup();
    let nodes = known.nodes.iter().filter(|node| shown(known, node)).map(|node| {
        let answer = answers.remove(&node.id);
        // Another node may have taken its address.
        let (said, reason) = match answer {
            Some(Ok(said)) if said.status.node_id == node.id => (Some(said), String::new()),
            Some(Ok(other)) => (None, format!("node {} answers at this address", other.status.node_id)),
            Some(Err(refused)) => (None, refused.message),
            None => (None, "not queried".to_owned()),
        };
        let clock = said.as_ref().map(Answer::clock);
        let said = said.as_ref().map(|answer| &answer.status);
        Node {
            attention: said.map(Attention::of).unwrap_or_default(),
            clock_offset_us: clock.map(|(offset, _)| offset),
            clock_error_us: clock.map(|(_, doubt)| doubt),
            id: node.id,
            name: node.name.clone(),
            organisation: node.organisation.clone(),
            address: node.address.clone(),
            wanted: node.role,
            role: actual(&known.members, node.id).unwrap_or(absent(node.role)).to_owned(),
            leader: node.id == leader_id,
            reachable: said.is_some(),
            reason,
            height: said.map(|said| said.height),
            committed: said.map(|said| said.committed),
            first_height: said.map(|said| said.first_height),
            snapshot_height: said.map(|said| said.snapshot_height).filter(|height| *height > 0),
            catching_up_to: said.map(|said| said.catching_up_to).filter(|height| *height > 0),
            version: said.map(|said| said.version.clone()),
            divergence: said.map_or_else(String::new, |said| said.divergence.clone()),
            certified: said.map(|said| said.certified).filter(|height| *height > 0),
            lies: said.map_or_else(String::new, |said| said.lies.clone()),
            faults: said.map_or_else(String::new, |said| said.faults.clone()),
            matched: match said {
                Some(leader) if node.id == leader_id => Some(leader.last_index),
                _ => matched.get(&node.id).copied().filter(|matched| *matched > 0),
            },
            disk: said.and_then(disk),
            certificate: said.and_then(|said| self::certificates(said).into_iter().find(|found| found.kind == "node")),
            attested: attestations.iter().find(|record| record.id == node.id).map(|record| record.latest.attest.height),
        }
    });
    let nodes: Vec<_> = nodes.collect();
    let voters = || nodes.iter().filter(|node| node.role == "voter");
    let count = |count: usize| u64::try_from(count).unwrap_or(u64::MAX);
    let reachable = voters().filter(|node| node.reachable).count();
    Overview {
        network: context.network,
        label: context.label.clone(),
        leader_id,
        term,
        height,
        quorum: Voters::new(count(voters().count()), count(reachable), leader_id != 0),
        certificate_rule: CertificateRuleFacts::of(&known.voters()),
        nodes,
        certificates,
        attention: Vec::new(),
        now: 0,
    }
}

#[cfg(test)]
impl Node {
    /// A node that told nothing.
    pub(crate) fn silent(name: &str) -> Self {
        Self {
            id: 1,
            name: name.to_owned(),
            organisation: "Org1".to_owned(),
            address: String::new(),
            wanted: NodeRole::Voter,
            role: "voter".to_owned(),
            leader: false,
            reachable: false,
            reason: String::new(),
            height: None,
            committed: None,
            first_height: None,
            snapshot_height: None,
            catching_up_to: None,
            version: None,
            divergence: String::new(),
            certified: None,
            lies: String::new(),
            faults: String::new(),
            matched: None,
            attested: None,
            disk: None,
            certificate: None,
            attention: Vec::new(),
            clock_offset_us: None,
            clock_error_us: None,
        }
    }
}

impl Node {
    /// `ORGANISATION/NAME`.
    pub(crate) fn full_name(&self) -> String {
        format!("{}/{}", self.organisation, self.name)
    }

    /// One word or two for people.
    pub(crate) fn state(&self) -> String {
        match self {
            Self { reachable: false, .. } => "unreachable".into(),
            Self { divergence, .. } if !divergence.is_empty() => "differs".into(),
            Self { catching_up_to: Some(height), .. } => format!("catching up to {height}"),
            Self { leader: true, .. } => "leader".into(),
            _ => "follows".into(),
        }
    }
}

impl Overview {
    /// Collects what needs attention: what each node reports of itself, and what is seen from here.
    fn look(&mut self, own: &CertificateFacts, now: u64) {
        let mut attention = Vec::new();
        for node in &self.nodes {
            if !node.reachable {
                let message = format!("{} at {} does not answer: {}", node.full_name(), node.address, node.reason);
                let next = "on its machine: systemctl status ledgerd, journalctl -u ledgerd; then its port, from here";
                attention.push(Attention::here("peers", CRITICAL, message, next));
            }
            Attention::add(&mut attention, node.attention.iter().cloned());
        }
        let is_told = |item: &Attention| item.is_critical() && ["quorum", "leader"].contains(&&*item.facts.check);
        if !self.quorum.quorum && !attention.iter().any(is_told) {
            let next = "on the machine of each unreachable voter: systemctl status ledgerd; start it if it is \
                        stopped, restart it if it runs and does not answer";
            attention.push(Attention::here("quorum", CRITICAL, format!("voters: {}", self.quorum.text()), next));
        }
        attention.extend(Attention::own_certificate(own, now));
        self.attention = attention;
        self.now = now;
    }
}

impl Facts for Overview {
    fn rows(&self) -> serde_json::Result<String> {
        serde_json::to_string(&self.nodes)
    }

    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let leader = self.nodes.iter().find(|node| node.leader);
        let leader = leader.map_or_else(|| "none".to_owned(), |node| format!("{} (id {})", node.full_name(), node.id));
        let mut table = Table::pairs();
        table.pair("network", format!("{} {}", self.label, self.network).trim_start());
        table.pair("leader", format!("{leader}, term {}", self.term));
        table.pair("height", self.height);
        table.pair("voters", self.quorum.text());
        table.pair("certificates", self.certificate_rule.rule());
        table.pair("survives", self.certificate_rule.survives());
        for certificate in &self.certificates {
            table.pair("certificate", certificate_text(certificate, self.now));
        }
        table.write(out, 0)?;
        writeln!(out)?;
        let mut table = Table::new([
            "NODE",
            "ID",
            "ADDRESS",
            "ROLE",
            "TARGET",
            "HEIGHT",
            "REPLICATED",
            "SIGNED UP TO",
            "STATE",
            "DISK FREE",
            "CERTIFICATE",
        ]);
        let number = |number: Option<u64>| number.map_or_else(|| "-".to_owned(), |number| number.to_string());
        for node in &self.nodes {
            table.row([
                node.full_name(),
                node.id.to_string(),
                node.address.clone(),
                node.role.clone(),
                node.wanted.to_string(),
                number(node.height),
                number(node.matched),
                number(node.attested),
                node.state(),
                node.disk.as_ref().map_or_else(|| "-".to_owned(), disk_free),
                node.certificate
                    .as_ref()
                    .map_or_else(|| "-".to_owned(), |certificate| certificate_ends(certificate, self.now)),
            ]);
        }
        table.write(out, 0)?;
        print_attention(&self.attention, out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn overview_of(nodes: Vec<Node>) -> Overview {
        Overview {
            network: Hash::default(),
            label: String::new(),
            leader_id: 1,
            term: 1,
            height: 9,
            quorum: Voters::new(1, 1, true),
            certificate_rule: CertificateRuleFacts::default(),
            nodes,
            certificates: Vec::new(),
            attention: Vec::new(),
            now: 0,
        }
    }

    fn answering(name: &str) -> Node {
        Node { reachable: true, height: Some(5), ..Node::silent(name) }
    }

    fn looked(node: Node, quorum: Voters) -> Vec<String> {
        let own = certificates(&v1::StatusResponse {
            certificates: vec![v1::CertificateStatus { not_after: u64::MAX, ..Default::default() }],
            ..Default::default()
        });
        let mut overview = Overview { quorum, ..overview_of(vec![node]) };
        own.iter().for_each(|own| overview.look(own, 1));
        overview.attention.iter().map(Attention::text).collect()
    }

    #[test]
    fn what_a_node_reports_needs_attention_and_so_does_one_that_does_not_answer() {
        let one = Voters::new(1, 1, true);
        assert!(looked(answering("a"), one).is_empty());
        let reports = |check: &str| {
            let item = Attention::here(check, CRITICAL, "it is wrong".to_owned(), "repair it");
            Node { attention: vec![item], ..answering("a") }
        };
        assert_eq!(looked(reports("state"), one), ["it is wrong"]);
        let silent = Node { reason: "connection refused".to_owned(), address: "h:1".to_owned(), ..Node::silent("a") };
        assert_eq!(looked(silent, one), ["Org1/a at h:1 does not answer: connection refused"]);
        // A lost quorum is there once: by the nodes, or else as it is seen from here.
        let lost = Voters::new(3, 1, true);
        assert_eq!(looked(answering("a"), lost), ["voters: 1 of 3 answers; 2 are needed to order"]);
        assert_eq!(looked(reports("quorum"), lost), ["it is wrong"]);
    }

    #[test]
    fn the_clock_of_a_node_is_that_of_its_machine_also_where_block_time_is_ahead() {
        let offset = |wall_clock| {
            let status = v1::StatusResponse { clock: 240_000_000, wall_clock, ..Default::default() };
            Answer { status, asked: 5_000, came: 5_300 }.clock()
        };
        assert_eq!(offset(5_150), (0, 150));
        assert_eq!(offset(240_000_000), (239_994_850, 150));
    }
}
