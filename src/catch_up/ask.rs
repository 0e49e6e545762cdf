//! What the other nodes have.

use super::Bootstrap;
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
    /// The join token vouches for it.
    pub vouched: bool,
    /// The node.
    pub member: Member,
    /// What it says that it has.
    pub chain: ChainResponse,
    /// For further questions.
    pub channel: Channel,
}

impl Dialer {
    /// Asks all other members at the same time; those that answer in time, longest chain first.
    /// A node that its own ledger does not know yet asks those that let it in as well.
    pub(super) async fn ask(
        &self,
        members: &[Member],
        bootstrap: Option<&Bootstrap>,
        network: Hash,
        patience: Duration,
    ) -> Vec<Offer> {
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
        let first_contacts = bootstrap.iter().flat_map(|known| &known.addresses).map(|address| async move {
            let ca = bootstrap.map(|known| known.ca)?;
            tokio::time::timeout(patience, self.ask_first(address, ca)).await.ok()?.ok()
        });
        let (members, first) = tokio::join!(join_all(asked), join_all(first_contacts));
        let mut offers: Vec<_> = members.into_iter().chain(first).flatten().collect();
        offers.retain(|offer| offer.chain.network == network.as_ref());
        offers.sort_by_key(|offer| std::cmp::Reverse(offer.chain.height));
        offers
    }

    async fn ask_one(&self, member: &Member) -> Result<Offer, String> {
        let channel = self.channel(member).await?;
        let chain = chain(channel.clone()).await?;
        Ok(Offer { vouched: false, member: member.clone(), chain, channel })
    }

    async fn ask_first(&self, address: &str, ca: Hash) -> Result<Offer, String> {
        let channel = self.first_contact(address, ca).await?;
        let chain = chain(channel.clone()).await?;
        let name = address.to_owned();
        let member = Member {
            id: 0,
            name,
            organisation: String::new(),
            address: address.to_owned(),
            wanted: None,
            actual: None,
        };
        Ok(Offer { vouched: true, member, chain, channel })
    }
}

async fn chain(channel: Channel) -> Result<ChainResponse, String> {
    let answer = PeerClient::new(channel).chain(ChainRequest {}).await;
    Ok(answer.map_err(|status| status.message().to_owned())?.into_inner())
}
