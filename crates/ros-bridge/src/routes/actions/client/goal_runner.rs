//! Sets the goals that pass the gate, follows them, and cancels those whose right has ended.

use std::time::{Duration, Instant};

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_gate::{gate::Passed, sample::Sample};
use tokio::{
    sync::{mpsc, watch},
    time::{sleep_until, timeout},
};

use super::{earlier::EarlierGoals, feedback::FeedbackBuffer};
use crate::{
    graph::{
        local::{Client, Input, Number, Reply},
        queue::Incoming,
    },
    routes::{
        actions::{
            frame::{
                FEEDBACK, GoalId, LOST, Part, STATUS, cancel_of, goal_of, goals_in, ids_in, is_accepted, is_of_no_goal,
                is_over, is_unknown_or_over, split_request,
            },
            goals::Goals,
            parts::Parts,
        },
        calls::{Account, Submitter, Waiting},
        clocks::Clocks,
        ends::{CALLS_MAX, Handed, TOO_MANY, message_of, reply_to},
    },
    shutdown::{Shutdown, requested},
};

/// How long the bridge waits for the server at its end, when goals are cancelled.
const FAREWELL_MAX: Duration = Duration::from_millis(500);
/// Between two looks whether there is a server still.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// A call of the server under way.
pub(super) enum Call {
    /// For a request on the ledger, with the goal that it sets or asks about.
    Passed { request: Hash, part: Part, goal: Option<GoalId> },
    /// A cancelling of the bridge's own.
    Own(GoalId),
    /// A question of the bridge's own, whether the server knows the goal: for its result.
    Asked(GoalId),
}

/// Knows which goals run, and which request each call of the server is for.
pub(super) struct ActionClient {
    pub(super) clients: Parts<Box<dyn Client>>,
    pub(super) feedback: Box<dyn Input>,
    pub(super) status: Box<dyn Input>,
    pub(super) handed: mpsc::Receiver<Handed>,
    /// Tells the gate when the robot rests, by the number of messages that are known here.
    pub(super) rests: watch::Sender<u64>,
    pub(super) known: u64,
    pub(super) answers: Submitter,
    pub(super) waiting: Waiting<(Part, Number), Call>,
    pub(super) results: Waiting<(Part, Number), Call>,
    pub(super) goals: Goals,
    /// How many servers there were at the last look.
    pub(super) servers: usize,
    pub(super) earlier: EarlierGoals,
    pub(super) clocks: Clocks,
    pub(super) said: FeedbackBuffer,
    pub(super) account: Account,
    pub(super) service: String,
}

impl ActionClient {
    /// Runs until it is told to end, or the middleware ends. Then the goals that run are cancelled. `is_used`: may goals have been set
    /// before? Nothing passes the gate until the voters have answered, so this waits for them, too.
    pub(super) async fn run(mut self, mut shutdown: Shutdown, is_used: impl Future<Output = bool>) {
        tokio::select! {
            () = requested(&mut shutdown) => {}
            is_used = is_used => if !is_used {
                self.earlier = EarlierGoals::new(None);
            }
        }
        let mut look = tokio::time::interval(LOOK_EVERY);
        loop {
            let late = [self.waiting.due(), self.results.due(), self.goals.due()].into_iter().flatten().min();
            let said = self.said.due();
            tokio::select! {
                biased;
                () = requested(&mut shutdown) => break,
                // A stop before what the robot says, however much that is.
                Some(handed) = self.handed.recv() => match handed {
                    Handed::Passed(passed) => {
                        self.known = self.known.saturating_add(1);
                        self.request(&passed);
                    }
                    Handed::Stop(reason) => self.stop(reason),
                },
                reply = self.clients.next() => match reply {
                    Some((part, reply)) => self.reply(part, &reply),
                    None => break,
                },
                () = sleep_until(late.unwrap_or_else(Instant::now).into()), if late.is_some() => self.expire(),
                () = sleep_until(said.unwrap_or_else(Instant::now).into()), if said.is_some() => self.say(),
                _ = look.tick() => self.look(),
                Some(status) = self.status.next() => self.state(&status),
                Some(feedback) = self.feedback.next() => self.hear(&feedback.sample),
            }
            if self.goals.rests() {
                self.rests.send_if_modified(|rests| std::mem::replace(rests, self.known) != self.known);
            }
        }
        self.stop("shutdown");
        // The server may have heard of a goal whose acceptance is under way.
        let farewell = async {
            while !self.waiting.is_empty()
                && let Some((part, reply)) = self.clients.next().await
            {
                self.reply(part, &reply);
            }
        };
        if timeout(FAREWELL_MAX, farewell).await.is_err() {
            tracing::warn!(service = self.service, "the robot has not confirmed that every goal is cancelled");
        }
        self.answers.close();
    }

    fn request(&mut self, Passed { transaction, samples, .. }: &Passed) {
        // A reply names a transaction, so there is one request in each.
        let [sample] = samples.as_slice() else {
            return self.account.refuse("several_calls", "a transaction has more than one request");
        };
        let Some((part, message)) = split_request(sample) else {
            return self.account.refuse("bad_payload", "it is no request of an action");
        };
        let goal = goal_of(&message);
        let waiting = if part == Part::Result { &self.results } else { &self.waiting };
        let is_full = waiting.is_full() || (part == Part::Goal && self.goals.is_full());
        match (part, goal) {
            (Part::Alive, _) => return self.tell_lost(&message),
            (_, None) => return self.account.refuse("bad_payload", "a request of an action names a goal"),
            _ if is_full => {
                return self.account.refuse(TOO_MANY, &format!("{CALLS_MAX} goals or requests have not ended"));
            }
            (Part::Goal, Some(goal)) => self.goals.ask(goal),
            (Part::Cancel | Part::Result, Some(_)) => {}
        }
        let is_made = self.call(part, &message, Call::Passed { request: *transaction, part, goal });
        if let (Part::Goal, Some(goal), false) = (part, goal, is_made) {
            self.goals.answered(&goal, false, Instant::now());
        }
    }

    /// Tells a user's bridge which of the goals that it keeps the grant for are lost: else it would keep it for ever.
    fn tell_lost(&mut self, alive: &[u8]) {
        let lost: Vec<GoalId> = ids_in(alive).filter(|goal| self.goals.has_lost(goal)).collect();
        if !lost.is_empty() {
            // A goal that has just ended is not lost: its last state comes first.
            self.say();
            self.submit(LOST, &lost.concat());
        }
    }

    /// Calls the server. False if there is none.
    fn call(&mut self, part: Part, message: &[u8], call: Call) -> bool {
        let called = self.clients.of(part).call(message);
        let Some(number) = self.account.handed_over("a request", called) else { return false };
        let waiting = if part == Part::Result { &mut self.results } else { &mut self.waiting };
        waiting.insert((part, number), call, Instant::now());
        true
    }

    /// Cancels goals for a reason of the bridge's own.
    fn cancel(&mut self, goals: &[GoalId], reason: &'static str) {
        for goal in goals {
            tracing::warn!(service = self.service, goal = hex::encode(goal), reason, "goal cancelled");
            self.call(Part::Cancel, &cancel_of(*goal), Call::Own(*goal));
        }
    }

    fn stop(&mut self, reason: &'static str) {
        let goals = self.goals.stop(Instant::now());
        self.cancel(&goals, reason);
    }

    fn reply(&mut self, part: Part, Reply { number, message }: &Reply) {
        let call = self.waiting.take(&(part, *number)).or_else(|| self.results.take(&(part, *number)));
        match call {
            None => {}
            Some(Call::Own(goal)) if is_unknown_or_over(message) => {
                self.goals.ended(&goal);
            }
            Some(Call::Own(goal)) if message.first() == Some(&1) => {
                let goal = hex::encode(goal);
                tracing::error!(service = self.service, goal, "THE ROBOT REFUSES TO CANCEL A GOAL");
            }
            Some(Call::Asked(goal)) if is_of_no_goal(part, message) => {
                self.goals.lose(&goal);
            }
            Some(Call::Own(_) | Call::Asked(_)) => {}
            Some(Call::Passed { request, part, goal }) => {
                if let Some(goal) = goal {
                    self.learn(part, goal, message);
                }
                self.submit(request, message);
            }
        }
    }

    /// A reply tells how a goal stands.
    fn learn(&mut self, part: Part, goal: GoalId, message: &[u8]) {
        if part == Part::Goal {
            if self.goals.answered(&goal, is_accepted(message), Instant::now()) {
                self.cancel(&[goal], "stopped before it was accepted");
            }
        } else if part == Part::Result && message.first().is_some_and(|state| is_over(*state)) {
            // What was said of it comes before its result.
            self.goals.ended(&goal);
            self.say();
        }
    }

    /// Takes the states of the goals, and passes them on while some of them are of the ledger's, or may have been.
    fn state(&mut self, Incoming { sample, source, .. }: &Incoming) {
        let Some(message) = message_of(sample) else { return };
        let (was_empty, states) = (self.goals.is_empty(), goals_in(&message));
        for stated in states.iter().filter(|stated| stated.is_over()) {
            self.goals.ended(&stated.goal);
        }
        let earlier = self.earlier.look(*source, &states, self.clocks.now().wall);
        if !was_empty || earlier.is_some() {
            self.keep(STATUS, GoalId::default(), message);
        }
        for goal in earlier.into_iter().flatten() {
            if self.goals.found(goal, Instant::now()) {
                self.cancel(&[goal], "it ran when the bridge came");
            }
        }
    }

    fn hear(&mut self, sample: &Sample) {
        let Some(message) = message_of(sample) else { return };
        if let Some(goal) = goal_of(&message).filter(|goal| self.goals.has(goal)) {
            self.keep(FEEDBACK, goal, message);
        }
    }

    fn keep(&mut self, what: Hash, goal: GoalId, message: Bytes) {
        let thinned = self.said.keep(what, goal, message, Instant::now());
        self.account.thinned(u64::from(thinned));
    }

    /// Hands over to the ledger whatever was said.
    fn say(&mut self) {
        for (what, message) in self.said.take(Instant::now()) {
            self.submit(what, &message);
        }
    }

    fn submit(&mut self, request: Hash, message: &[u8]) {
        if let Ok(sample) = reply_to(request, message) {
            self.answers.submit(sample);
        }
    }

    /// Gives up what nobody has answered, and cancels what runs for too long.
    fn expire(&mut self) {
        let now = Instant::now();
        for call in self.waiting.expire(now).into_iter().chain(self.results.expire(now)) {
            if let Call::Passed { part: Part::Goal, goal: Some(goal), .. } = call {
                self.goals.unanswered(&goal, now);
            }
            self.account.refuse("no_reply", "the action server has not replied in time");
        }
        let overdue = self.goals.overdue(now);
        self.cancel(&overdue, "it has not ended in time");
    }

    /// A server that has left may only stand still: when it comes back, its goals are cancelled. Where another one has taken its place
    /// meanwhile, that one is asked which goals it knows.
    fn look(&mut self) {
        let servers = self.clients.matched().now().matched;
        let before = std::mem::replace(&mut self.servers, servers);
        if servers > 0 {
            let back = self.goals.come_back(Instant::now());
            self.cancel(&back, "its server has come back");
            let asked = if servers == 1 && before > 1 { self.goals.accepted() } else { Vec::new() };
            for goal in asked {
                self.call(Part::Result, &goal, Call::Asked(goal));
            }
        } else if self.goals.leave() {
            tracing::warn!(
                service = self.service,
                "the action server has left: its goals are cancelled if it comes back"
            );
        }
    }
}
