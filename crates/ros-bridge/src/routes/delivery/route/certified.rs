//! The certified state of the robot, as the voters answer.

use std::time::Instant;

use ledger_base::rejection::{Code, Rejection};
use ledger_gate::guard::Act;

use super::FromLedger;
use crate::{
    ledger::robot_state::{Answer, CertifiedRobotState},
    log::one_line,
    routes::{
        shown::HolderNames,
        terms::{stop_for, topic_for},
    },
};

impl FromLedger {
    /// Takes the answer of the voters, and judges the messages that waited for it.
    pub(super) async fn answered(&mut self, answer: Answer) {
        self.judged = Instant::now();
        let answered = match answer {
            Ok(answered) => answered,
            Err(refused) => return self.not_known(&refused, None).await,
        };
        match self.learn(&answered) {
            Ok(acts) => {
                for act in acts {
                    self.carry_out(act).await;
                }
                self.tell_holders();
                let task = answered.standing.tasks.iter().find(|task| task.service == self.route.service);
                self.outputs.points.show(task, answered.asked);
                self.outputs.holder.show(&self.route.service, &answered.standing);
            }
            Err(refused) => self.not_known(&refused, Some(self.clocks.steady(answered.asked))).await,
        }
    }

    /// Takes how the robot stands.
    fn learn(&mut self, CertifiedRobotState { standing, asked }: &CertifiedRobotState) -> Result<Vec<Act>, Rejection> {
        let service = standing.service(&self.route.service)?;
        topic_for(&service, &self.route)?;
        self.stop_messages.learn(stop_for(&service, &self.route, self.settings.stop.as_ref())?, &service);
        let acts = self.guard.answered(&service, standing, self.clocks.steady(*asked), self.clocks.now());
        let mut counts = self.counters.lock();
        counts.live.needs_grant = service.needs_grant() && service.is_command();
        counts.live.holder = HolderNames::of(&self.route.service, &standing.grants).names();
        drop(counts);
        self.service = service;
        self.read_confidential()?;
        Ok(acts)
    }

    /// Nobody says how the robot stands. Where that is because there is no such service, or none that this version knows, it stops.
    /// Else what is known counts for a while.
    async fn not_known(&mut self, refused: &Rejection, asked: Option<u64>) {
        self.guard.unanswered(asked);
        let reason = one_line(refused);
        let is_gone = matches!(
            refused.code,
            Code::UnknownRobot | Code::UnknownService | Code::UnknownMode | Code::WrongType | Code::BadArgument
        );
        if is_gone {
            for act in self.guard.gone(self.clocks.now()) {
                self.carry_out(act).await;
            }
        }
        self.counters.lock().live.waiting = Some(format!("the voters do not say how the robot stands: {reason}"));
        if let Some(not_logged) = self.log_limiter.admit("standing", Instant::now()) {
            let service = &self.route.service;
            tracing::warn!(
                service,
                code = refused.code.name(),
                reason,
                not_logged,
                "the voters do not say how the robot stands"
            );
        }
        if is_gone {
            self.outputs.points.clear();
            if self.guard.gate().is_moving() {
                self.halt("no_service").await;
            }
        }
    }

    /// Tells the reporter how the service stands.
    pub(super) fn tell_holders(&self) {
        let live = &mut self.counters.lock().live;
        live.held = self.guard.gate().is_held();
        if !live.held {
            live.holder.clear();
        }
        if !self.guard.gate().is_closed() {
            live.waiting = None;
        }
    }
}
