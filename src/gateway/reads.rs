//! Questions about the committed state, the chain and the node.

use super::{NodeView, status};
use crate::waiters::verdict_of;
use bytes::Bytes;
use ledger::Outcome;
use ledger_api::v1::{
    Block, CertificateStatus, DenialsResponse, EventRecord, PeerStatus, QueryRequest, QueryResponse, StatusResponse,
    TransactionRecord, Verdict,
};
use ledger_hash::Hash;
use ledger_identity::certificate::Certificate;
use ledger_identity::{Identity, Role};
use ledger_rejection::{Code, Rejection};
use ledger_storage::result::{BlockKind, EmittedEvent, Event};
use tonic::Status;

/// Refusals that are answered if the caller names no limit.
const DENIALS_DEFAULT: u32 = 100;

impl NodeView {
    pub(super) async fn query(&self, caller: &Identity, request: QueryRequest) -> Result<QueryResponse, Status> {
        if !request.may_be_stale {
            self.current.reach().await.map_err(|rejection| status(&rejection))?;
        }
        self.at_height(request.min_height).await.map_err(|rejection| status(&rejection))?;
        let answer = self.ledger.query(caller, self.clock.now(), &request.chaincode, &request.function, &request.args);
        Ok(match answer {
            Ok((response, height)) => QueryResponse { verdict: Some(Verdict::default()), response, height },
            Err(rejection) => {
                let height = self.ledger.tip().height;
                QueryResponse { verdict: Some((&rejection).into()), response: Bytes::new(), height }
            }
        })
    }

    /// Waits until this node has executed the block at a height.
    pub(super) async fn at_height(&self, height: u64) -> Result<(), Rejection> {
        if height > self.ledger.tip().height { self.current.reach_height(height).await } else { Ok(()) }
    }

    /// Can nothing be ordered through this node at the moment: no leader is known or reached, it lacks too much, or its
    /// disk is full?
    pub(crate) fn is_cut_off(&self) -> bool {
        let leader = self.seat.status().and_then(|ordering| ordering.role.leader);
        let reached = leader.is_some_and(|id| id == self.me.id || self.peers.connected(id));
        !reached || self.seat.catching_up_to().is_some() || self.space.is_full()
    }

    pub(super) fn status(&self) -> Result<StatusResponse, Rejection> {
        let tip = self.ledger.tip();
        let ordering = self.seat.status();
        let members = self.directory.members();
        let me = members.iter().find(|member| member.id == self.me.id);
        let leading = ordering.as_ref().map(|ordering| ordering.role);
        let role = match (leading.map(|change| change.role), me) {
            (Some(ledger_raft::Role::Leader), _) => "leader",
            (Some(ledger_raft::Role::Candidate), _) => "candidate",
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
        let peers = others.map(|member| PeerStatus {
            node_id: member.id,
            matched: matched(member.id),
            name: member.name.clone(),
            organisation: member.organisation.clone(),
            address: member.address.clone(),
            role: member.role().into(),
            voter: member.votes(),
            connected: self.peers.connected(member.id),
        });
        Ok(StatusResponse {
            version: env!("CARGO_PKG_VERSION").into(),
            network: self.ledger.network().0.to_vec().into(),
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
            clock: self.clock.now().max(tip.time),
            uptime_ms: u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX),
            chaincodes: self.ledger.registry().names().into_iter().map(str::to_owned).collect(),
            refused: self.denials.counts(),
            executed: self.executed.counts(),
            peers: peers.collect(),
            subscribers: self.audience.len(),
            payload_bytes_max: self.limits.payload_bytes_max,
            resident_bytes: resident_bytes(),
            first_height: self.blocks.first_height(),
            snapshot_height: self.witness.snapshot_height(),
            catching_up_to: self.seat.catching_up_to().unwrap_or_default(),
            divergence: self.witness.divergence(),
            in_flight: self.shares.in_flight() as u64,
            in_flight_max: self.limits.in_flight_max,
            waiting_control: ordering.as_ref().map_or(0, |ordering| ordering.control.transactions as u64),
            waiting_data: ordering.as_ref().map_or(0, |ordering| ordering.data.transactions as u64),
            data_directory: self.space.data().display().to_string(),
            disk_free_bytes: self.space.measured().free,
            disk_total_bytes: self.space.measured().total,
            disk_accepts: self.space.accepts().word().into(),
            certificates: self.certificates(),
            voters: u32::try_from(voters().count()).unwrap_or(u32::MAX),
            voters_connected: u32::try_from(voters().filter(|id| self.is_connected(*id)).count()).unwrap_or(u32::MAX),
        })
    }

    fn is_connected(&self, id: u64) -> bool {
        id == self.me.id || self.peers.connected(id)
    }

    /// The certificates that this node depends on. One that cannot be read is left out: then the node does not run.
    fn certificates(&self) -> Vec<CertificateStatus> {
        let status = |kind: &str, name: Option<String>, der: &[u8]| {
            let Certificate { subject, not_before, not_after, .. } = Certificate::parse(der).ok()?;
            Some(CertificateStatus { kind: kind.to_owned(), name: name.unwrap_or(subject), not_before, not_after })
        };
        let own = self.identity.own();
        let msps = self.ledger.msps();
        let msp = msps.get(&self.me.organisation);
        let authorities = msp.into_iter().flat_map(|msp| msp.roots().chain(msp.intermediates()));
        let authorities = authorities.filter_map(|der| status("ca", None, der));
        status("node", Some(self.me.full_name()), own.certificate()).into_iter().chain(authorities).collect()
    }

    pub(super) fn block(&self, caller: &Identity, height: u64) -> Result<Block, Rejection> {
        if height == 0 {
            let result = self.ledger.result(0)?.ok_or_else(|| self.no_block(0))?;
            return Ok(Block {
                hash: self.ledger.network().0.to_vec().into(),
                time: result.time,
                previous_hash: Hash::ZERO.0.to_vec().into(),
                root: self.ledger.network().0.to_vec().into(),
                state_digest: result.digest.clone(),
                kind: "genesis".into(),
                ..Block::default()
            });
        }
        let outcome = self.blocks.get(height)?.ok_or_else(|| self.no_block(height))?;
        let transactions = (0..outcome.transactions.len()).map(|index| self.record(caller, &outcome, index)).collect();
        let own = outcome.events.iter().filter(|emitted| emitted.index.is_none());
        let events = own.filter(|emitted| self.ledger.may_read(caller, &emitted.event).is_ok()).cloned();
        Ok(Block {
            height,
            term: outcome.header.term,
            time: outcome.header.time,
            previous_hash: outcome.header.previous.0.to_vec().into(),
            root: outcome.header.root.0.to_vec().into(),
            hash: outcome.hash.0.to_vec().into(),
            state_digest: outcome.digest.0.to_vec().into(),
            kind: match outcome.kind {
                BlockKind::Transactions => "transactions",
                BlockKind::Membership => "membership",
                BlockKind::Genesis => "genesis",
            }
            .into(),
            transactions,
            events: events.map(event_record).collect(),
        })
    }

    pub(super) fn transaction(&self, caller: &Identity, id: &[u8]) -> Result<TransactionRecord, Rejection> {
        let id = Hash::from_slice(id).ok_or_else(|| {
            Rejection::new(Code::BadArgument, "the id of a transaction is not usable")
                .found(format!("{} bytes", id.len()))
                .wanted("32 bytes")
        })?;
        let place = self.ledger.transaction(&id)?.ok_or_else(|| {
            Rejection::new(Code::NotFound, format!("this node has executed no transaction {id}"))
                .next("if it was submitted just now, ask again; a call that is refused before ordering has no record")
        })?;
        let outcome = self.blocks.get(place.height)?.ok_or_else(|| self.no_block(place.height))?;
        Ok(self.record(caller, &outcome, place.index as usize))
    }

    pub(super) fn denied(&self, caller: &Identity, limit: u32) -> Result<DenialsResponse, Rejection> {
        if caller.role != Role::Admin {
            return Err(Rejection::new(
                Code::NotAdmin,
                format!("{} may not see what others were refused", caller.id()),
            )
            .found(format!("role {}", caller.role))
            .wanted("role admin")
            .next(format!("ask an admin of {}", caller.organisation)));
        }
        let limit = if limit == 0 { DENIALS_DEFAULT } else { limit };
        Ok(DenialsResponse { denials: self.denials.latest(limit as usize) })
    }

    fn no_block(&self, height: u64) -> Rejection {
        Rejection::new(Code::NotFound, format!("this node has no block {height}"))
            .wanted(format!("a height from 0 to {}", self.ledger.tip().height))
    }

    /// One transaction of a block. Its bytes are only shown to those who may read all the events that it caused.
    fn record(&self, caller: &Identity, outcome: &Outcome, index: usize) -> TransactionRecord {
        let position = u32::try_from(index).unwrap_or(u32::MAX);
        let encoded = outcome.transactions.get(index).cloned().unwrap_or_default();
        let result = outcome.results.get(index).cloned().unwrap_or_default();
        let creator = ledger::transaction::Transaction::decode(encoded.clone())
            .ok()
            .and_then(|transaction| self.ledger.creator_name(&transaction.creator()));
        let caused: Vec<_> = outcome.events.iter().filter(|emitted| emitted.index == Some(position)).collect();
        let events: Vec<_> = caused
            .iter()
            .filter(|emitted| self.ledger.may_read(caller, &emitted.event).is_ok())
            .map(|emitted| event_record((*emitted).clone()))
            .collect();
        let readable = events.len() == caused.len();
        TransactionRecord {
            id: outcome.ids.get(index).map(|id| id.0.to_vec().into()).unwrap_or_default(),
            height: outcome.header.height,
            index: position,
            time: outcome.header.time,
            verdict: Some(verdict_of(&result)),
            response: result.response,
            transaction: if readable { encoded } else { Bytes::new() },
            creator: creator.unwrap_or_default(),
            events,
        }
    }
}

fn event_record(EmittedEvent { index, event }: EmittedEvent) -> EventRecord {
    let Event { chaincode, name, subject, payload } = event;
    EventRecord { chaincode, name, subject, payload, index: index.unwrap_or_default(), ..EventRecord::default() }
}

/// Resident memory of this process in bytes; 0 where the operating system does not tell.
fn resident_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok()).map_or(0, |kib| kib * 1024)
}
