//! Is this node's state as new as what was committed when somebody asked? Only then may it refuse because of its state.
//!
//! The leader knows, and a majority must confirm that it leads ([`Reads`]). One question serves everybody who waits when it
//! is asked; whoever comes while it is under way waits for the next one, as an answer may be older than they are. So a flood
//! of refusals costs the leader one question at a time.

use crate::blocks::Blocks;
use crate::orderer::{Reads, Seat};
use futures::FutureExt;
use futures::future::BoxFuture;
use ledger_rejection::{Code, Rejection};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::{Instant, sleep_until, timeout};

/// Longest time that somebody waits for a height that this node has not executed.
const WAIT_FOR_HEIGHT: Duration = Duration::from_secs(2);
/// From one question to the next while more and more ask. The first after a quiet moment is asked at once.
const BETWEEN_QUESTIONS: Duration = Duration::from_millis(1);

/// The height that the state has reached at least, and that was committed when the question was asked; or why that cannot
/// be told now.
pub(crate) type Known = Result<u64, Rejection>;
/// Becomes known.
pub(crate) type Question = oneshot::Receiver<Known>;

/// What makes a node's state current; cheap to clone.
#[derive(Clone)]
pub(crate) struct Current {
    blocks: Arc<Blocks>,
    questions: Arc<Questions>,
}

/// One question after the other, for as long as somebody waits.
struct Questions {
    ask: Box<dyn Fn() -> BoxFuture<'static, Known> + Send + Sync>,
    asking: Mutex<Asking>,
}

#[derive(Default)]
struct Asking {
    /// A question is under way, or about to be asked.
    busy: bool,
    /// Those whom the next one serves.
    waiting: Vec<oneshot::Sender<Known>>,
}

impl Current {
    /// Of a node that finds its leader here, and its blocks there.
    pub(crate) fn new(reads: Arc<Reads>, seat: Arc<Seat>, blocks: Arc<Blocks>) -> Self {
        let executed = Arc::clone(&blocks);
        let questions = Questions::new(move || {
            let (reads, seat, blocks) = (Arc::clone(&reads), Arc::clone(&seat), Arc::clone(&executed));
            async move {
                let height = reads.confirmed_height(&seat).await?;
                reach(&blocks, height).await?;
                Ok(height)
            }
        });
        Self { blocks, questions: Arc::new(questions) }
    }

    /// Waits until this node has executed everything that was committed when this was called, by whichever node.
    ///
    /// # Errors
    /// [`Code::NoLeader`] if no leader confirms in time that it leads; [`Code::Behind`] if this node is further behind than
    /// can be waited for. Then nobody knows whether the state is current.
    pub(crate) async fn reach(&self) -> Known {
        self.ask().await.unwrap_or_else(|_| Err(Rejection::new(Code::ShuttingDown, "the node is stopping")))
    }

    /// As [`Current::reach`], for who does something else meanwhile. What counts is the moment of this call.
    pub(crate) fn ask(&self) -> Question {
        Questions::ask(&self.questions)
    }

    /// Waits until this node has executed the block at a height.
    ///
    /// # Errors
    /// [`Code::Behind`] if it does not in time, [`Code::ShuttingDown`].
    pub(crate) async fn reach_height(&self, height: u64) -> Result<(), Rejection> {
        reach(&self.blocks, height).await
    }
}

impl Questions {
    /// Each is asked so.
    fn new<F: Future<Output = Known> + Send + 'static>(ask: impl Fn() -> F + Send + Sync + 'static) -> Self {
        Self { ask: Box::new(move || ask().boxed()), asking: Mutex::default() }
    }

    fn ask(this: &Arc<Self>) -> Question {
        let (sender, known) = oneshot::channel();
        let begin = {
            let mut asking = this.asking();
            asking.waiting.push(sender);
            !std::mem::replace(&mut asking.busy, true)
        };
        if begin {
            tokio::spawn(Arc::clone(this).run());
        }
        known
    }

    async fn run(self: Arc<Self>) {
        loop {
            let next = Instant::now() + BETWEEN_QUESTIONS;
            let waiting = {
                let mut asking = self.asking();
                // Who has gone away needs no answer.
                asking.waiting.retain(|waiter| !waiter.is_closed());
                asking.busy = !asking.waiting.is_empty();
                std::mem::take(&mut asking.waiting)
            };
            if waiting.is_empty() {
                return;
            }
            let known = (self.ask)().await;
            for waiter in waiting {
                let _gone = waiter.send(known.clone());
            }
            if !self.asking().waiting.is_empty() {
                sleep_until(next).await;
            }
        }
    }

    fn asking(&self) -> MutexGuard<'_, Asking> {
        self.asking.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

async fn reach(blocks: &Blocks, height: u64) -> Result<(), Rejection> {
    let mut head = blocks.head();
    match timeout(WAIT_FOR_HEIGHT, head.wait_for(|reached| *reached >= height)).await {
        Ok(Ok(_)) => Ok(()),
        Ok(Err(_)) => Err(Rejection::new(Code::ShuttingDown, "the node is stopping")),
        Err(_) => Err(Rejection::new(Code::Behind, "this node has not reached the height that was asked for")
            .found(format!("height {}", blocks.height()))
            .wanted(format!("height {height}"))
            .next("ask again, or ask another node")),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use tokio::sync::mpsc;

    type Asked = mpsc::UnboundedReceiver<oneshot::Sender<Known>>;

    /// Questions that the test answers.
    fn questions() -> (Arc<Questions>, Asked) {
        let (asked, asks) = mpsc::unbounded_channel();
        let questions = Questions::new(move || {
            let (sender, answer) = oneshot::channel();
            asked.send(sender).unwrap();
            async move { answer.await.unwrap() }
        });
        (Arc::new(questions), asks)
    }

    #[tokio::test]
    async fn one_question_serves_all_who_wait_and_none_who_come_while_it_is_under_way() {
        let (questions, mut asked) = questions();
        let first = Questions::ask(&questions);
        let under_way = asked.recv().await.unwrap();
        let late: Vec<_> = (0..1000).map(|_| Questions::ask(&questions)).collect();
        tokio::task::yield_now().await;
        assert!(asked.try_recv().is_err(), "one at a time");
        under_way.send(Ok(3)).unwrap();
        assert_eq!(first.await.unwrap(), Ok(3));
        let second = asked.recv().await.unwrap();
        second.send(Ok(5)).unwrap();
        for one in late {
            assert_eq!(
                one.await.unwrap(),
                Ok(5),
                "what was committed before they came may be more than the first answer"
            );
        }
        assert!(asked.try_recv().is_err(), "nobody waits");
        let after_a_while = Questions::ask(&questions);
        asked.recv().await.unwrap().send(Ok(6)).unwrap();
        assert_eq!(after_a_while.await.unwrap(), Ok(6));
    }

    #[tokio::test]
    async fn nothing_is_asked_for_those_who_have_gone_away() {
        let (questions, mut asked) = questions();
        let first = Questions::ask(&questions);
        let under_way = asked.recv().await.unwrap();
        drop(Questions::ask(&questions));
        under_way.send(Ok(3)).unwrap();
        first.await.unwrap().unwrap();
        let third = Questions::ask(&questions);
        asked.recv().await.unwrap().send(Ok(4)).unwrap();
        assert_eq!(third.await.unwrap(), Ok(4));
        assert!(asked.try_recv().is_err());
    }
}
