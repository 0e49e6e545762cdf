//! Asks other nodes what they have.

use super::receipt::from_wire;
use crate::ordering::directory::Member;
use crate::peers::connections::Dialer;
use crate::process::clock::wall;
use futures::StreamExt;
use futures::future::{BoxFuture, FutureExt};
use futures::stream::FuturesUnordered;
use ledger::branch::CertifiedBranch;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::{CertifiedRequest, ChainRequest, ChainResponse};
use ledger_base::hash::Hash;
use ledger_replica::catch_up::{ASK_TIME_MAX, Holding, RECEIPTS_MAX, SILENCE_MAX, Who};
use ledger_replica::company::Point;
use ledger_replica::offsets::Offset;
use std::time::Duration;
use tokio::time::{Instant, timeout};
use tonic::Response;
use tonic::transport::Channel;

/// The connection to a node that was asked.
#[derive(Clone)]
pub(crate) struct Contact {
    pub(crate) address: String,
    pub(crate) channel: Channel,
}

/// The blocks of one node.
pub(crate) type Offer = ledger_replica::catch_up::Offer<Contact>;

/// The answers as they come; none from who refuses, is silent, or is of another network.
pub(crate) type Answers = FuturesUnordered<BoxFuture<'static, Option<Offer>>>;

/// The nodes that let this node in, for as long as its ledger does not know it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Bootstrap {
    /// `HOST:PORT` of nodes.
    pub addresses: Vec<String>,
    /// SHA-256 of the CA certificate behind them.
    pub ca: Hash,
}

impl Dialer {
    /// Asks all other members at the same time; each has so long to answer.
    /// A node that its own ledger does not know yet asks those that let it in as well.
    pub(crate) fn question(
        &self,
        members: &[Member],
        bootstrap: Option<&Bootstrap>,
        network: Hash,
        patience: Duration,
    ) -> Answers {
        let answers = Answers::new();
        for member in members.iter().filter(|member| member.id != self.me) {
            let (dialer, member) = (self.clone(), member.clone());
            let answer = async move {
                match timeout(patience, dialer.ask_one(&member, network)).await {
                    Ok(Ok(offer)) => offer,
                    Ok(Err(reason)) => {
                        tracing::debug!(node = %member.full_name(), reason, "peer does not report its log");
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
                let answer = timeout(patience, dialer.ask_first(&address, ca, network)).await;
                answer.ok()?.ok().flatten()
            };
            answers.push(answer.boxed());
        }
        answers
    }

    async fn ask_one(&self, member: &Member, network: Hash) -> Result<Option<Offer>, String> {
        offer(who(member), Contact { address: member.address.clone(), channel: self.channel(member).await? }, network)
            .await
    }

    async fn ask_first(&self, address: &str, ca: Hash, network: Hash) -> Result<Option<Offer>, String> {
        let channel = self.first_contact(address, ca).await?;
        let who = Who { id: 0, organisation: String::new(), name: address.to_owned(), vouched: true };
        offer(who, Contact { address: address.to_owned(), channel }, network).await
    }
}

/// All answers.
pub(crate) async fn all(answers: Answers) -> Vec<Offer> {
    answers.filter_map(|answer| async move { answer }).collect().await
}

/// The blocks of a node; none if it is of another network.
async fn offer(who: Who, peer: Contact, network: Hash) -> Result<Option<Offer>, String> {
    let chain = chain(&peer.channel, ChainRequest::default()).await?;
    Ok((chain.network == network.as_ref()).then_some(Offer { who, has: holding(&chain), peer }))
}

async fn chain(channel: &Channel, request: ChainRequest) -> Result<ChainResponse, String> {
    let answer = PeerClient::new(channel.clone()).chain(request).await;
    answer.map(Response::into_inner).map_err(|status| status.message().to_owned())
}

fn holding(chain: &ChainResponse) -> Holding {
    Holding {
        height: chain.height,
        durable: chain.durable,
        first_height: chain.first_height,
        snapshot_height: chain.snapshot_height,
        yours: chain.yours,
        receipts: chain.receipts.iter().take(RECEIPTS_MAX).map(from_wire).collect(),
        you_vote: chain.you_vote,
        receipt: chain.receipt.as_ref().map(from_wire),
    }
}

/// A node's answer about its chain, at a height that both have.
pub(crate) struct Asked {
    /// The node that says so.
    pub who: Who,
    /// Its blocks.
    pub has: Holding,
    /// Its chain at the height that was asked for, or lower.
    pub at: Option<Point>,
    /// It does not know the asking node as a member.
    pub stranger: bool,
    /// The clock of its machine.
    pub clock: Option<Offset>,
}

impl Dialer {
    /// Tells these members what this node has, and asks what they have there. Nodes that are silent or of another
    /// network are left out.
    pub(crate) async fn compare(&self, members: &[Member], network: Hash, own: Option<Point>) -> Vec<Asked> {
        let mut request = ChainRequest::default();
        if let Some(Point { height, hash, digest }) = own {
            request = ChainRequest { height, block_hash: hash.0.to_vec().into(), digest: digest.0.to_vec().into() };
        }
        let asked = members.iter().filter(|member| member.id != self.me).map(|member| {
            let request = request.clone();
            async move {
                let answer = async {
                    let channel = self.channel(member).await?;
                    let (since, asked) = (Instant::now(), wall());
                    let chain = chain(&channel, request).await?;
                    let clock =
                        Offset::of(chain.clock, asked, u64::try_from(since.elapsed().as_micros()).unwrap_or(u64::MAX));
                    Ok::<_, String>((chain, clock))
                };
                let answer = timeout(Duration::from_micros(ASK_TIME_MAX), answer).await;
                let (chain, clock) = answer.ok()?.ok().filter(|(chain, _)| chain.network == network.as_ref())?;
                let (hash, digest) = (Hash::from_slice(&chain.block_hash), Hash::from_slice(&chain.digest));
                let at = hash.zip(digest).map(|(hash, digest)| Point { height: chain.compared_height, hash, digest });
                Some(Asked { who: who(member), has: holding(&chain), at, stranger: chain.stranger, clock })
            }
        });
        asked.collect::<FuturesUnordered<_>>().filter_map(|answer| async move { answer }).collect().await
    }
}

impl Dialer {
    /// The certified part of a member's chain from a height on; none if it has none, or does not answer.
    pub(crate) async fn certified(&self, member: &Member, height: u64) -> Option<CertifiedBranch> {
        let answer = async { certified(&self.channel(member).await?, height).await };
        let shown =
            timeout(Duration::from_micros(ASK_TIME_MAX), answer).await.unwrap_or_else(|_| Err("no answer".to_owned()));
        shown
            .inspect_err(|reason| {
                tracing::debug!(node = %member.full_name(), reason, "peer does not send a certificate of its chain");
            })
            .ok()
    }
}

/// The certified part of the chain of a node from a height on. No signature is checked.
///
/// # Errors
/// The reason why it shows none.
pub(crate) async fn certified(channel: &Channel, height: u64) -> Result<CertifiedBranch, String> {
    let mut client = PeerClient::new(channel.clone());
    let asked = client.certified(CertifiedRequest { height });
    let answer = timeout(Duration::from_micros(SILENCE_MAX), asked).await.map_err(|_| "no answer".to_owned())?;
    let branch = answer.map_err(|status| status.message().to_owned())?.into_inner().branch;
    let branch = match branch.is_empty() {
        true => Err("it has no certificate".to_owned()),
        false => CertifiedBranch::from_bytes(&branch).map_err(|refused| refused.to_string()),
    };
    branch.and_then(|branch| match branch.height() == height {
        true => Ok(branch),
        false => Err(format!("it sent block {}, not {height}", branch.height())),
    })
}

fn who(member: &Member) -> Who {
    Who { id: member.id, organisation: member.organisation.clone(), name: member.full_name(), vouched: false }
}
