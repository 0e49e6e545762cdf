//! Takes goals from the local graph to the ledger, and what the robot says of them back to their clients.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use bytes::Bytes;
use ledger_gate::{
    gate::Passed,
    sample::{CDR_LE, Sample},
};
use tokio::{
    sync::mpsc::{self, UnboundedReceiver},
    time::{interval, sleep_until},
};

use crate::{
    error::Error,
    graph::local::{Caller, Output, Request, Server},
    routes::{
        actions::{
            frame::{
                CANCEL_REFUSED, FEEDBACK, GOAL_REFUSED, GoalId, LOST, Part, STATUS, aborted, cancel_of, goal_of,
                goals_in, ids_in, is_accepted, is_of_no_goal, is_over, is_unknown_or_over, request_of,
            },
            goals::Goals,
            parts::Parts,
        },
        calls::{Account, PendingRequests, Submitter},
        ends::{CALLS_MAX, Handed, SubmitUpdate, TOO_MANY, split},
    },
    shutdown::{Shutdown, requested},
};

/// A request of somebody in the local graph.
pub(super) struct Call {
    part: Part,
    goal: GoalId,
    caller: Caller,
}

/// The lanes of requests that wait: results take their time.
const QUICK: usize = 0;
const RESULTS: usize = 1;

impl Call {
    fn lane(part: Part) -> usize {
        if part == Part::Result { RESULTS } else { QUICK }
    }
}

/// Knows who has set which goal.
pub(super) struct ActionServer {
    pub(super) robot: String,
    pub(super) servers: Parts<Box<dyn Server>>,
    pub(super) feedback: Box<dyn Output>,
    pub(super) status: Box<dyn Output>,
    pub(super) requests: Submitter,
    pub(super) updates: UnboundedReceiver<SubmitUpdate>,
    pub(super) handed: mpsc::Receiver<Handed>,
    /// Goals and cancellings, and beside them the requests for results.
    pub(super) pending: PendingRequests<Call, 2>,
    pub(super) goals: Goals,
    /// The clients of the goals, as far as they are there.
    pub(super) callers: BTreeMap<GoalId, Caller>,
    pub(super) alive_every: Duration,
    pub(super) account: Account,
}

impl ActionServer {
    /// Runs until it is told to end, or the middleware ends.
    pub(super) async fn run(mut self, mut shutdown: Shutdown) {
        let mut alive = interval(self.alive_every);
        loop {
            let due = self.pending.due();
            tokio::select! {
                biased;
                () = requested(&mut shutdown) => break,
                // Before replies: the id of a request is known before its reply can come.
                Some(update) = self.updates.recv() => self.update(update),
                Some(Handed::Passed(passed)) = self.handed.recv() => self.take(&passed),
                () = sleep_until(due.unwrap_or_else(Instant::now).into()), if due.is_some() => self.expire(),
                _ = alive.tick() => self.live(),
                request = self.servers.next() => match request {
                    Some((part, request)) => self.request(part, request),
                    None => break,
                },
            }
        }
        self.requests.close();
    }

    fn request(&mut self, part: Part, Request { message, caller }: Request) {
        let Some(goal) = goal_of(&message) else {
            return self.account.refuse("bad_payload", "a request of an action names a goal");
        };
        let (call, lane) = (Call { part, goal, caller }, Call::lane(part));
        if self.pending.is_full(lane) || (part == Part::Goal && self.goals.is_full()) {
            self.account.refuse(TOO_MANY, &format!("{CALLS_MAX} goals or requests have not ended"));
            return self.say_no(&call);
        }
        if part == Part::Goal && !self.goals.has(&goal) {
            self.goals.ask(goal);
            self.callers.insert(goal, call.caller.clone());
        }
        match self.submit(part, &message) {
            Some(number) => self.pending.insert(lane, number, call, Instant::now()),
            None => self.say_no(&call),
        }
    }

    /// A request goes to the ledger. Returns its number.
    fn submit(&mut self, part: Part, message: &[u8]) -> Option<u64> {
        Some(self.requests.submit(request_of(part, message).ok()?))
    }

    /// While a goal runs whose client is there, the grant is used. A goal whose client has left is cancelled, and again while the grant
    /// is used for others. It does not keep the grant itself: when the lease ends, the robot's bridge cancels it.
    fn live(&mut self) {
        self.callers.retain(|goal, _| self.goals.has(goal));
        if self.goals.is_empty() || !self.account.may_call() {
            return;
        }
        let (now, before) = (Instant::now(), self.callers.len());
        self.callers.retain(|goal, caller| {
            let is_there = self.servers.goals().is_there(caller);
            if !is_there {
                tracing::warn!(
                    robot = self.robot,
                    goal = hex::encode(goal),
                    "the client of a goal has left: it is cancelled"
                );
                self.goals.give_up(goal, now);
            }
            is_there
        });
        let is_used = !self.callers.is_empty();
        if is_used {
            let goals = self.goals.accepted().concat();
            self.submit(Part::Alive, &goals);
        }
        if is_used || self.callers.len() < before {
            for goal in self.goals.overdue(now) {
                self.submit(Part::Cancel, &cancel_of(goal));
            }
        }
    }

    fn update(&mut self, update: SubmitUpdate) {
        if let Some(call) = self.pending.update(update) {
            self.say_no(&call);
        }
    }

    /// Tells a caller that the ledger does not let its request pass, as far as ROS 2 has words for that.
    fn say_no(&mut self, call: &Call) {
        match call.part {
            Part::Goal => {
                self.goals.answered(&call.goal, false, Instant::now());
                self.reply(call, &GOAL_REFUSED);
            }
            Part::Cancel => self.reply(call, &CANCEL_REFUSED),
            Part::Result | Part::Alive => {}
        }
    }

    fn reply(&mut self, Call { part, caller, .. }: &Call, message: &[u8]) {
        let replied = self.servers.of(*part).reply(caller, message);
        self.account.handed_over("a reply", replied);
    }

    /// Takes what the robot says.
    fn take(&mut self, Passed { creator, samples, .. }: &Passed) {
        if self.account.refuses(creator, &self.robot) {
            return;
        }
        for (id, message) in samples.iter().filter_map(split) {
            match id {
                FEEDBACK => {
                    if goal_of(&message).is_some_and(|goal| self.goals.has(&goal)) {
                        self.tell(&message, |desk| &*desk.feedback);
                    }
                }
                STATUS => {
                    for stated in goals_in(&message).iter().filter(|stated| stated.is_over()) {
                        self.goals.ended(&stated.goal);
                    }
                    self.tell(&message, |desk| &*desk.status);
                }
                LOST => ids_in(&message).for_each(|goal| self.lose(&goal)),
                id => {
                    // Replies to others are for other bridges.
                    let Some(call) = self.pending.replied(&id) else { continue };
                    self.learn(&call, &message);
                    self.reply(&call, &message);
                }
            }
        }
    }

    /// Publishes what the robot says to all.
    fn tell(&mut self, message: &Bytes, to: impl Fn(&Self) -> &dyn Output) {
        let written = Sample::new(CDR_LE, message).map_err(Error::sample);
        let written = written.and_then(|sample| to(self).write(&sample));
        self.account.handed_over("feedback or a state", written);
    }

    /// A reply tells how a goal stands.
    fn learn(&mut self, call: &Call, message: &[u8]) {
        match call.part {
            Part::Goal => {
                if self.goals.answered(&call.goal, is_accepted(message), Instant::now()) {
                    self.submit(Part::Cancel, &cancel_of(call.goal));
                }
            }
            Part::Result if message.first().is_some_and(|state| is_over(*state)) => {
                self.goals.ended(&call.goal);
            }
            Part::Result | Part::Cancel if is_of_no_goal(call.part, message) => self.lose(&call.goal),
            // Its last state may still be on its way.
            Part::Cancel if is_unknown_or_over(message) => {
                self.goals.lose(&call.goal);
            }
            Part::Result | Part::Cancel | Part::Alive => {}
        }
    }

    /// The robot does not know a goal any more: its client hears that it was aborted. A result cannot be made up, because its type is
    /// not known here.
    fn lose(&mut self, goal: &GoalId) {
        if self.goals.lose(goal) {
            tracing::warn!(
                robot = self.robot,
                goal = hex::encode(goal),
                "the robot has lost a goal: it counts as aborted"
            );
            self.tell(&Bytes::copy_from_slice(&aborted(*goal)), |desk| &*desk.status);
        }
    }

    /// Gives up what nobody has answered. A goal of which its client hears that it is refused does not run: it is cancelled.
    fn expire(&mut self) {
        let now = Instant::now();
        for call in self.pending.expire(now) {
            self.account.refuse("no_reply", "the robot has not replied in time");
            if call.part == Part::Goal {
                self.submit(Part::Cancel, &cancel_of(call.goal));
            }
            self.say_no(&call);
        }
    }
}
