//! Submission: a place in the line, admission, then the queue of the orderer, then an answer when the verdict is known.

use super::Looks;
use super::intake::Intake;
use super::looks::Look;
use crate::ordering::reads::{Known, Question};
use crate::ordering::waiters::{Answers, Client};
use futures::FutureExt;
use ledger_api::v1::{SubmitRequest, SubmitResponse};
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::Lane;
use ledger_replica::gateway::{Arrived, Desk, Job, Looked, Share, Shares};
use ledger_replica::{Answer, Waiter};
use std::future::pending;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, mpsc};
use tokio_stream::{Stream, StreamExt};
use tonic::{Status, Streaming};

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

/// Takes submissions.
pub(crate) struct Submissions {
    /// Takes them in, and carries out what is decided about them.
    pub intake: Intake,
    /// The calls that each identity has in flight.
    pub shares: Arc<Shares>,
    /// The turns to look at transactions.
    pub looks: Arc<Looks>,
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
struct Serving {
    node: Arc<Submissions>,
    share: Arc<Share>,
    answers: Answers,
    desk: Desk<Client>,
    /// The question of the desk, whether the state is current.
    question: Option<Question>,
}

impl Serving {
    async fn serve(mut self, mut requests: Requests) {
        while requests.open || !self.desk.is_empty() {
            if self.desk.next().is_none() {
                tokio::select! {
                    request = requests.next(), if requests.open => self.take_in(request),
                    known = known(&mut self.question) => self.desk.answered(known),
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
            if let Some(known) = known(&mut self.question).now_or_never() {
                self.desk.answered(known);
            }
            self.work(&mut requests).await;
        }
    }

    fn take_in(&mut self, request: Option<SubmitRequest>) {
        let Some(request) = request else { return };
        match self.node.intake.arrived(request, &self.share, &self.answers) {
            Ok(arrived) => self.desk.take_in(arrived),
            Err(answer) => drop(self.answers.send(Ok(*answer))),
        }
    }

    /// Does the next job, for as long as others allow.
    async fn work(&mut self, requests: &mut Requests) {
        let Some(job) = self.desk.next() else { return };
        self.node.intake.ordering.turns.adapt(self.desk.waiting() >= MANY_WAIT);
        // Not with a turn, as nobody else could have it meanwhile.
        let height = self.desk.min_height(job);
        if height > self.node.intake.height() {
            let current = self.node.intake.ordering.reads.clone();
            match self.meanwhile(job, requests, current.reach_told(height)).await {
                Some(Ok(())) => self.desk.reached(job),
                Some(Err(reason)) => {
                    if let Some(arrived) = self.desk.give_up(job.lane()) {
                        refuse_unordered(arrived, &reason);
                    }
                    return;
                }
                None => return,
            }
        }
        let Some(turn) = self.turn(job, requests).await else { return };
        let (intake, node) = (&self.node.intake, self.node.intake.admitting());
        self.desk.begin(job, &node, |decision| drop(intake.carry_out(decision)));
        let start = Instant::now();
        self.desk.work(job, &node, |looked| {
            if let Looked::Decided(decision) = looked {
                let _never_held_twice = intake.carry_out(decision);
            }
            start.elapsed() < SLICE
        });
        if self.desk.asks() {
            self.question = Some(self.node.intake.ordering.reads.ask());
        }
        drop(turn);
        if self.desk.next().is_some() {
            tokio::task::yield_now().await;
        }
    }

    /// Waits for a turn. None if something urgent came, which goes first.
    async fn turn(&mut self, job: Job, requests: &mut Requests) -> Option<Look> {
        if let Some(turn) = self.node.looks.try_turn(job.lane(), &self.share) {
            return Some(turn);
        }
        let (looks, share) = (Arc::clone(&self.node.looks), Arc::clone(&self.share));
        self.meanwhile(job, requests, looks.turn(job.lane(), &share)).await
    }

    /// Waits, and takes in the calls that come meanwhile. None if something urgent came, which goes first.
    async fn meanwhile<T>(&mut self, job: Job, requests: &mut Requests, what: impl Future<Output = T>) -> Option<T> {
        let mut what = pin!(what);
        let mut reads = 0;
        loop {
            let request = tokio::select! {
                biased;
                done = &mut what => return Some(done),
                request = requests.next(), if requests.open => request,
                () = self.answers.closed() => return None,
            };
            self.take_in(request);
            if job.lane() == Lane::Data && self.desk.next().is_some_and(|next| next.lane() == Lane::Control) {
                return None;
            }
            reads += 1;
            if reads % READS_MAX == 0 {
                tokio::task::yield_now().await;
            }
        }
    }
}

/// Waits for the answer to the question that is under way; for ever if there is none. Cancelling it loses nothing.
async fn known(question: &mut Option<Question>) -> Known {
    let Some(asked) = question else { return pending().await };
    let known = asked.await;
    *question = None;
    known.unwrap_or_else(|_| Err(Rejection::new(Code::ShuttingDown, "the node is stopping")))
}

/// Answers for a transaction that this node cannot look at.
fn refuse_unordered(arrived: Arrived<Client>, reason: &Rejection) {
    arrived.client.answer(&Answer::Refused { id: arrived.transaction.id(), reason });
}

impl Submissions {
    /// Submits what comes in until the client closes its side; answers until everything is answered.
    pub(super) fn stream(self: &Arc<Self>, identity: String, requests: Streaming<SubmitRequest>) -> Verdicts {
        // Unbounded in form only: each answer belongs to a request that was counted when it was read.
        let (answers, verdicts) = mpsc::unbounded_channel();
        let unread = Arc::new(Semaphore::new(UNREAD_MAX));
        let requests = Requests { requests, unread: Arc::clone(&unread), open: true };
        let (node, share) = (Arc::clone(self), self.shares.of(identity));
        tokio::spawn(Serving { node, share, answers, desk: Desk::default(), question: None }.serve(requests));
        Verdicts { verdicts, unread }
    }

    /// One transaction that does not come over a stream. It is answered now or when the verdict is known.
    pub(super) async fn one(&self, identity: String, request: SubmitRequest, answers: &Answers) {
        let share = self.shares.of(identity);
        let arrived = match self.intake.arrived(request, &share, answers) {
            Ok(arrived) => arrived,
            Err(answer) => return drop(answers.send(Ok(*answer))),
        };
        if let Err(reason) = self.intake.ordering.reads.reach_told(arrived.ticket.min_height).await {
            return refuse_unordered(arrived, &reason);
        }
        let lane = arrived.ticket.lane;
        let turn = self.looks.turn(lane, &share).await;
        let Some(item) = self.intake.carry_out(self.intake.admitting().look_alone(arrived)) else { return };
        drop(turn);
        let known = self.intake.ordering.reads.reach().await;
        let _turn = self.looks.turn(lane, &share).await;
        let _never_held_twice = self.intake.carry_out(self.intake.admitting().look_again(item, &known));
    }
}
