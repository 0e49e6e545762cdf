//! The description of a node: its name, its chain, its links to others, and its use.

use super::Audience;
use crate::clients::rejections::Rejections;
use crate::ordering::directory::Member;
use crate::ordering::orderer::Executed;
use crate::peers::attestation::Witness;
use crate::peers::chain_monitor::ChainMonitor;
use crate::peers::quorum_certificates::Certificates;
use crate::peers::reachability::Reachability;
use crate::process::clock::Clock;
use crate::process::config::Limits;
use crate::process::idle_control::IdleControl;
use crate::process::meters::Meters;
use crate::storage::blocks::Blocks;
use ledger::{Ledger, msp};
use ledger_api::tls::TlsIdentity;
use ledger_api::v1::{CertificateStatus, PeerStatus, StatusResponse};
use ledger_base::rejection::Rejection;
use ledger_identity::certificate::Certificate;
use ledger_raft::{ClockDoubt, Role};
use ledger_replica::gateway::Shares;
use ledger_traces::Tracer;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

/// Describes a node.
pub(crate) struct Description {
    /// This node, as it was known when it started.
    pub me: Member,
    /// Name of the network for people.
    pub label: String,
    /// When the node started.
    pub started: Instant,
    /// The node's clock.
    pub clock: Clock,
    /// This node's certificate, for when it ends.
    pub identity: TlsIdentity,
    /// The chain of this node.
    pub chain: Chain,
    /// The ways to be ordered through this node.
    pub links: Reachability,
    /// How much it is used.
    pub usage: Usage,
    /// How long the steps of a command take.
    pub meters: Meters,
    /// Keeps the processors awake.
    pub awake: Arc<IdleControl>,
    /// Where the steps of messages are told.
    pub tracer: Tracer,
    /// Where browsers find the console, once there is one.
    pub console: OnceLock<String>,
}

/// The chain of a node.
pub(crate) struct Chain {
    /// The ledger.
    pub ledger: Arc<Ledger>,
    /// Executed blocks.
    pub blocks: Arc<Blocks>,
    /// Attests.
    pub witness: Arc<Witness>,
    /// Compares its chain with the others'.
    pub company: Arc<ChainMonitor>,
    /// Certificates of blocks, and the proofs of lies.
    pub certificates: Arc<Certificates>,
}

/// How much a node is used.
pub(crate) struct Usage {
    /// The calls that each identity has in flight.
    pub shares: Arc<Shares>,
    /// The identities that have subscriptions.
    pub audience: Arc<Audience>,
    /// Calls that were refused.
    pub denials: Arc<Rejections>,
    /// Transactions that were executed.
    pub executed: Arc<Executed>,
    /// Limits of the configuration.
    pub limits: Limits,
}

impl Description {
    /// The node as it is now.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) fn status(&self) -> Result<StatusResponse, Rejection> {
        let tip = self.chain.ledger.tip();
        let ordering = self.links.slot.status();
        let members = self.links.directory.members();
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
            let clock = self.chain.company.clock_of(member.id);
            PeerStatus {
                node_id: member.id,
                matched: matched(member.id),
                name: member.name.clone(),
                organisation: member.organisation.clone(),
                address: member.address.clone(),
                role: member.role().into(),
                voter: member.votes(),
                connected: self.links.peers.connected(member.id),
                clock_offset_us: clock.map_or(0, |clock| clock.ahead),
                clock_error_us: clock.map_or(0, |clock| clock.error),
            }
        });
        let now = self.clock.both();
        // Where several vote, the others judge the clock.
        let doubt = now.doubt.filter(|_| voters().eq([self.me.id])).map(ClockDoubt::refusal);
        Ok(StatusResponse {
            version: env!("CARGO_PKG_VERSION").into(),
            network: self.chain.ledger.network().0.to_vec().into(),
            network_label: self.label.clone(),
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
            clock: now.clock.max(tip.time),
            wall_clock: self.clock.wall(),
            clock_doubt: doubt.map(|doubt| format!("{}: {}", doubt.message, doubt.found)).unwrap_or_default(),
            uptime_ms: u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX),
            chaincodes: self.chain.ledger.registry().names().into_iter().map(str::to_owned).collect(),
            refused: self.usage.denials.counts(),
            executed: self.usage.executed.counts(),
            peers: peers.collect(),
            subscribers: self.usage.audience.len(),
            payload_bytes_max: self.usage.limits.payload_bytes_max,
            resident_bytes: resident_bytes(),
            first_height: self.chain.blocks.first_height(),
            snapshot_height: self.chain.witness.snapshot_height(),
            catching_up_to: self.links.slot.catching_up_to().unwrap_or_default(),
            divergence: self.chain.company.describe(),
            certified: self.chain.certificates.certified(),
            lies: self.chain.certificates.lies(&self.links.directory),
            in_flight: self.usage.shares.in_flight() as u64,
            in_flight_max: self.usage.limits.in_flight_max,
            waiting_control: ordering.as_ref().map_or(0, |ordering| ordering.control.transactions as u64),
            waiting_data: ordering.as_ref().map_or(0, |ordering| ordering.data.transactions as u64),
            data_directory: self.links.space.data().display().to_string(),
            disk_free_bytes: self.links.space.measured().free,
            disk_total_bytes: self.links.space.measured().total,
            disk_accepts: self.links.space.accepts().word().into(),
            certificates: self.certificates(),
            console: self.console.get().cloned().unwrap_or_default(),
            voters: u32::try_from(voters().count()).unwrap_or(u32::MAX),
            voters_connected: u32::try_from(voters().filter(|id| self.links.is_connected(*id)).count())
                .unwrap_or(u32::MAX),
        })
    }

    /// The certificates that this node depends on, and the revocation lists of the network. One that cannot be read is left out: then the node does not run.
    fn certificates(&self) -> Vec<CertificateStatus> {
        let status = |kind: &str, name: Option<String>, der: &[u8]| {
            let Certificate { subject, not_before, not_after, .. } = Certificate::parse(der).ok()?;
            Some(CertificateStatus { kind: kind.to_owned(), name: name.unwrap_or(subject), not_before, not_after })
        };
        let own = self.identity.own();
        let msps = self.chain.ledger.msps();
        let msp = msps.get(&self.me.organisation);
        let authorities = msp.into_iter().flat_map(|msp| msp.roots().chain(msp.intermediates()));
        let authorities = authorities.filter_map(|der| status("ca", None, der));
        let lists = msp::revocation_lists(&**self.chain.ledger.state()).unwrap_or_default();
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
