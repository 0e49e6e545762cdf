//! Interfaces for clients: the gRPC gateway, the HTTP API, the console, and the pages for monitoring.
//!
//! | module | content |
//! |---|---|
//! | `gateway` | the gRPC API |
//! | `http` | its calls as JSON over HTTP |
//! | `audit` | an index of who did what |
//! | `rejections`, `rejection_reports` | rejected calls; reporting them to the ledger |
//! | `attention` | what needs attention at this node: the one list that all of them show |
//! | `monitoring`, `health` | readiness and metrics over HTTP; health over gRPC |
//! | `console` | the console for browsers |

pub(crate) mod attention;
pub(crate) mod audit;
pub(crate) mod console;
pub(crate) mod gateway;
pub(crate) mod health;
pub(crate) mod http;
pub(crate) mod monitoring;
pub(crate) mod rejection_reports;
pub(crate) mod rejections;

use crate::ordering::Ordering;
use crate::ordering::node_transactions::Author;
use crate::peers::Peers;
use crate::process::config::{Config, count};
use crate::trust::Trust;
use attention::CaKeys;
use audit::Audit;
use gateway::{
    Answers, Audience, Description, GatewayService, Intake, Looks, Nodes, Proofs, Questions, Records, Submissions,
    Subscriptions,
};
use ledger_base::invariant::vital_task;
use ledger_base::rejection::Rejection;
use ledger_replica::Retries;
use ledger_replica::gateway::Shares;
use ledger_traces::Tracer;
use rejection_reports::Reporting;
use rejections::Rejections;
use std::sync::{Arc, OnceLock};
use std::time::Instant;
use tokio::task::JoinHandle;

/// Interfaces of a node for its clients.
pub(crate) struct Clients {
    /// The gRPC API.
    pub gateway: GatewayService,
    /// Rejected calls.
    pub rejections: Arc<Rejections>,
    /// The index of who did what.
    audit: Arc<Audit>,
    /// The calls that each identity has in flight.
    shares: Arc<Shares>,
}

impl Clients {
    /// Of a node that started at this moment. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// If the index of the audit cannot be opened.
    pub(crate) fn new(
        config: &Config,
        ordering: &Arc<Ordering>,
        trust: &Trust,
        peers: &Arc<Peers>,
        (tracer, started): (Tracer, Instant),
    ) -> Result<Self, Rejection> {
        let (ordering, peers) = (|| Arc::clone(ordering), || Arc::clone(peers));
        let workers = tokio::runtime::Handle::current().metrics().num_workers();
        let shares = Arc::new(Shares::new(count(config.limits.in_flight_max)));
        let rejections: Arc<Rejections> = Arc::default();
        let audience = Audience::new(config.limits.subscribers_max, trust.me.organisation.clone());
        let audit = Audit::open(&ordering().storage)?;
        let questions = Questions::new(workers, &shares);
        let description = Arc::new(Description {
            me: trust.me.clone(),
            identity: trust.identity.clone(),
            started,
            ordering: ordering(),
            peers: peers(),
            shares: Arc::clone(&shares),
            audience: Arc::clone(&audience),
            rejections: Arc::clone(&rejections),
            limits: config.limits.clone(),
            ca_keys: CaKeys::default(),
            is_trial: config.is_trial,
            console: OnceLock::new(),
        });
        let intake = Intake {
            ordering: ordering(),
            peers: peers(),
            rejections: Arc::clone(&rejections),
            retries: Retries::default(),
            payload_bytes_max: config.limits.payload_bytes_max,
            wait_max: config.order.timing().data_wait,
            tracer,
        };
        let subscriptions = Subscriptions {
            ordering: ordering(),
            peers: peers(),
            audience,
            rejections: Arc::clone(&rejections),
            questions: questions.clone(),
        };
        let gateway = GatewayService {
            submissions: Arc::new(Submissions { intake, shares: Arc::clone(&shares), looks: Looks::new(workers) }),
            records: Arc::new(Records { ordering: ordering(), peers: peers(), questions: questions.clone() }),
            proofs: Arc::new(Proofs { ordering: ordering(), peers: peers(), questions: questions.clone() }),
            subscriptions: Arc::new(subscriptions),
            nodes: Arc::new(Nodes::new(Arc::clone(&description))),
            audit: Arc::new(Answers { audit: Arc::clone(&audit), ordering: ordering(), questions }),
            description,
        };
        Ok(Self { gateway, rejections, audit, shares })
    }

    /// Starts what runs beside the calls: the index of the audit, and reports of rejections.
    pub(crate) fn start(&self, author: &Arc<Author>) -> [JoinHandle<()>; 2] {
        let reporting = Reporting {
            author: Arc::clone(author),
            rejections: Arc::clone(&self.rejections),
            ordering: Arc::clone(&self.gateway.description.ordering),
        };
        [tokio::spawn(vital_task(reporting.run())), tokio::spawn(vital_task(Arc::clone(&self.audit).keep()))]
    }

    /// Where the steps of messages are told.
    pub(crate) fn tracer(&self) -> Tracer {
        self.gateway.submissions.intake.tracer.clone()
    }

    /// No new calls.
    pub(crate) fn close(&self) {
        self.shares.close();
    }
}

#[cfg(test)]
mod tests;
