//! What the other nodes have.

use crate::peers::{Dialer, Member};
use futures::future::join_all;
use ledger::Hash;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::{ChainRequest, ChainResponse};
use std::time::Duration;
use tonic::transport::Channel;

/// What one node has, and the connection to it.
#[derive(Clone)]
pub(crate) struct Offer {
    /// The node.
    pub member: Member,
    /// What it says that it has.
    pub chain: ChainResponse,
    /// For further questions.
    pub channel: Channel,
}

impl Dialer {
    /// Asks all other members at the same time; those that answer in time, longest chain first.
    pub(super) async fn ask(&self, members: &[Member], network: Hash, patience: Duration) -> Vec<Offer> {
        let others = members.iter().filter(|member| member.id != self.me);
        let asked = others.map(|member| async move {
            match tokio::time::timeout(patience, self.ask_one(member)).await {
                Ok(Ok(offer)) => Some(offer),
                Ok(Err(reason)) => {
                    tracing::debug!(peer = %member.full_name(), reason, "does not say what it has");
                    None
                }
                Err(_) => None,
            }
        });
        let mut offers: Vec<_> = join_all(asked).await.into_iter().flatten().collect();
        offers.retain(|offer| offer.chain.network == network.as_ref());
        offers.sort_by_key(|offer| std::cmp::Reverse(offer.chain.height));
        offers
    }

    async fn ask_one(&self, member: &Member) -> Result<Offer, String> {
        let channel = self.channel(member).await?;
        let answer = PeerClient::new(channel.clone()).chain(ChainRequest {}).await;
        let chain = answer.map_err(|status| status.message().to_owned())?.into_inner();
        Ok(Offer { member: member.clone(), chain, channel })
    }
}
