//! The description of a node: its name, its chain, its links to others, and its use.

use super::Audience;
use crate::clients::attention::{self, CaKeys};
use crate::clients::rejections::Rejections;
use crate::ordering::Ordering;
use crate::ordering::directory::Member;
use crate::peers::Peers;
use crate::process::config::Limits;
use ledger::msp;
use ledger_api::tls::TlsIdentity;
use ledger_api::v1::{CertificateRule, CertificateStatus, PeerStatus, StatusResponse};
use ledger_base::rejection::Rejection;
use ledger_base::units::span;
use ledger_identity::certificate::Certificate;
use ledger_light::Survives;
use ledger_raft::{ClockDoubt, Deposition, Role};
use ledger_replica::gateway::Shares;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

/// Describes a node.
pub(crate) struct Description {
    /// This node, as it was known when it started.
    pub me: Member,
    /// This node's certificate, for when it ends.
    pub identity: TlsIdentity,
    /// When the node started.
    pub started: Instant,
    /// The chain of this node, and its part in ordering.
    pub ordering: Arc<Ordering>,
    /// The other nodes.
    pub peers: Arc<Peers>,
    /// The calls that each identity has in flight.
    pub shares: Arc<Shares>,
    /// The identities that have subscriptions.
    pub audience: Arc<Audience>,
    /// Rejected calls.
    pub rejections: Arc<Rejections>,
    /// Limits of the configuration.
    pub limits: Limits,
    /// The CA keys that this node reports about.
    pub ca_keys: CaKeys,
    /// A network for trials (`ledgerd dev`).
    pub is_trial: bool,
    /// Where browsers find the console, once there is one.
    pub console: OnceLock<String>,
}

impl Description {
    /// The node as it is now.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) fn status(&self) -> Result<StatusResponse, Rejection> {
        let tip = self.ordering.storage.ledger.tip();
        let ordering = self.ordering.slot.status();
        let members = self.ordering.directory.members();
        let me = members.iter().find(|member| member.id == self.me.id);
        let leading = ordering.as_ref().map(|ordering| ordering.role);
        let role = match (leading.map(|change| change.role), me) {
            (Some(Role::Leader), _) => "leader",
            (Some(Role::Candidate), _) => "candidate",
            (_, None) => "removed",
            (_, Some(me)) if me.votes() => "follower",
            (_, Some(me)) => me.role(),
        };
        let voters = || members.iter().filter(|member| member.votes()).map(|member| member.id);
        let matched = |id| {
            let peers = ordering.iter().flat_map(|ordering| &ordering.peers);
            peers.filter(|peer| peer.node == id).map(|peer| peer.matched).next().unwrap_or_default()
        };
        let others = members.iter().filter(|member| member.id != self.me.id);
        let peers = others.map(|member| {
            let clock = self.peers.monitor.clock_of(member.id);
            PeerStatus {
                node_id: member.id,
                matched: matched(member.id),
                name: member.name.clone(),
                organisation: member.organisation.clone(),
                address: member.address.clone(),
                role: member.role().into(),
                voter: member.votes(),
                connected: self.peers.connections.connected(member.id),
                clock_offset_us: clock.map_or(0, |clock| clock.ahead),
                clock_error_us: clock.map_or(0, |clock| clock.error),
            }
        });
        let now = self.ordering.clock.both();
        // Where several vote, the others judge the clock.
        let doubt = now.doubt.filter(|_| voters().eq([self.me.id])).map(ClockDoubt::refusal);
        let rule = self.ordering.storage.ledger.voters()?;
        let Survives { crashes, lie, silence } = rule.survives();
        let rule = CertificateRule {
            needed: u32::try_from(rule.quorum()).unwrap_or(u32::MAX),
            strict_since: rule.rule.strict_since,
            survives_crashes: u32::try_from(crashes).unwrap_or(u32::MAX),
            survives_lie: lie,
            survives_silence: silence,
        };
        let mut status = StatusResponse {
            version: env!("CARGO_PKG_VERSION").into(),
            network: self.ordering.storage.ledger.network().0.to_vec().into(),
            network_label: self.ordering.storage.genesis.label.clone(),
            node_id: self.me.id,
            node_name: self.me.name.clone(),
            organisation: self.me.organisation.clone(),
            role: role.into(),
            leader_id: leading.and_then(|change| change.leader).unwrap_or_default(),
            term: leading.map_or(tip.term, |change| change.term),
            height: tip.height,
            block_hash: tip.hash.0.to_vec().into(),
            block_time: tip.time,
            state_digest: tip.digest.0.to_vec().into(),
            // Ordering reports now and then; what is executed is committed in any case.
            committed: ordering.as_ref().map_or(0, |ordering| ordering.commit).max(tip.height),
            last_index: ordering.as_ref().map_or(0, |ordering| ordering.last).max(tip.height),
            clock: now.clock.saturating_add_signed(self.peers.monitor.clock_off()).max(tip.time),
            wall_clock: self.ordering.clock.wall(),
            attention: Vec::new(),
            certificate_rule: Some(rule),
            uptime_ms: u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX),
            chaincodes: self.ordering.storage.ledger.registry().names().into_iter().map(str::to_owned).collect(),
            refused: self.rejections.counts(),
            executed: self.ordering.executed.counts(),
            peers: peers.collect(),
            subscribers: self.audience.len(),
            payload_bytes_max: self.limits.payload_bytes_max,
            resident_bytes: resident_bytes(),
            first_height: self.ordering.storage.blocks.first_height(),
            snapshot_height: self.peers.witness.snapshot_height(),
            catching_up_to: self.ordering.slot.catching_up_to().unwrap_or_default(),
            divergence: self.divergence(),
            certified: self.peers.certificates.certified(),
            lies: self.peers.certificates.lies(&self.ordering.directory),
            faults: self.peers.certificates.faults(&self.ordering.directory),
            in_flight: self.shares.in_flight() as u64,
            in_flight_max: self.limits.in_flight_max,
            waiting_control: ordering.as_ref().map_or(0, |ordering| ordering.control.transactions as u64),
            waiting_data: ordering.as_ref().map_or(0, |ordering| ordering.data.transactions as u64),
            data_directory: self.ordering.storage.space.data().display().to_string(),
            disk_free_bytes: self.ordering.storage.space.measured().free,
            disk_total_bytes: self.ordering.storage.space.measured().total,
            disk_accepts: self.ordering.storage.space.accepts().word().into(),
            certificates: self.certificates(),
            open_stops: self.peers.early_stops.status(),
            depositions: ordering.as_ref().map_or(0, |ordering| ordering.depositions),
            deposed: ordering.as_ref().map_or_else(String::new, |ordering| self.deposed(&ordering.deposed, now.clock)),
            console: self.console.get().cloned().unwrap_or_default(),
            voters: u32::try_from(voters().count()).unwrap_or(u32::MAX),
            voters_connected: u32::try_from(voters().filter(|id| self.peers.reachability.is_connected(*id)).count())
                .unwrap_or(u32::MAX),
        };
        let doubt = doubt.map(|doubt| format!("{}: {}", doubt.message, doubt.found)).unwrap_or_default();
        let (ledger, own) = (&self.ordering.storage.ledger, &self.me.organisation);
        let ca_keys = self.ca_keys.of(ledger, &members, own, status.wall_clock)?;
        let is_recovered = !status.divergence.is_empty() && msp::recoveries(&**ledger.state())? > 0;
        let inputs =
            attention::Inputs { clock_doubt: &doubt, ca_keys: &ca_keys, is_recovered, is_trial: self.is_trial };
        status.attention = attention::of(&status, &inputs);
        Ok(status)
    }

    /// Contradictions of this node's chain, in words; empty if there are none.
    fn divergence(&self) -> String {
        let said = [self.peers.monitor.describe(), self.peers.certificates.two_certificates()];
        said.into_iter().filter(|said| !said.is_empty()).collect::<Vec<_>>().join(", ")
    }

    /// The leaders that voters have deposed, in words; empty if there are none.
    fn deposed(&self, deposed: &[Deposition], now: u64) -> String {
        let words = |deposition: &Deposition| {
            let ago = span(now.saturating_sub(deposition.time));
            let name = self.ordering.directory.name(deposition.leader);
            match deposition.times {
                1 => format!("voters deposed {name} {ago} ago"),
                times => format!("voters deposed {name} {times} times, most recently {ago} ago"),
            }
        };
        deposed.iter().map(words).collect::<Vec<_>>().join(", ")
    }

    /// The certificates that this node depends on, and the revocation lists of the network. One that cannot be read is left out:
    /// then the node does not run.
    fn certificates(&self) -> Vec<CertificateStatus> {
        let status = |kind: &str, name: Option<String>, der: &[u8]| {
            let Certificate { subject, not_before, not_after, .. } = Certificate::parse(der).ok()?;
            Some(CertificateStatus { kind: kind.to_owned(), name: name.unwrap_or(subject), not_before, not_after })
        };
        let own = self.identity.own();
        let msps = self.ordering.storage.ledger.msps();
        let msp = msps.get(&self.me.organisation);
        let authorities = msp.into_iter().flat_map(|msp| msp.roots().chain(msp.intermediates()));
        let authorities = authorities.filter_map(|der| status("ca", None, der));
        let lists = msp::revocation_lists(&**self.ordering.storage.ledger.state()).unwrap_or_default();
        let lists = lists.into_iter().filter_map(|list| {
            let (not_before, not_after) = (list.this_update, list.next_update?);
            let name = format!("{} of {}", list.subject, list.organisation);
            Some(CertificateStatus { kind: "list".to_owned(), name, not_before, not_after })
        });
        let node = status("node", Some(self.me.full_name()), own.certificate());
        node.into_iter().chain(authorities).chain(lists).collect()
    }
}

/// Resident memory of this process in bytes; 0 where the operating system does not tell.
fn resident_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok()).map_or(0, |kib| kib * 1024)
}
