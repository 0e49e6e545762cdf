//! The blocks of the other nodes.

use super::receipt::from_wire;
use super::{Bootstrap, CatchUp};
use crate::clock::{Offset, wall};
use crate::peers::{Dialer, Member};
use futures::StreamExt;
use futures::future::{BoxFuture, FutureExt};
use futures::stream::FuturesUnordered;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::{ChainRequest, ChainResponse};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_replica::catch_up::{ASK_TIME_MAX, Heard, Holding, Look, Own, RECEIPTS_MAX, Stage, Who};
use ledger_replica::company::Point;
use std::time::Duration;
use tokio::time::{Instant, timeout};
use tonic::Response;
use tonic::transport::Channel;

/// The connection to a node that was asked.
#[derive(Clone)]
pub(super) struct Contact {
    pub(super) address: String,
    pub(super) channel: Channel,
}

/// The blocks of one node.
pub(super) type Offer = ledger_replica::catch_up::Offer<Contact>;

/// The answers as they come; none from who refuses, is silent, or is of another network.
pub(super) type Answers = FuturesUnordered<BoxFuture<'static, Option<Offer>>>;

/// The question of a start that some may still answer.
pub(crate) struct Open {
    answers: Answers,
    look: Look,
    asked: Instant,
}

impl CatchUp {
    /// Asks the other nodes what they have, before the first engine starts. `election_time`: this node does not stand for
    /// election for so long.
    ///
    /// # Errors
    /// If this node votes and has lost what it promised to keep.
    pub(crate) async fn look(&self, election_time: u64) -> Result<(Vec<Holding>, Open), Rejection> {
        let members = self.directory.members();
        let answers = self.question(&members);
        let voters = members.iter().filter(|member| member.votes());
        let voters = voters.map(|member| (member.id, member.organisation.clone())).collect();
        let (store, asked) = (&self.into.log.store, answers.len());
        let (term, last, key) = (store.hard_state().term, store.last_index(), self.receipts.clone());
        let own = Own { id: self.dialer.me, voters, term, last, key };
        let look = Look::new(0, own, asked, election_time, self.ballot.clone());
        let (mut open, mut offers) = (Open { answers, look, asked: Instant::now() }, Vec::new());
        while open.look.stage() == Stage::Asking {
            offers.extend(open.hear().await?);
        }
        Ok((offers, open))
    }

    /// Hears out those that were silent, until the question is closed; then the node may vote.
    pub(crate) fn hear_out(&self, mut open: Open) -> impl Future<Output = ()> + Send + use<> {
        let (fate, mut stopping) = (self.fate.clone(), self.stopping.clone());
        async move {
            while open.look.stage() != Stage::Closed {
                let heard = tokio::select! {
                    biased;
                    _ = stopping.wait_for(|stopping| *stopping) => return,
                    heard = open.hear() => heard,
                };
                if let Err(lost) = heard {
                    return fate.fail(lost);
                }
            }
        }
    }
}

impl Open {
    /// The next answer; nothing if none came in time.
    async fn hear(&mut self) -> Result<Option<Holding>, Rejection> {
        let due = self.look.due().unwrap_or_default().saturating_sub(micros(self.asked.elapsed()));
        let answer = timeout(Duration::from_micros(due), self.answers.next()).await;
        let now = micros(self.asked.elapsed());
        match answer {
            Ok(Some(Some(offer))) => {
                self.look.step(now, Heard::Answer(&offer.who, &offer.has))?;
                return Ok(Some(offer.has));
            }
            Ok(Some(None)) => self.look.step(now, Heard::Refusal)?,
            Ok(None) | Err(_) => self.look.step(now, Heard::Time)?,
        };
        Ok(None)
    }
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

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
        for member in members.iter().filter(|member| member.id != self.me) {
            let (dialer, member) = (self.clone(), member.clone());
            let answer = async move {
                match timeout(patience, dialer.ask_one(&member, network)).await {
                    Ok(Ok(offer)) => offer,
                    Ok(Err(reason)) => {
                        tracing::debug!(node = %member.full_name(), reason, "the peer does not tell what it holds");
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
pub(super) async fn all(answers: Answers) -> Vec<Offer> {
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
                    let clock = Offset::of(chain.clock, asked, since.elapsed());
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

fn who(member: &Member) -> Who {
    Who { id: member.id, organisation: member.organisation.clone(), name: member.full_name(), vouched: false }
}
