//! The question how the robot stands: a transaction, its answer, and the proof of that.

use super::{Happening, Step, waited};
use crate::client::sign;
use crate::clock::{EPOCH, MILLISECOND, SECOND};
use crate::invariant::Check;
use crate::node::{Answer, Reply, Request, What};
use crate::robot::{IDENTITY, Question, Robot};
use crate::world::{Awake, Event, World};
use bytes::Bytes;
use ledger::CallRef;
use ledger_base::rejection::{Code, Rejection};
use ledger_gate::standing::{Members, Standing};
use ledger_light::fact::Fact;
use ledger_light::{Proof, Way};
use std::collections::BTreeSet;

/// How long a question may be on its way to its block, microseconds.
const QUESTION_TTL: u64 = 5 * SECOND;
/// How long a node waits for the certificate of a block, microseconds.
const CERTIFICATE_WAIT: u64 = 3 * SECOND;
/// Most changes of who governs that a node shows at once.
const CHANGES_MAX: usize = 1024;
/// Streams of questions are beyond those of all others.
const STREAM: u64 = 1 << 48;

impl World {
    /// Asks for the services that want to know how they stand.
    pub(super) fn ask_what_is_due(&mut self, robot: &mut Robot) -> Check {
        let now = robot.clocks(self.now);
        for at in 0..robot.watched.len() {
            let guard = &mut robot.watched[at].guard;
            if guard.asks_at().is_none_or(|due| due > self.now) {
                continue;
            }
            let (since, stops) = (guard.ask(now), guard.open_stops().collect::<BTreeSet<_>>());
            robot.waiting.push((at, since));
            let known = robot
                .answered
                .clone()
                .filter(|(asked, named, _)| *asked >= since && stops.is_subset(named) && robot.question.is_none());
            if let Some((asked, _, standing)) = known {
                self.stands(robot, asked, &standing)?;
            }
        }
        if robot.question.is_none() && !robot.waiting.is_empty() {
            self.ask(robot);
        }
        Ok(())
    }

    fn ask(&mut self, robot: &mut Robot) {
        let Some(node) = robot.stream.as_ref().map(|stream| stream.node) else { return };
        robot.questions += 1;
        let (number, nonce) = (robot.questions, self.random.robot.number());
        let Some(whose) = self.people.index(IDENTITY, 0) else { return };
        let clock = robot.clocks(self.now).wall.max(robot.ahead + self.now);
        let stops: BTreeSet<CallRef> = robot.watched.iter().flat_map(|watched| watched.guard.open_stops()).collect();
        let names = stops.iter().map(|stop| Bytes::from(stop.to_string()));
        let call = ("abac", "declare", std::iter::once(Bytes::from(robot.name)).chain(names).collect());
        let transaction = sign(&self.people.all[whose], self.network, nonce, clock + QUESTION_TTL, call, true);
        let id = transaction.id();
        robot.question = Some(Question { number, node, asked: self.now, id, stops, response: None });
        self.coverage.questions += 1;
        self.note(format_args!("robot: question {number} to n{node}, {id}"));
        if robot.liar == Some(node) && self.chaos && self.random.robot.percent(10) {
            return self.untruth(super::Untruth::Ignore);
        }
        let told = self.invariants.answered_is_seen.told();
        let reply = Reply { client: robot.client, attempt: number };
        let what = What::Submit { transaction: transaction.encoded().clone(), first_attempt: true };
        let request = Request { reply, min_height: 0, told, stream: STREAM, what };
        if let Some(at) = self.links.client(self.now, &mut self.random.robot, &mut self.coverage) {
            self.schedule_at(at, Event::Request { node, request });
        }
    }

    /// A node has answered the question, if it is still the one.
    pub(crate) fn robot_answered(&mut self, reply: Reply, clock: u64, answer: Answer) -> Check {
        let Some(mut robot) = self.robot.take() else { return Ok(()) };
        self.stop_what_is_overdue(&mut robot);
        let done = self.take_answer(&mut robot, reply, clock, answer).and_then(|()| self.look_after(&mut robot));
        self.robot = Some(robot);
        done
    }

    fn take_answer(&mut self, robot: &mut Robot, reply: Reply, clock: u64, answer: Answer) -> Check {
        let Some(mut question) = robot.question.clone().filter(|question| question.number == reply.attempt) else {
            return Ok(());
        };
        robot.ahead = clock.saturating_sub(self.now).max(EPOCH);
        match answer {
            Answer::Verdict { height, index, code: Code::Ok, response, .. } => {
                question.response = Some(self.made_up_answer(robot, &response));
                let until = self.now + CERTIFICATE_WAIT;
                if let Some(at) = self.links.client(self.now, &mut self.random.robot, &mut self.coverage) {
                    let prove = Happening::Prove { question: question.number, height, index, until };
                    self.schedule_at(at, Event::Robot(prove));
                }
                robot.question = Some(question);
                Ok(())
            }
            Answer::Verdict { code, .. } => self.no_answer(robot, code),
            Answer::Refused(refused) => self.no_answer(robot, refused.code),
            Answer::Value { .. } => Ok(()),
        }
    }

    fn no_answer(&mut self, robot: &mut Robot, code: Code) -> Check {
        self.note(format_args!("robot: refused: {code}"));
        let refused = Rejection::new(code, "no answer");
        self.unanswered(robot, Some(&refused).filter(|_| code == Code::UnknownRobot))
    }

    /// A node shows the proof of an answer, as soon as it has it.
    pub(super) fn prove(&mut self, robot: &mut Robot, number: u64, (height, index): (u64, u32), until: u64) {
        let Some(question) = robot.question.as_ref().filter(|question| question.number == number) else { return };
        let (node, known) = (question.node, robot.governance.height());
        let again = Happening::Prove { question: number, height, index, until };
        match self.awake(node) {
            Awake::At(later) => return self.schedule_at(later, Event::Robot(again)),
            Awake::Yes => {}
            Awake::No => return,
        }
        let Some((running, governing)) =
            self.nodes.get(&node).and_then(|node| Some((node.up.as_ref()?, &node.governing)))
        else {
            return;
        };
        let wanted = |fact: &Fact<'_>| matches!(fact, Fact::Verdict { index: at, .. } if *at == index);
        let certificate = running.certificates.get(&height).cloned();
        let facts = certificate.as_ref().and_then(|_| running.ledger.shown(height, wanted).unwrap());
        let Some((certificate, facts)) = certificate.zip(facts) else {
            if self.now < until {
                self.happens(5 * MILLISECOND, again);
            }
            return;
        };
        let mut way = Vec::new();
        for change in running.ledger.changes(known, CHANGES_MAX).unwrap() {
            if change.height <= height {
                let proof = governing.get(&change.height).cloned().filter(|_| change.height < height);
                way.push(Step::Change(change));
                way.extend(proof.map(Step::Proof));
            }
        }
        let proof = self.made_up_proof(robot, node, Proof { certificate, facts });
        if let Some(at) = self.links.client(self.now, &mut self.random.robot, &mut self.coverage) {
            self.schedule_at(at, Event::Robot(Happening::Proved { question: number, proof, way }));
        }
    }

    /// The proof arrives: the robot checks it as a client does (`crates/api/src/client/believing.rs`).
    pub(super) fn proved(&mut self, robot: &mut Robot, number: u64, proof: Proof, way: Vec<Step>) -> Check {
        let Some(question) = robot.question.clone().filter(|question| question.number == number) else {
            return Ok(());
        };
        let Some(response) = question.response.clone() else { return Ok(()) };
        match believe(robot, &question, &response, proof, way) {
            Ok(standing) => {
                (robot.question, robot.lost) = (None, false);
                self.coverage.believed += 1;
                let height = standing.height;
                self.note(format_args!("robot: question {number} is answered by block {height}"));
                robot.answered = Some((question.asked, question.stops.clone(), standing.clone()));
                self.stands(robot, question.asked, &standing)
            }
            Err(refused) => {
                robot.lost = !self.chaos;
                *self.coverage.unbelieved.entry(refused.code).or_default() += 1;
                self.note(format_args!("robot: question {number}: {refused}"));
                self.unanswered(robot, None)?;
                // As the refusal says: ask another node.
                self.connect(robot);
                Ok(())
            }
        }
    }

    /// The services that waited learn how the robot stands.
    fn stands(&mut self, robot: &mut Robot, asked: u64, standing: &Standing) -> Check {
        let now = robot.clocks(self.now);
        for (at, _) in waited(robot, asked) {
            let watched = &mut robot.watched[at];
            match standing.service(watched.id) {
                Ok(service) => {
                    let acts = watched.guard.answered(&service, standing, asked, now);
                    self.act(robot, at, acts)?;
                }
                Err(_) => {
                    watched.guard.unanswered(Some(asked));
                    self.no_service(robot, at)?;
                }
            }
        }
        Ok(())
    }
}

fn believe(
    robot: &mut Robot,
    question: &Question,
    response: &[u8],
    proof: Proof,
    way: Vec<Step>,
) -> Result<Standing, Rejection> {
    proof.answers(&question.id, response)?;
    let governance = match robot.governance.follow(&[], &proof) {
        Ok(governance) => governance,
        Err(_) => {
            let mut path = Way::from(robot.governance.clone());
            for step in way {
                match step {
                    Step::Change(change) => path.change(change.height, &change.to_bytes())?,
                    Step::Proof(proof) => path.follow(proof),
                }
            }
            path.follow(proof);
            path.end()?.governance
        }
    };
    if governance.chain() != robot.governance.chain() {
        robot.members = Members::of(&governance)?;
    }
    robot.governance = governance;
    Standing::declared(response, &robot.members, &robot.governance)
}
