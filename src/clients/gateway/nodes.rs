//! How all nodes of the network are: this node asks the others for a client that reaches this one alone, as a browser does.

use super::Description;
use crate::ordering::directory::Member;
use futures::future::join_all;
use ledger_api::v1::gateway_client::GatewayClient;
use ledger_api::v1::{NodeStatus, NodesResponse, StatusRequest, StatusResponse};
use ledger_base::rejection::Rejection;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::Mutex;

/// How long answers are kept, so that no client makes this node ask more often.
const KEPT_FOR: Duration = Duration::from_secs(5);
/// How long another node has to answer.
const PATIENCE: Duration = Duration::from_secs(2);
/// Most bytes of an answer.
const ANSWER_BYTES_MAX: usize = 256 * 1024;

/// Asks the other nodes how they are.
pub(crate) struct Nodes {
    description: Arc<Description>,
    /// The last answers of the others, and when they came. Others who ask meanwhile wait for the same answers.
    kept: Mutex<Option<(Instant, Vec<NodeStatus>)>>,
}

impl Nodes {
    /// Asks with the connections of this node.
    pub(crate) fn new(description: Arc<Description>) -> Self {
        Self { description, kept: Mutex::default() }
    }

    /// Every node of the network, as it describes itself.
    ///
    /// # Errors
    /// A fault of the store of this node.
    pub(super) async fn all(&self) -> Result<NodesResponse, Rejection> {
        let me = &self.description.me;
        let mut nodes = self.others().await;
        nodes.push(node(me, Ok(self.description.status()?)));
        nodes.sort_unstable_by_key(|node| node.node_id);
        Ok(NodesResponse { nodes })
    }

    async fn others(&self) -> Vec<NodeStatus> {
        let mut kept = self.kept.lock().await;
        if let Some((_, nodes)) = kept.as_ref().filter(|(since, _)| since.elapsed() < KEPT_FOR) {
            return nodes.clone();
        }
        let members = self.description.ordering.directory.members();
        let others = members.iter().filter(|member| member.id != self.description.me.id);
        let nodes = join_all(others.map(async |member| {
            let answer = tokio::time::timeout(PATIENCE, self.ask(member)).await;
            let late = |_| Err(format!("no answer within {} s", PATIENCE.as_secs()));
            node(member, answer.unwrap_or_else(late))
        }));
        let nodes = nodes.await;
        *kept = Some((Instant::now(), nodes.clone()));
        nodes
    }

    async fn ask(&self, member: &Member) -> Result<StatusResponse, String> {
        let channel = self.description.peers.dialer.channel(member).await?;
        let mut gateway = GatewayClient::new(channel).max_decoding_message_size(ANSWER_BYTES_MAX);
        let answer = gateway.status(StatusRequest {}).await.map_err(|status| status.message().to_owned())?;
        Ok(answer.into_inner())
    }
}

fn node(member: &Member, answer: Result<StatusResponse, String>) -> NodeStatus {
    let (status, unreachable) = match answer {
        Ok(status) => (Some(status), String::new()),
        Err(reason) => (None, reason),
    };
    let (name, organisation) = (member.name.clone(), member.organisation.clone());
    NodeStatus { node_id: member.id, name, organisation, status, unreachable }
}
