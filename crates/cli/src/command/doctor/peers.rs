//! The nodes: their ports, their clocks, their certificates, their disks, and what they say of each other.

use super::finding::Finding;
use crate::command::network::status::{self, Node, Overview};
use crate::health::{Attention, certificate_text, disk_text};
use crate::session::{ABAC, Session};
use crate::time;
use ledger_api::facts::{CertificateFacts, CertificateRuleFacts};
use std::collections::BTreeSet;
use std::io;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::task::JoinSet;
use tokio::time::timeout;

/// How long a port may take to answer.
const PORT_MAX: Duration = Duration::from_secs(2);
/// Clocks that differ by more, in microseconds, make messages too old: robots drop them after a second unless their owner says
/// otherwise.
const CLOCK_OFF_US: u64 = 1_000_000;
/// Clocks that differ by more, in microseconds, are spoken of.
const CLOCK_DRIFTS_US: u64 = 100_000;

/// Tries the ports of the nodes that the context knows, all at once.
pub(super) async fn ports(addresses: &[String], findings: &mut Vec<Finding>) {
    let mut tried = JoinSet::new();
    for (at, address) in addresses.iter().cloned().enumerate() {
        tried.spawn(async move {
            let outcome = timeout(PORT_MAX, TcpStream::connect(address.as_str())).await;
            (at, port(&address, outcome.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into())).map(drop)))
        });
    }
    let mut found = tried.join_all().await;
    found.sort_by_key(|(at, _)| *at);
    findings.extend(found.into_iter().map(|(_, finding)| finding));
}

fn port(address: &str, outcome: io::Result<()>) -> Finding {
    let Err(error) = outcome else { return Finding::ok("port", format!("{address} accepts connections")) };
    let repair = match error.kind() {
        io::ErrorKind::ConnectionRefused => {
            "start the node there, or compare its `listen` with this address; ledgerctl context refresh fetches new \
             addresses"
        }
        io::ErrorKind::TimedOut => "open this TCP port in the firewalls between, or start the machine",
        io::ErrorKind::NetworkUnreachable | io::ErrorKind::HostUnreachable => {
            "connect this machine to that network: ip route get ADDRESS"
        }
        // A name without an address has no kind of its own.
        _ => "check that the name resolves: getent hosts NAME",
    };
    let why = if error.kind() == io::ErrorKind::TimedOut { "no answer".to_owned() } else { error.to_string() };
    Finding::wrong("port", format!("{address}: {why}"), repair)
}

/// Asks every node how it is. Is there a quorum?
pub(super) async fn look(session: &Session, findings: &mut Vec<Finding>) -> bool {
    findings.push(standing(session).await);
    match status::asked(session).await {
        Ok(overview) => {
            judge(&overview, time::now(), findings);
            overview.quorum.quorum
        }
        Err(refused) => {
            findings.push(Finding::refused("peers", &refused));
            false
        }
    }
}

/// Does the ledger take us for who we are?
async fn standing(session: &Session) -> Finding {
    // By the state of the node, however old: without a leader no node could confirm that it is the newest.
    match session.client.query_at(0, ABAC, "GetSubmittingClientIdentity", vec![]).await {
        Ok(_) => Finding::ok("identity", format!("accepted by the ledger, through {}", session.client.node())),
        Err(refused) => Finding::refused("identity", &refused),
    }
}

/// The problems, and a line for each check that found none.
fn judge(overview: &Overview, now: u64, findings: &mut Vec<Finding>) {
    findings.extend(clocks(&overview.nodes));
    // The own certificate was looked at before.
    let attention: Vec<_> = overview.attention.iter().filter(|item| !item.is_own()).collect();
    let needs = |checks: &[&str], node: &str| {
        attention.iter().any(|item| checks.contains(&&*item.facts.check) && (node.is_empty() || item.is_of(node)))
    };
    findings.extend(attention.iter().map(|item| finding(item)));
    if !needs(&["quorum", "leader"], "") {
        findings.push(Finding::ok("quorum", format!("voters: {}", overview.quorum.text())));
    }
    findings.extend(survived(&overview.certificate_rule, &overview.nodes));
    for node in overview.nodes.iter().filter(|node| node.reachable) {
        let name = node.full_name();
        if !needs(&["log", "state"], &name) {
            let height = node.height.unwrap_or_default();
            findings.push(Finding::ok("peers", format!("{name} at {}: height {height}", node.address)));
        }
        if let Some(disk) = node.disk.as_ref().map(disk_text).filter(|_| !needs(&["disk"], &name)) {
            findings.push(Finding::ok("disk", format!("{name}: {disk}")));
        }
        findings.extend(version(node));
    }
    let of_nodes = overview.nodes.iter().filter_map(|node| node.certificate.as_ref());
    let cas = overview.certificates.iter().filter(|found| found.kind != "own");
    let needs_none = |found: &&CertificateFacts| {
        !attention.iter().any(|item| item.facts.check == "certificate" && item.facts.message.contains(&found.name))
    };
    let well = of_nodes.chain(cas).filter(needs_none);
    findings.extend(well.map(|found| Finding::ok("certificate", certificate_text(found, now))));
}

/// The faults that the voters survive. Where one organisation has all of them, its lie harms no other one.
fn survived(rule: &CertificateRuleFacts, nodes: &[Node]) -> Option<Finding> {
    if rule.signatures_needed == 0 {
        return None;
    }
    let message = format!("certificates: {}; the voters survive {}", rule.rule(), rule.survives());
    let voters = nodes.iter().filter(|node| node.role != "learner");
    let organisations: BTreeSet<&str> = voters.map(|node| &*node.organisation).collect();
    Some(if rule.survives_lie || organisations.len() < 2 {
        Finding::ok("quorum", message)
    } else {
        let repair = "four organisations with one voter each tolerate one lying organisation: docs/cluster.md";
        Finding::advice("quorum", message, repair)
    })
}

/// Something that needs attention, as a finding.
fn finding(item: &Attention) -> Finding {
    let (check, message, repair) = (item.facts.check.clone(), item.text(), item.facts.next.clone());
    if item.is_critical() { Finding::wrong(check, message, repair) } else { Finding::advice(check, message, repair) }
}

/// A node of another version than this program.
fn version(node: &Node) -> Option<Finding> {
    let own = env!("CARGO_PKG_VERSION");
    let version = node.version.as_deref().filter(|version| *version != own)?;
    let message = format!("{} is version {version}, ledgerctl {own}", node.full_name());
    Some(Finding::advice(
        "version",
        message,
        "upgrade the nodes one by one: docs/operations.md, \"Upgrading a \
                                              network\"",
    ))
}

/// The clock of this machine against those of the nodes, and of each node against the others.
fn clocks(nodes: &[Node]) -> Vec<Finding> {
    let told: Vec<(String, i64, u64)> =
        nodes.iter().filter_map(|node| Some((node.full_name(), node.clock_offset_us?, node.clock_error_us?))).collect();
    // The voters decide which clock is wrong, where any of them answers.
    let of = |voters: bool| {
        nodes.iter().filter(move |node| !voters || node.role != "learner").filter_map(|node| node.clock_offset_us)
    };
    let mut offsets: Vec<i64> = if of(true).next().is_some() { of(true).collect() } else { of(false).collect() };
    offsets.sort_unstable();
    // Of an even number the nearer to us: two nodes that differ say nothing against this machine.
    let below = offsets.get(offsets.len().saturating_sub(1) / 2);
    let above = offsets.get(offsets.len() / 2);
    let Some(common) = below.into_iter().chain(above).copied().min_by_key(|offset| offset.unsigned_abs()) else {
        return vec![Finding::unknown("clock", "no node reported its time", "ledgerctl network status")];
    };
    let doubt = told.iter().map(|(_, _, doubt)| *doubt).max().unwrap_or_default();
    let mut found = vec![off("this machine's clock", -common, doubt, "timedatectl set-ntp true")];
    let apart = told.iter().filter(|(_, offset, doubt)| apart(offset - common) > CLOCK_DRIFTS_US + doubt);
    let repair = "on that machine: timedatectl set-ntp true";
    found.extend(
        apart.map(|(name, offset, doubt)| off(&format!("the clock of {name}"), offset - common, *doubt, repair)),
    );
    found
}

fn apart(offset: i64) -> u64 {
    offset.unsigned_abs()
}

fn off(whose: &str, offset: i64, doubt: u64, repair: &str) -> Finding {
    let way = if offset > 0 { "ahead of" } else { "behind" };
    let text = format!("{whose} is {} {way} that of the nodes", time::span(apart(offset)));
    match apart(offset).saturating_sub(doubt) {
        far if far > CLOCK_OFF_US => Finding::wrong("clock", text, repair),
        far if far > CLOCK_DRIFTS_US => Finding::advice("clock", text, repair),
        _ => Finding::ok("clock", format!("{whose} agrees with the nodes, to {}", time::span(doubt.max(1)))),
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::State;
    use super::*;
    use ledger_api::v1;

    fn node(name: &str, offset: i64) -> Node {
        let mut node = Node::silent(name);
        (node.clock_offset_us, node.clock_error_us) = (Some(offset), Some(1_000));
        node
    }

    fn states(offsets: &[i64]) -> Vec<(State, bool)> {
        let nodes: Vec<Node> = offsets.iter().map(|offset| node("a", *offset)).collect();
        clocks(&nodes).iter().map(|found| (found.state, found.message.starts_with("this machine"))).collect()
    }

    #[test]
    fn the_clock_that_differs_from_most_is_the_wrong_one() {
        assert_eq!(states(&[0, 5_000, -5_000]), [(State::Ok, true)]);
        assert_eq!(states(&[9_000_000, 9_000_000, 9_000_000]), [(State::Wrong, true)]);
        assert_eq!(states(&[0, 0, -9_000_000]), [(State::Ok, true), (State::Wrong, false)]);
        assert_eq!(states(&[0, 9_000_000]), [(State::Ok, true), (State::Wrong, false)]);
        assert_eq!(states(&[300_000]), [(State::Advice, true)]);
        assert_eq!(states(&[]), [(State::Unknown, false)]);
    }

    #[test]
    fn a_lie_that_the_voters_do_not_survive_is_advice_where_there_is_another_organisation() {
        let node = |organisation: &str| {
            let mut node = node("a", 0);
            node.organisation = organisation.into();
            node
        };
        let rule = |needed, lie: bool| CertificateRuleFacts {
            signatures_needed: needed,
            strict_since: lie.then_some(0),
            survives_crashes: 1,
            survives_lie: lie,
            survives_silence: lie,
        };
        let of = |needed, lie, nodes: &[Node]| survived(&rule(needed, lie), nodes).map(|found| found.state);
        let (one, two) = ([node("Org1"), node("Org1")], [node("Org1"), node("Org2")]);
        assert_eq!(of(2, false, &one), Some(State::Ok));
        assert_eq!(of(2, false, &two), Some(State::Advice));
        assert_eq!(of(3, true, &two), Some(State::Ok));
        assert_eq!(of(0, false, &two), None, "no node has said it");
    }

    #[test]
    fn learners_do_not_decide_which_clock_is_wrong() {
        let mut nodes = [0, 0, 9_000_000, 9_000_000, 9_000_000].map(|offset| node("a", offset));
        nodes.iter_mut().skip(2).for_each(|node| node.role = "learner".into());
        let wrong: Vec<bool> = clocks(&nodes).iter().map(|found| found.state == State::Wrong).collect();
        assert_eq!(wrong, [false, true, true, true]);
    }

    #[test]
    fn a_clock_is_ahead_where_the_nodes_are_behind() {
        let told = clocks(&[node("a", -9_000_000)]);
        let told = told.first().map(|found| found.message.as_str());
        assert_eq!(told, Some("this machine's clock is 9 s ahead of that of the nodes"));
    }

    #[test]
    fn what_keeps_somebody_from_something_is_wrong_and_the_rest_is_advice() {
        let item = |severity: &str| v1::Attention {
            check: "disk".into(),
            severity: severity.into(),
            message: "1 GiB free".into(),
            next: "make room".into(),
        };
        let attention = ["critical", "warning"].map(item).to_vec();
        let status =
            v1::StatusResponse { organisation: "Org1".into(), node_name: "a".into(), attention, ..Default::default() };
        let found: Vec<_> = Attention::of(&status).iter().map(finding).collect();
        let states: Vec<_> = found.iter().map(|found| found.state).collect();
        assert_eq!(states, [State::Wrong, State::Advice]);
        let same = |found: &Finding| {
            (&*found.check, &*found.message, &*found.r#try) == ("disk", "Org1/a: 1 GiB free", "make room")
        };
        assert!(found.iter().all(same), "{found:?}");
    }

    #[test]
    fn each_way_in_which_a_port_is_silent_has_its_own_repair() {
        let kinds = [io::ErrorKind::ConnectionRefused, io::ErrorKind::TimedOut, io::ErrorKind::NetworkUnreachable];
        let mut repairs: Vec<String> = kinds.into_iter().map(|kind| port("a:1", Err(kind.into())).r#try).collect();
        repairs.push(port("a:1", Err(io::Error::other("failed to lookup address"))).r#try);
        repairs.sort();
        repairs.dedup();
        assert_eq!(repairs.len(), 4);
        assert_eq!(port("a:1", Ok(())).state, State::Ok);
    }
}
