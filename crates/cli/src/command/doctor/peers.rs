//! The nodes: their ports, their clocks, their certificates, their disks, and what they say of each other.

use super::finding::Finding;
use crate::command::network::status::{self, Node, Overview};
use crate::health::{Certificate, uncertified};
use crate::session::{ABAC, Session};
use crate::time;
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
            "start the node there, or compare its `listen` with this address; ledgerctl context refresh learns new addresses"
        }
        io::ErrorKind::TimedOut => "let TCP to this port through the firewalls on the way, or switch the machine on",
        io::ErrorKind::NetworkUnreachable | io::ErrorKind::HostUnreachable => {
            "connect this machine to that network: ip route get ADDRESS"
        }
        // A name without an address has no kind of its own.
        _ => "check that the name has an address: getent hosts NAME",
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

fn judge(overview: &Overview, now: u64, findings: &mut Vec<Finding>) {
    findings.extend(clocks(&overview.nodes));
    findings.push(voters(overview));
    for node in &overview.nodes {
        findings.extend(peer(node));
    }
    let disks = overview.nodes.iter().filter_map(|node| Some((node.full_name(), node.disk.as_ref()?)));
    for (name, disk) in disks {
        findings.push(match disk.attention(&name) {
            None => Finding::ok("disk", format!("{name}: {}", disk.text())),
            Some(text) => Finding::wrong(
                "disk",
                text,
                "make room there, or keep fewer blocks: `retention` and `archive` in ledgerd.toml",
            ),
        });
    }
    let of_nodes = overview.nodes.iter().filter_map(|node| node.certificate.as_ref());
    let cas = overview.certificates.iter().filter(|found| found.kind != "own");
    findings.extend(of_nodes.chain(cas).map(|found| certificate(found, now)));
}

/// The quorum.
fn voters(overview: &Overview) -> Finding {
    let text = overview.quorum.text();
    let answer = overview.nodes.iter().filter(|node| node.role == "voter");
    let alone = uncertified(answer.map(|node| (&*node.organisation, node.reachable)));
    match (overview.quorum.attention(), alone) {
        (Some(_), _) if !overview.quorum.quorum => Finding::wrong(
            "quorum",
            format!("voters: {text}"),
            "start the nodes that are silent: systemctl start ledgerd",
        ),
        (_, Some(alone)) => Finding::wrong("quorum", alone, "start a voter of the other organisation"),
        (Some(_), None) => Finding::wrong(
            "quorum",
            format!("voters: {text}"),
            "start the nodes that are silent before another one fails: systemctl start ledgerd",
        ),
        (None, None) => Finding::ok("quorum", format!("voters: {text}")),
    }
}

/// The faults of a node; one that answers and agrees is ok.
fn peer(node: &Node) -> Vec<Finding> {
    let name = node.full_name();
    let mut found = Vec::new();
    match (node.reachable, node.catching_up_to) {
        (false, _) => found.push(Finding::wrong(
            "peers",
            format!("{name} at {}: {}", node.address, node.reason),
            "on its machine: systemctl status ledgerd, journalctl -u ledgerd; then its port, from here",
        )),
        (true, Some(height)) => found.push(Finding::advice(
            "peers",
            format!("{name} fetches what it lacks, up to block {height}"),
            "wait: ledgerctl network status shows how far it is",
        )),
        (true, None) if node.divergence.is_empty() && node.lies.is_empty() => {
            let height = node.height.unwrap_or_default();
            found.push(Finding::ok("peers", format!("{name} at {}: height {height}", node.address)));
        }
        (true, None) => {}
    }
    if !node.divergence.is_empty() {
        let repair = "on its machine: ledgerd verify DATA, then ledgerd rejoin --config ledgerd.toml";
        found.push(Finding::wrong("peers", format!("{name}: {}", node.divergence), repair));
    }
    if !node.lies.is_empty() {
        let repair = "decide who of its organisation answers for it, then: ledgerctl network remove NODE";
        found.push(Finding::wrong("peers", format!("{name} has proofs: {}", node.lies), repair));
    }
    if !node.clock_wrong.is_empty() {
        let repair = "on its machine: timedatectl set-ntp true; if its clock is right: docs/operations.md, \"Clocks\"";
        found.push(Finding::wrong("clock", format!("{name}: {}", node.clock_wrong), repair));
    }
    let own = env!("CARGO_PKG_VERSION");
    if let Some(version) = node.version.as_deref().filter(|version| *version != own) {
        let message = format!("{name} is version {version}, ledgerctl {own}");
        found.push(Finding::advice(
            "version",
            message,
            "upgrade node by node: docs/operations.md, \"Upgrading a network\"",
        ));
    }
    found
}

fn certificate(found: &Certificate, now: u64) -> Finding {
    let repair = match found.kind.as_str() {
        "node" => "a node renews by itself: see its log for the reason that it could not (journalctl -u ledgerd)",
        "list" => "ledgerctl identity crl FILE, with a new list of that CA",
        _ => {
            "let the organisation make a new CA while the old one is valid: docs/operations.md, \"The CA of an organisation\""
        }
    };
    match found.attention(now) {
        None => Finding::ok("certificate", found.text(now)),
        Some(text) => Finding::wrong("certificate", text, repair),
    }
}

/// The clock of this machine against those of the nodes, and of each node against the others.
fn clocks(nodes: &[Node]) -> Vec<Finding> {
    let told: Vec<(String, i64, u64)> =
        nodes.iter().filter_map(|node| Some((node.full_name(), node.clock_offset_us?, node.clock_error_us?))).collect();
    let mut offsets: Vec<i64> = told.iter().map(|(_, offset, _)| *offset).collect();
    offsets.sort_unstable();
    // Of an even number the nearer to us: two nodes that differ say nothing against this machine.
    let below = offsets.get(offsets.len().saturating_sub(1) / 2);
    let above = offsets.get(offsets.len() / 2);
    let Some(common) = below.into_iter().chain(above).copied().min_by_key(|offset| offset.unsigned_abs()) else {
        return vec![Finding::unknown("clock", "no node told its time", "ledgerctl network status")];
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
    use ledger_api::v1::{CertificateStatus, StatusResponse};

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
    fn a_clock_is_ahead_where_the_nodes_are_behind() {
        let told = clocks(&[node("a", -9_000_000)]);
        let told = told.first().map(|found| found.message.as_str());
        assert_eq!(told, Some("this machine's clock is 9 s ahead of that of the nodes"));
    }

    #[test]
    fn a_node_whose_clock_is_behind_block_time_is_named() {
        let mut late = node("a", 0);
        late.clock_wrong = "block time is 9 s ahead of its clock".into();
        let found: Vec<_> = peer(&late).into_iter().filter(|found| found.check == "clock").collect();
        let told: Vec<_> = found.iter().map(|found| (found.state, found.message.as_str())).collect();
        assert_eq!(told, [(State::Wrong, "Org1/a: block time is 9 s ahead of its clock")]);
        assert!(peer(&node("a", 0)).iter().all(|found| found.check != "clock"));
    }

    #[test]
    fn a_list_that_has_ended_is_repaired_by_the_command_that_records_the_next_one() {
        let ended = CertificateStatus { kind: "list".into(), name: "ca of Org1".into(), not_before: 0, not_after: 5 };
        let status = StatusResponse { certificates: vec![ended], ..StatusResponse::default() };
        let told: Vec<_> = Certificate::of(&status).iter().map(|found| certificate(found, 6).r#try).collect();
        assert_eq!(told, ["ledgerctl identity crl FILE, with a new list of that CA"]);
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
