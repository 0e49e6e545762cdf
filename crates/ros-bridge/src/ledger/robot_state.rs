//! Asks how a robot stands: its services, who holds them, and who governs the network. Voters have signed it, as the answer to a
//! question of this bridge.
//!
//! The question is a transaction, `abac declare ROBOT`. Nobody knows its id before, so an answer to it is newer than the
//! question. The bridge begins with what the network's name covers, or with a checkpoint, and follows who governs from there.

use std::{
    collections::BTreeSet,
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{FutureExt, future::BoxFuture};
use ledger::CallRef;
use ledger_api::Certified;
use ledger_base::rejection::{Code, Rejection};
use ledger_gate::standing::{Members, Standing};
use ledger_light::Governance;
use tokio::{sync::Mutex, time::timeout};

use super::gateway::Gateway;

/// How long an answer may take.
const ANSWER_MAX: Duration = Duration::from_secs(5);

/// The answer to a question.
#[derive(Debug)]
pub(crate) struct CertifiedRobotState {
    /// How the robot stands.
    pub(crate) standing: Standing,
    /// When the question was asked: the robot stood so, or will stand so, at that moment or later.
    pub(crate) asked: Instant,
}

/// The answer to a question.
pub(crate) type Answer = Result<Arc<CertifiedRobotState>, Rejection>;

/// A route's questions, one at a time.
pub(crate) struct Question {
    query: Arc<RobotStateQuery>,
    under_way: Option<BoxFuture<'static, Answer>>,
}

impl Question {
    /// Nothing is asked yet.
    pub(crate) fn new(query: Arc<RobotStateQuery>) -> Self {
        Self { query, under_way: None }
    }

    /// Asks how the robot stands at that moment or later, and which of these stops are settled. The answer to the question before is
    /// dropped.
    pub(crate) fn ask(&mut self, since: Instant, stops: BTreeSet<CallRef>) {
        let query = Arc::clone(&self.query);
        self.under_way = Some(async move { query.ask(since, &stops).await }.boxed());
    }

    /// Is there an answer to come?
    pub(crate) fn is_under_way(&self) -> bool {
        self.under_way.is_some()
    }

    /// The answer; waits for ever if nothing was asked.
    pub(crate) async fn answer(&mut self) -> Answer {
        let Some(asked) = &mut self.under_way else { return std::future::pending().await };
        let answer = asked.await;
        self.under_way = None;
        answer
    }
}

/// Asks how one robot stands. Its routes share the answers.
pub(crate) struct RobotStateQuery {
    gateway: Arc<dyn Gateway>,
    robot: String,
    last: Mutex<Last>,
}

/// The last question, and what it led to.
#[derive(Default)]
struct Last {
    trust: Option<Trust>,
    /// With the stops that it named.
    outcome: Option<(Instant, BTreeSet<CallRef>, Answer)>,
}

/// The voters, as far as they are followed, and the members that they vouch for.
struct Trust(Governance, Members);

impl RobotStateQuery {
    /// Without a checkpoint the way begins at the genesis.
    pub(crate) fn new(
        gateway: Arc<dyn Gateway>,
        robot: &str,
        checkpoint: Option<&Governance>,
    ) -> Result<Self, Rejection> {
        let trust = checkpoint.map(|known| Ok::<_, Rejection>(Trust(known.clone(), Members::of(known)?)));
        let last = Mutex::new(Last { trust: trust.transpose()?, outcome: None });
        Ok(Self { gateway, robot: robot.to_owned(), last })
    }

    /// The answer to a question that was asked at that moment or later and named these stops; asks if there is none yet.
    ///
    /// # Errors
    /// [`Code::UnknownRobot`]; why there is no proof; the ledger's refusal if it does not answer in time.
    pub(crate) async fn ask(&self, since: Instant, stops: &BTreeSet<CallRef>) -> Answer {
        let mut last = self.last.lock().await;
        let serves =
            |(asked, named, _): &&(Instant, BTreeSet<CallRef>, Answer)| *asked >= since && stops.is_subset(named);
        if let Some((_, _, outcome)) = last.outcome.as_ref().filter(serves) {
            return outcome.clone();
        }
        let asked = Instant::now();
        let outcome = match timeout(ANSWER_MAX, self.ask_now(&mut last.trust, stops)).await {
            Ok(answer) => answer.map(|standing| Arc::new(CertifiedRobotState { standing, asked })),
            Err(_) => Err(Rejection::new(Code::Timeout, "nobody says how the robot stands")
                .found(format!("no answer within {} s", ANSWER_MAX.as_secs()))
                .wanted("a transaction that commits, and the signatures of the voters")
                .next("look at ledgerctl status")),
        };
        last.outcome = Some((asked, stops.clone(), outcome.clone()));
        outcome
    }

    async fn ask_now(&self, trust: &mut Option<Trust>, stops: &BTreeSet<CallRef>) -> Result<Standing, Rejection> {
        let Trust(known, members) = match trust {
            Some(trust) => trust,
            None => trust.insert(self.begin().await?),
        };
        let Certified { response, checkpoint } = self.gateway.declare(&self.robot, stops, known.clone()).await?;
        if checkpoint.governance.chain() != known.chain() {
            *members = Members::of(&checkpoint.governance)?;
        }
        *known = checkpoint.governance;
        Standing::declared(&response, members, known)
    }

    async fn begin(&self) -> Result<Trust, Rejection> {
        let founded = self.gateway.beginning().await?;
        let members = Members::of(&founded)?;
        Ok(Trust(founded, members))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::ledger::fake::Fake;
    use ledger_gate::fixture::shared;
    use std::sync::atomic::Ordering;

    fn asker(fake: &Arc<Fake>) -> RobotStateQuery {
        RobotStateQuery::new(Arc::clone(fake) as Arc<dyn Gateway>, "T", None).unwrap()
    }

    #[tokio::test]
    async fn routes_of_one_robot_share_an_answer_that_is_as_new_as_they_want() {
        let fake = Fake::new("exclusive", shared());
        fake.set_holder("Org1/Salma", 3, 1000);
        let (asker, before) = (asker(&fake), Instant::now());
        let first = asker.ask(before, &BTreeSet::new()).await.unwrap();
        assert!(first.asked >= before);
        assert_eq!((first.standing.grants.len(), first.standing.services.len()), (1, 1));
        assert!(Arc::ptr_eq(&first, &asker.ask(before, &BTreeSet::new()).await.unwrap()));
        let newer = asker.ask(Instant::now(), &BTreeSet::new()).await.unwrap();
        assert!(newer.standing.height > first.standing.height && newer.asked > first.asked);
        assert!(
            Arc::ptr_eq(&newer.standing.members.msps, &first.standing.members.msps),
            "nothing has changed who governs"
        );
    }

    #[tokio::test]
    async fn a_question_that_failed_is_told_to_all_who_waited_for_it_and_asked_again_later() {
        let fake = Fake::new("exclusive", shared());
        fake.answers.store(false, Ordering::Relaxed);
        let (asker, before) = (asker(&fake), Instant::now());
        assert_eq!(asker.ask(before, &BTreeSet::new()).await.unwrap_err().code, Code::Timeout);
        fake.answers.store(true, Ordering::Relaxed);
        assert_eq!(asker.ask(before, &BTreeSet::new()).await.unwrap_err().code, Code::Timeout);
        assert!(asker.ask(Instant::now(), &BTreeSet::new()).await.is_ok());
    }

    #[tokio::test]
    async fn with_a_checkpoint_the_genesis_is_not_asked_for() {
        let fake = Fake::new("exclusive", shared());
        let known = fake.beginning().await.unwrap();
        fake.certifies.store(false, Ordering::Relaxed);
        let gateway = Arc::clone(&fake) as Arc<dyn Gateway>;
        let asker = RobotStateQuery::new(gateway, "T", Some(&known)).unwrap();
        let answered = asker.ask(Instant::now(), &BTreeSet::new()).await.unwrap();
        assert!(!Arc::ptr_eq(&answered.standing.members.msps, &shared().msps), "those of the checkpoint");
    }

    #[tokio::test]
    async fn an_answer_serves_only_routes_whose_open_stops_the_question_named() {
        let fake = Fake::new("exclusive", shared());
        fake.set_holder("Org1/Salma", 3, 1000);
        let (asker, before) = (asker(&fake), Instant::now());
        let stop = shared().robot.sign("abac", "stop", Vec::new()).call_ref();
        let unnamed = asker.ask(before, &BTreeSet::new()).await.unwrap();
        assert!(unnamed.standing.settled.is_empty());
        fake.settled.lock().unwrap().push(stop.id.to_string());
        let named = asker.ask(before, &BTreeSet::from([stop])).await.unwrap();
        assert_eq!(named.standing.settled, [stop.id].into());
        assert_eq!(*fake.asked.lock().unwrap(), [stop].into());
        assert!(Arc::ptr_eq(&named, &asker.ask(before, &BTreeSet::new()).await.unwrap()));
    }
}
