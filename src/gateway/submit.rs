//! Submission: a place in the line, admission, then the queue of the orderer, then an answer when the verdict is known.

use super::current::Known;
use super::held::{Held, Item};
use super::line::{Arrived, Line, Ticket, overloaded};
use super::share::{Share, Turn};
use super::{GatewayService, NodeView};
use crate::waiters::{Client, executed, refused};
use futures::FutureExt;
use ledger::transaction::Transaction;
use ledger::{Ground, Refusal};
use ledger_api::v1::{SubmitRequest, SubmitResponse};
use ledger_raft::{Input, Lane};
use ledger_rejection::{Code, Rejection};
use ledger_replica::Executed;
use ledger_replica::admission::{Admitting, Decision, answer_to};
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, mpsc};
use tokio_stream::{Stream, StreamExt};
use tonic::{Status, Streaming};

/// Signatures that are checked together in one turn.
const TOGETHER_MAX: usize = 16;
/// Longest time that one stream looks at transactions while others wait for their turn, after their signatures were checked
/// together.
const SLICE: Duration = Duration::from_micros(200);
/// Requests taken in between two looks at what waits. Taking in costs a fiftieth of looking: enough that a flood is
/// refused while it comes, and not so much that nothing else is done.
const READS_MAX: usize = 64;
/// Requests of a stream that were taken in and whose answers the client has not read. A client that reads no answers is
/// not read from any more.
const UNREAD_MAX: usize = 16_384;

/// Transactions in a line when there is much to do.
const MANY_WAIT: usize = 8;

type Answers = mpsc::UnboundedSender<Result<SubmitResponse, Status>>;

/// Submits what comes in until the client closes its side; answers until everything is answered.
pub(super) fn stream(gateway: GatewayService, share: Arc<Share>, requests: Streaming<SubmitRequest>) -> Verdicts {
    // Unbounded in form only: each answer belongs to a request that was counted when it was read.
    let (answers, verdicts) = mpsc::unbounded_channel();
    let unread = Arc::new(Semaphore::new(UNREAD_MAX));
    let requests = Requests { requests, unread: Arc::clone(&unread), open: true };
    let desk = Desk { node: gateway.node, share, answers, line: Line::default(), held: Held::default() };
    tokio::spawn(desk.serve(requests));
    Verdicts { verdicts, unread }
}

/// The answers of a stream.
pub(crate) struct Verdicts {
    verdicts: mpsc::UnboundedReceiver<Result<SubmitResponse, Status>>,
    unread: Arc<Semaphore>,
}

impl Stream for Verdicts {
    type Item = Result<SubmitResponse, Status>;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let verdict = self.verdicts.poll_recv(cx);
        if let Poll::Ready(Some(_)) = verdict {
            self.unread.add_permits(1);
        }
        verdict
    }
}

/// The requests of a stream.
struct Requests {
    requests: Streaming<SubmitRequest>,
    unread: Arc<Semaphore>,
    /// The client may send more.
    open: bool,
}

impl Requests {
    /// The next one; none once the client has closed its side, or the connection broke. Cancelling it loses nothing.
    async fn next(&mut self) -> Option<SubmitRequest> {
        let counted = self.unread.acquire().await.ok()?;
        match self.requests.next().await {
            Some(Ok(request)) => {
                counted.forget();
                Some(request)
            }
            _ => {
                self.open = false;
                None
            }
        }
    }
}

/// Serves one stream.
struct Desk {
    node: Arc<NodeView>,
    share: Arc<Share>,
    answers: Answers,
    line: Line,
    /// Calls that the state refuses, until it is known whether the state is current.
    held: Held,
}

impl Desk {
    async fn serve(mut self, mut requests: Requests) {
        while requests.open || self.line.next().is_some() || !self.held.is_empty() {
            if self.line.next().is_none() && self.held.due().is_none() {
                tokio::select! {
                    request = requests.next(), if requests.open => self.take_in(request),
                    () = self.held.answered(), if !self.held.is_empty() => {}
                    () = self.answers.closed() => return,
                }
            }
            if self.answers.is_closed() {
                return;
            }
            // What else has come: what is urgent among it goes first.
            for _ in 0..READS_MAX {
                match requests.next().now_or_never() {
                    Some(request) if requests.open => self.take_in(request),
                    _ => break,
                }
            }
            let _not_yet = self.held.answered().now_or_never();
            self.decide(&mut requests).await;
            self.look(&mut requests).await;
        }
    }

    fn take_in(&mut self, request: Option<SubmitRequest>) {
        let Some(request) = request else { return };
        match self.node.arrived(request, &self.share) {
            Ok(arrived) => self.line.push(arrived),
            Err(answer) => drop(self.answers.send(Ok(*answer))),
        }
    }

    /// Decides on what was held, now that the state is current; for as long as others allow.
    async fn decide(&mut self, requests: &mut Requests) {
        let Some(lane) = self.held.due() else { return };
        let Some(turn) = self.turn(lane, requests).await else { return };
        let start = Instant::now();
        while let Some((item, known)) = self.held.take(lane, || self.node.current.ask()) {
            self.node.submit_again(item, &known, &self.answers);
            if self.held.due() != Some(lane) || start.elapsed() >= SLICE {
                break;
            }
        }
        drop(turn);
        if self.held.due().is_some() {
            tokio::task::yield_now().await;
        }
    }

    /// Looks at what waits, for as long as others allow.
    async fn look(&mut self, requests: &mut Requests) {
        let Some(lane) = self.line.next() else { return };
        self.node.turns.adapt(self.line.len() >= MANY_WAIT);
        // Not with a turn, as nobody else could have it meanwhile.
        if let Some(height) = self.line.min_height(lane)
            && let Err(reason) = self.node.at_height(height).await
        {
            if let Some(arrived) = self.line.take(lane) {
                self.node.refuse_unordered(&arrived, &reason, &self.answers);
            }
            return;
        }
        let Some(turn) = self.turn(lane, requests).await else { return };
        let (now, height) = (Instant::now(), self.node.ledger.tip().height);
        if lane == Lane::Data {
            for (arrived, reason) in self.line.take_late(now, self.node.wait_max) {
                self.node.refuse_overloaded(&arrived, reason, &self.answers);
            }
        }
        self.node.ledger.verify_together(self.line.first(lane, TOGETHER_MAX), self.node.clock.now());
        let start = Instant::now();
        while self.line.min_height(lane).is_some_and(|wanted| wanted <= height)
            && let Some(arrived) = self.line.take(lane)
        {
            let left = match self.held.holds_back(&arrived) {
                true => Some(Item { arrived, refusal: None }),
                false => self.node.submit(arrived, &self.answers),
            };
            if let Some(item) = left {
                self.held.push(item, || self.node.current.ask());
            }
            if start.elapsed() >= SLICE {
                break;
            }
        }
        drop(turn);
        if self.line.next().is_some() {
            tokio::task::yield_now().await;
        }
    }

    /// Waits for a turn, and takes in what comes meanwhile. None if something urgent came, which goes first.
    async fn turn(&mut self, lane: Lane, requests: &mut Requests) -> Option<Turn> {
        if let Some(turn) = self.share.try_turn(lane) {
            return Some(turn);
        }
        let share = Arc::clone(&self.share);
        let mut turn = pin!(share.turn(lane));
        let mut reads = 0;
        loop {
            let request = tokio::select! {
                biased;
                turn = &mut turn => return turn,
                request = requests.next(), if requests.open => request,
            };
            self.take_in(request);
            if lane == Lane::Data && self.line.next() == Some(Lane::Control) {
                return None;
            }
            reads += 1;
            if reads % READS_MAX == 0 {
                tokio::task::yield_now().await;
            }
        }
    }
}

impl NodeView {
    /// One transaction that does not come over a stream. It is answered now or when the verdict is known.
    pub(super) async fn submit_one(&self, request: SubmitRequest, share: &Arc<Share>, answers: &Answers) {
        let arrived = match self.arrived(request, share) {
            Ok(arrived) => arrived,
            Err(answer) => return drop(answers.send(Ok(*answer))),
        };
        if let Err(reason) = self.at_height(arrived.ticket.min_height).await {
            return self.refuse_unordered(&arrived, &reason, answers);
        }
        let Some(turn) = share.turn(arrived.ticket.lane).await else { return };
        let waited = arrived.ticket.since.elapsed();
        if arrived.ticket.lane == Lane::Data && waited > self.wait_max {
            let reason = overloaded(true, waited, (1, waited), self.wait_max);
            return self.refuse_overloaded(&arrived, reason, answers);
        }
        let Some(item) = self.submit(arrived, answers) else { return };
        drop(turn);
        let known = self.current.reach().await;
        let Some(_turn) = share.turn(item.arrived.ticket.lane).await else { return };
        self.submit_again(item, &known, answers);
    }

    /// Takes a request in: what can be refused without looking closer is refused here.
    fn arrived(&self, request: SubmitRequest, share: &Arc<Share>) -> Result<Arrived, Box<SubmitResponse>> {
        let SubmitRequest { transaction: encoded, min_height, first_attempt } = request;
        // Not even looked at, but named: by the id a client on a stream knows which of its transactions is meant.
        let unread = |rejection| {
            let transaction = Transaction::decode(encoded.clone()).ok();
            let refusal = Refusal::of_node(None, transaction, rejection);
            self.refuse(first_attempt, &refusal)
        };
        let limit = self.limits.payload_bytes_max;
        if encoded.len() as u64 > limit {
            let rejection = Rejection::new(Code::TooLarge, "transaction is larger than this node accepts")
                .found(format!("{} bytes", encoded.len()))
                .wanted(format!("at most {limit} bytes (limits.payload_bytes_max)"))
                .next("send less at once, or raise the limit in the node's configuration");
            return Err(unread(rejection));
        }
        let transaction = Transaction::decode(encoded)
            .map_err(|rejection| Refusal { who: None, transaction: None, rejection, ground: Ground::Bytes })
            .map_err(|refusal| self.refuse(first_attempt, &refusal))?;
        let body = transaction.body();
        let chaincode = self.ledger.registry().find(&body.chaincode).ok();
        if let Err(rejection) = self.space.check(|| chaincode.is_some_and(|called| called.ends(&body.function))) {
            return Err(self.refuse(first_attempt, &Refusal::of_node(None, Some(transaction), rejection)));
        }
        let urgent = chaincode.is_some_and(|called| called.urgent(&body.function));
        let lane = if urgent { Lane::Control } else { Lane::Data };
        match share.place(lane, transaction.encoded().len()) {
            Ok(place) => {
                let ticket = Ticket { min_height, first_attempt, lane, since: Instant::now(), place };
                Ok(Arrived { transaction, ticket })
            }
            Err(rejection) => {
                let who = Some(share.name().to_owned());
                Err(self.refuse(first_attempt, &Refusal::of_node(who, Some(transaction), rejection)))
            }
        }
    }

    /// Admits a transaction and hands it to the orderer. Everything that can be refused before ordering is refused
    /// here; the answer may also be an earlier verdict. A call that the state refuses is given back as long as it is
    /// not known whether the state is current.
    fn submit(&self, arrived: Arrived, answers: &Answers) -> Option<Item> {
        let Arrived { transaction, ticket } = arrived;
        let decision = self.admitting(&ticket).look(transaction);
        self.carry_out(decision, ticket, None, answers)
    }

    /// As [`NodeView::submit`], for one that was held until it is known whether the state is current.
    fn submit_again(&self, item: Item, known: &Known, answers: &Answers) {
        let Item { arrived, refusal } = item;
        let Arrived { transaction, ticket } = arrived;
        let decision = self.admitting(&ticket).look_again(transaction, refusal, known);
        let _never_held_twice = self.carry_out(decision, ticket, Some(known), answers);
    }

    fn admitting<'a>(&'a self, ticket: &'a Ticket) -> Admitting<'a, Client> {
        Admitting {
            ledger: &self.ledger,
            waiters: &self.waiters,
            retries: &self.retries,
            clock: self.clock.now(),
            who: ticket.place.name(),
            first_attempt: ticket.first_attempt,
        }
    }

    /// Does what was decided. `reached` is what became of the question whether the state is current, if it was asked.
    fn carry_out(
        &self,
        decision: Decision,
        ticket: Ticket,
        reached: Option<&Known>,
        answers: &Answers,
    ) -> Option<Item> {
        let (lane, since) = (ticket.lane, ticket.since);
        match decision {
            Decision::Order { transaction, again } => {
                let (arrived, waited) = (Arrived { transaction, ticket }, since.elapsed());
                if !again && reached.is_some() && lane == Lane::Data && waited > self.wait_max * 2 {
                    let reason = overloaded(true, waited, (1, waited), self.wait_max);
                    self.refuse_overloaded(&arrived, reason, answers);
                } else {
                    self.order(arrived, answers);
                }
            }
            Decision::Known(id, record) => drop(answers.send(Ok(executed(&Executed::recorded(id, &record))))),
            Decision::Hold(transaction, refusal) => {
                return Some(Item { arrived: Arrived { transaction, ticket }, refusal: Some(refusal) });
            }
            Decision::Refuse { refusal, reason } => {
                self.denials.record(self.clock.now(), &refusal);
                let id = refusal.transaction.as_ref().map(Transaction::id);
                let _gone = answers.send(Ok(refused(id.as_ref(), &reason)));
            }
        }
        None
    }

    /// Hands a transaction to the orderer. It is answered when it has a verdict.
    fn order(&self, arrived: Arrived, answers: &Answers) {
        self.awake.keep();
        let Arrived { transaction, ticket: Ticket { lane, place, .. } } = arrived;
        let client = Client { answers: answers.clone(), place };
        self.waiters.add(self.clock.elapsed(), &transaction, lane, client);
        let input = Input::Submit { lane, transaction: transaction.encoded().clone() };
        if let Err(rejection) = self.seat.input(input) {
            let who = self.waiters.refuse(&transaction.id(), &rejection);
            self.denials.record(self.clock.now(), &Refusal::of_node(who, Some(transaction), rejection));
        }
    }

    /// Answers for a transaction that this node cannot look at.
    fn refuse_unordered(&self, arrived: &Arrived, reason: &Rejection, answers: &Answers) {
        let _gone = answers.send(Ok(refused(Some(&arrived.transaction.id()), reason)));
    }

    fn refuse_overloaded(&self, arrived: &Arrived, rejection: Rejection, answers: &Answers) {
        let (who, transaction) = (Some(arrived.ticket.place.name().to_owned()), Some(arrived.transaction.clone()));
        let refusal = Refusal::of_node(who, transaction, rejection);
        let _gone = answers.send(Ok(*self.refuse(arrived.ticket.first_attempt, &refusal)));
    }

    /// Counts a refusal; the answer to it.
    fn refuse(&self, first_attempt: bool, refusal: &Refusal) -> Box<SubmitResponse> {
        self.denials.record(self.clock.now(), refusal);
        let reason = answer_to(refusal, first_attempt);
        Box::new(refused(refusal.transaction.as_ref().map(Transaction::id).as_ref(), &reason))
    }
}
