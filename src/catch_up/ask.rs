//! The blocks of the other nodes.

use super::Bootstrap;
use crate::peers::{Dialer, Member};
use futures::StreamExt;
use futures::future::{BoxFuture, FutureExt};
use futures::stream::FuturesUnordered;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::{ChainRequest, ChainResponse};
use ledger_hash::Hash;
use std::time::Duration;
use tonic::transport::Channel;

/// The blocks of one node, and the connection to it.
#[derive(Clone)]
pub(crate) struct Offer {
    /// The join token vouches for it.
    pub vouched: bool,
    /// The node.
    pub member: Member,
    /// The blocks that it says it has.
    pub chain: ChainResponse,
    /// For further questions.
    pub channel: Channel,
}

/// The answers as they come; none from who refuses, is silent, or is of another network.
pub(super) type Answers = FuturesUnordered<BoxFuture<'static, Option<Offer>>>;

impl Dialer {
    /// Asks all other members at the same time; each has so long to answer.
    /// A node that its own ledger does not know yet asks those that let it in as well.
    pub(super) fn question(
        &self,
        members: &[Member],
        bootstrap: Option<&Bootstrap>,
        network: Hash,
        patience: Duration,
    ) -> Answers {
        let answers = Answers::new();
        let ours = move |offer: &Offer| offer.chain.network == network.as_ref();
        for member in members.iter().filter(|member| member.id != self.me) {
            let (dialer, member) = (self.clone(), member.clone());
            let answer = async move {
                match tokio::time::timeout(patience, dialer.ask_one(&member)).await {
                    Ok(Ok(offer)) => Some(offer).filter(ours),
                    Ok(Err(reason)) => {
                        tracing::debug!(peer = %member.full_name(), reason, "the peer does not tell what it holds");
                        None
                    }
                    Err(_) => None,
                }
            };
            answers.push(answer.boxed());
        }
        for (address, ca) in
            bootstrap.iter().flat_map(|known| known.addresses.iter().map(|address| (address, known.ca)))
        {
            let (dialer, address) = (self.clone(), address.clone());
            let answer = async move {
                let answer = tokio::time::timeout(patience, dialer.ask_first(&address, ca)).await;
                answer.ok()?.ok().filter(ours)
            };
            answers.push(answer.boxed());
        }
        answers
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

/// All answers, longest chain first.
pub(super) async fn all(answers: Answers) -> Vec<Offer> {
    let mut offers: Vec<Offer> = answers.filter_map(|answer| async move { answer }).collect().await;
    longest_first(&mut offers);
    offers
}

pub(super) fn longest_first(offers: &mut [Offer]) {
    offers.sort_by_key(|offer| std::cmp::Reverse(offer.chain.height));
}

async fn chain(channel: Channel) -> Result<ChainResponse, String> {
    let answer = PeerClient::new(channel).chain(ChainRequest {}).await;
    Ok(answer.map_err(|status| status.message().to_owned())?.into_inner())
}
