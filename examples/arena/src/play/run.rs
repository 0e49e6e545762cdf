//! One run: tasks are given, the ledger decides, waypoints are reached, and everything is written down.

use super::stage::Stage;
use super::turtlebot::look;
use super::{Cast, Setting, Tell};
use crate::model::course::{User, WAYPOINTS, Waypoint, interrupted, one_after_the_other};
use crate::model::link::Link;
use crate::model::record::{Driving, Emergency, Heard, Reached, Record, Seen};
use ledger_api::Client;
use ledger_base::rejection::{Code, Rejection};
use ledgerd::demo::Network;
use ledgerd::demo::SERVICE;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use tokio::time::{interval, sleep_until};

/// The emergency comes so long after Farhad's first waypoint, when the robot is on its way to the next one.
const EMERGENCY_AFTER: Duration = Duration::from_secs(1);
/// It lasts so long.
const EMERGENCY: Duration = Duration::from_secs(3);
/// Longest run in which somebody decides.
const RUN_TIME_MAX: Duration = Duration::from_secs(300);
/// Longest run in which nobody decides, which may never end, on the whole course.
const OPEN_TIME_MAX: Duration = Duration::from_secs(30);
/// How long the robot is watched after the end, until it stands.
const AFTER_END: Duration = Duration::from_millis(700);
/// How often it is said how far the run is.
const LOOK: Duration = Duration::from_millis(250);

/// The kinds of runs.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Kind {
    /// With access control: the second task waits.
    Controlled,
    /// Without.
    Open,
    /// The second task preempts the first one; an emergency stop in the middle.
    Preempted,
    /// As the first, over a link.
    Delayed(Link),
}

impl Kind {
    /// The settings of the robot's service.
    fn sharing(self) -> Value {
        let all = ["on_conflict", "queue_max", "priority"];
        match self {
            Self::Controlled | Self::Delayed(_) => json!({
                "mode": "exclusive", "sharing": { "on_conflict": "queue" }, "clear": ["priority", "queue_max"] }),
            Self::Open => json!({ "mode": "open", "clear": all }),
            Self::Preempted => json!({
                "mode": "exclusive",
                "sharing": { "on_conflict": "preempt", "priority": "attribute:rank", "queue_max": 8 } }),
        }
    }

    fn planned(self) -> (Vec<Waypoint>, Vec<User>) {
        match self {
            Self::Controlled | Self::Delayed(_) => (one_after_the_other(), User::ALL.into()),
            Self::Open => (one_after_the_other(), Vec::new()),
            Self::Preempted => (interrupted(), vec![User::Salma, User::Farhad, User::Salma]),
        }
    }

    fn link(self) -> Option<Link> {
        match self {
            Self::Delayed(link) => Some(link),
            _ => None,
        }
    }

    fn time_max(self, scale: f64) -> Duration {
        if self == Self::Open { OPEN_TIME_MAX.mul_f64(scale) } else { RUN_TIME_MAX }
    }
}

/// The state of a run.
struct Run<'a> {
    kind: Kind,
    cast: &'a Cast,
    tell: &'a Tell,
    stage: Stage,
    setting: Setting,
    began: Instant,
    /// The tasks of the ledger, by user.
    tasks: [Option<u64>; 2],
    record: Record,
    /// When the emergency is to begin.
    stop_at: Option<Instant>,
    /// When it is to end.
    resume_at: Option<Instant>,
}

/// Plays a run.
pub(crate) async fn play(
    network: &mut Network,
    cast: &Cast,
    kind: Kind,
    setting: Setting,
    tell: &Tell,
) -> Result<Record, Rejection> {
    call(&network.owner, "configure", &[SERVICE, &kind.sharing().to_string()]).await?;
    let stage = Stage::open(network, setting, kind.link()).await?;
    let (planned, drivers) = kind.planned();
    let mut run = Run {
        kind,
        cast,
        tell,
        stage,
        setting,
        began: Instant::now(),
        tasks: [None; 2],
        record: Record::new(setting.course, planned, drivers),
        stop_at: None,
        resume_at: None,
    };
    run.drive(network).await?;
    run.end().await;
    let reports = network.bridges.stop().await?;
    run.record.refused = reports
        .into_iter()
        .map(|(name, _, report)| (name.to_owned(), report.refused()))
        .filter(|(_, refused)| !refused.is_empty())
        .collect();
    Ok(run.written())
}

impl Run<'_> {
    /// Until both tasks are done, or the time is up.
    async fn drive(&mut self, network: &mut Network) -> Result<(), Rejection> {
        let deadline = self.began + self.kind.time_max(self.setting.course.scale());
        self.give_task(User::Salma).await?;
        let mut looks = interval(LOOK);
        while !self.stage.drivers.iter().all(|driver| driver.is_done()) {
            tokio::select! {
                reached = self.stage.reached.recv() => match reached {
                    Some((waypoint, at)) => self.reached(waypoint, at).await?,
                    None => break,
                },
                () = moment(self.stop_at) => self.stop(network).await?,
                () = moment(self.resume_at) => self.resume(network).await?,
                _ = looks.tick() => {
                    network.check()?;
                    self.show();
                }
                () = sleep_until(deadline.into()) => break,
            }
        }
        // The last ones may still wait to be written down.
        while let Ok((waypoint, at)) = self.stage.reached.try_recv() {
            self.reached(waypoint, at).await?;
        }
        Ok(())
    }

    /// A user gets a task: with access control from the ledger, and begins to command in any case.
    async fn give_task(&mut self, user: User) -> Result<(), Rejection> {
        let driver = self.stage.driver(user);
        if self.kind == Kind::Open {
            let driving = if user == User::Salma { Driving::One(user) } else { Driving::Both };
            driver.drive(true);
            self.driving(driving);
            self.tell.say(&format!("{} gets a task and begins to drive; nobody decides", user.name()));
            return Ok(());
        }
        let points: Vec<_> = self
            .setting
            .course
            .waypoints(user)
            .iter()
            .map(|point| {
                json!({
                    "x_um": (point.x * 1e6).round() as i64, "y_um": (point.y * 1e6).round() as i64
                })
            })
            .collect();
        let task = json!({ "points": points, "requeue": true });
        let answer = call(self.cast.client(user), "submit", &[SERVICE, &task.to_string()]).await?;
        let id = answer.pointer("/task/id").and_then(Value::as_u64);
        let id = id.ok_or_else(|| Rejection::new(Code::Internal, "a task has no number").found(answer.to_string()))?;
        driver.drive(true);
        let [salma, farhad] = &mut self.tasks;
        *(if user == User::Salma { salma } else { farhad }) = Some(id);
        let runs = answer.get("grant").is_some_and(|grant| !grant.is_null());
        if runs {
            self.driving(Driving::One(user));
        }
        let how = if runs { "runs at once" } else { "waits in line; its commands are refused meanwhile" };
        self.tell.say(&format!("{}'s task {} {how}", user.name(), id));
        Ok(())
    }

    /// A controller has reached a waypoint: the ledger learns it, and what follows from it happens.
    async fn reached(&mut self, waypoint: Waypoint, at: Instant) -> Result<(), Rejection> {
        let pose = look(&self.stage.body).pose();
        self.record.reached.push(Reached { at: self.seconds(at), waypoint, pose });
        self.tell.say(&format!("{} is reached", waypoint.name()));
        let Waypoint { user, index } = waypoint;
        if let Some(task) = self.task(user) {
            let progress = [task.to_string(), (index + 1).to_string()];
            call(self.cast.client(user), "progress", &progress.each_ref().map(String::as_str)).await?;
            if index + 1 == WAYPOINTS {
                self.handed_over(user);
            }
        }
        if waypoint == (Waypoint { user: User::Salma, index: 0 }) {
            self.give_task(User::Farhad).await?;
        }
        if self.kind == Kind::Preempted && waypoint == (Waypoint { user: User::Farhad, index: 0 }) {
            self.stop_at = Some(Instant::now() + EMERGENCY_AFTER);
        }
        Ok(())
    }

    /// A task is done: the ledger gives the robot to the other one, if that waits.
    fn handed_over(&mut self, from: User) {
        let waits = User::ALL.into_iter().find(|user| *user != from && !self.stage.driver(*user).is_done());
        match waits.filter(|user| self.task(*user).is_some()) {
            Some(user) => {
                self.driving(Driving::One(user));
                self.tell.say(&format!("{}'s task is done; the robot is {}'s", from.name(), user.name()));
            }
            None => self.driving(Driving::Nobody),
        }
    }

    async fn stop(&mut self, network: &Network) -> Result<(), Rejection> {
        self.stop_at = None;
        let asked = Instant::now();
        call(&network.owner, "stop", &["Turtlebot4", "somebody walks into the arena"]).await?;
        self.tell.say("emergency stop; both go on commanding");
        self.driving(Driving::Nobody);
        let seconds = self.seconds(asked);
        self.record.emergency = Some(Emergency { asked: seconds, resumed: f64::INFINITY });
        self.resume_at = Some(asked + EMERGENCY);
        Ok(())
    }

    async fn resume(&mut self, network: &Network) -> Result<(), Rejection> {
        self.resume_at = None;
        let resumed = self.seconds(Instant::now());
        if let Some(emergency) = &mut self.record.emergency {
            emergency.resumed = resumed;
        }
        call(&network.owner, "resume", &["Turtlebot4"]).await?;
        self.driving(Driving::One(User::Farhad));
        self.tell.say("the robot may go on: by its priority Farhad's task is the first again");
        Ok(())
    }

    /// Ends what still runs, and watches the robot until it stands.
    async fn end(&mut self) {
        self.driving(Driving::Nobody);
        self.stage.drivers.iter().for_each(|driver| driver.drive(false));
        for user in User::ALL {
            if let Some(task) = self.task(user).filter(|_| !self.stage.driver(user).is_done()) {
                // It may have ended by itself: then there is nothing to cancel.
                let _ended = call(self.cast.client(user), "cancel", &[&task.to_string()]).await;
            }
        }
        tokio::time::sleep(AFTER_END).await;
    }

    fn task(&self, user: User) -> Option<u64> {
        let [salma, farhad] = self.tasks;
        if user == User::Salma { salma } else { farhad }
    }

    fn seconds(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.began).as_secs_f64()
    }

    fn driving(&mut self, driving: Driving) {
        let now = self.seconds(Instant::now());
        self.record.driving.push((now, driving));
    }

    fn show(&self) {
        let pose = look(&self.stage.body).pose();
        self.tell.show(&format!(
            "the robot is at ({:+.2}, {:+.2}), after {:.0} s",
            pose.at.x,
            pose.at.y,
            self.seconds(Instant::now())
        ));
    }

    /// Everything that was seen since the run began.
    fn written(mut self) -> Record {
        let since = |at: Instant| at.checked_duration_since(self.began).map(|since| since.as_secs_f64());
        let published = [User::Salma, User::Farhad].map(|user| (user, self.stage.driver(user).published()));
        let when = |user: User, number: usize| {
            let (_, times) = published.iter().find(|(of, _)| *of == user)?;
            since(*times.get(number)?)
        };
        let body = look(&self.stage.body);
        self.record.seen = body
            .seen
            .iter()
            .filter_map(|(at, pose, speed)| Some(Seen { at: since(*at)?, pose: *pose, speed: *speed }))
            .collect();
        self.record.heard = body
            .heard
            .iter()
            .filter_map(|(at, twist)| {
                let published = twist.user.and_then(|user| when(user, twist.number));
                Some(Heard { at: since(*at)?, user: twist.user, published, command: twist.command })
            })
            .collect();
        drop(body);
        for driver in &self.stage.drivers {
            let feedback = driver.feedback();
            self.record.feedback.extend(feedback.iter().filter(|(at, _)| since(*at).is_some()).map(|(_, age)| age));
        }
        self.record.published = published.iter().map(|(user, times)| (user.name(), times.len())).collect();
        self.record
    }
}

/// A call of abac, and its answer.
pub(crate) async fn call(client: &Client, function: &str, arguments: &[&str]) -> Result<Value, Rejection> {
    let arguments = arguments.iter().map(|argument| (*argument).to_owned().into()).collect();
    let committed = client.invoke("abac", function, arguments).await?;
    Ok(serde_json::from_slice(&committed.response).unwrap_or(Value::Null))
}

/// Waits for a moment; for ever if there is none.
async fn moment(at: Option<Instant>) {
    match at {
        Some(at) => sleep_until(at.into()).await,
        None => std::future::pending().await,
    }
}
