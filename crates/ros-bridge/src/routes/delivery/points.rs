//! The points of the robot's running task on local topics, for a controller that needs no ledger client.
//!
//! Two topics, either or both: the next point as a `geometry_msgs/msg/PoseStamped`, and all that are left as a
//! `nav_msgs/msg/Path`. They come from what the voters have signed. While a task is shown its robot is asked about all the time, as
//! while somebody moves it; without an answer the path becomes empty.

use std::time::{Duration, Instant};

use ledger_base::rejection::{Code, Rejection};
use ledger_base::settings::Section;
use ledger_contract::{Point, RunningTask};
use serde_json::{Value, json};

use crate::{
    graph::{local::LocalGraph, mark::Mark, names::TopicName},
    routes::shown::LatchedTopic,
};

/// The settings of the topics.
pub(in crate::routes) const KEYS: [&str; 2] = ["goal_topic", "path_topic"];
/// The next point.
const GOAL: &str = "geometry_msgs/msg/PoseStamped";
/// The points that are left.
const PATH: &str = "nav_msgs/msg/Path";
/// So often the voters are asked within the time after which silence empties the path.
const ASKS: u32 = 3;

/// The topics of a route for points.
#[derive(Debug, Clone, Default)]
pub(in crate::routes) struct Topics {
    goal: Option<TopicName>,
    path: Option<TopicName>,
}

impl Topics {
    /// Reads the settings under [`KEYS`].
    pub(in crate::routes) fn read(section: &mut Section<'_, '_>) -> Self {
        let mut topics = Self::default();
        for (key, topic) in KEYS.into_iter().zip([&mut topics.goal, &mut topics.path]) {
            section.parsed(key, "a ROS 2 topic name", topic, |text| TopicName::parse(text).map(Some));
        }
        topics
    }

    /// Is nothing to be shown?
    pub(in crate::routes) fn is_empty(&self) -> bool {
        self.goal.is_none() && self.path.is_none()
    }

    /// The topics that are set.
    pub(in crate::routes) fn names(&self) -> impl Iterator<Item = &TopicName> {
        [&self.goal, &self.path].into_iter().flatten()
    }

    /// Offers the topics. `of` is the topic of the route, which is not for points.
    pub(in crate::routes) async fn open(
        &self,
        local: &LocalGraph,
        of: &TopicName,
        mark: Mark,
    ) -> Result<Points, Rejection> {
        if self.names().any(|topic| topic == of) || self.goal.is_some() && self.goal == self.path {
            let found: Vec<_> = self.names().chain([of]).map(TopicName::as_str).collect();
            return Err(Rejection::new(Code::BadConfiguration, "two kinds of messages cannot share a topic")
                .found(found.join(", "))
                .wanted("goal_topic, path_topic and the topic of the route to be different")
                .next("give each a topic of its own, e.g. goal_topic = \"/goal_pose\""));
        }
        Ok(Points {
            goal: LatchedTopic::open(self.goal.as_ref(), GOAL, local, mark).await?,
            path: LatchedTopic::open(self.path.as_ref(), PATH, local, mark).await?,
            shown: None,
            runs: false,
            known: Instant::now(),
        })
    }
}

/// The topics, and the task that they show.
pub(in crate::routes) struct Points {
    goal: Option<LatchedTopic>,
    path: Option<LatchedTopic>,
    /// The task and how many of its points were reached; none until something was shown.
    shown: Option<Option<(u64, u64)>>,
    /// Did a task run by the last answer?
    runs: bool,
    /// When that was asked which is shown, or since when nothing is.
    known: Instant,
}

impl Points {
    /// Shows the task that runs, by an answer to a question of that time.
    pub(in crate::routes) fn show(&mut self, task: Option<&RunningTask>, asked: Instant) {
        // A question from before the last stop may have been answered before the task ended.
        if asked < self.known {
            return;
        }
        (self.known, self.runs) = (asked, task.is_some());
        self.publish(task);
    }

    /// Shows no task until the next answer: the robot stops, or nobody says how it stands.
    pub(in crate::routes) fn clear(&mut self) {
        self.known = Instant::now();
        self.publish(None);
    }

    /// When the voters are to be asked again, and when nothing may be shown without an answer. None while no task
    /// runs.
    pub(in crate::routes) fn due(&self, stale_after: Duration) -> Option<(Instant, Instant)> {
        self.runs.then(|| (self.known + stale_after / ASKS, self.known + stale_after))
    }

    fn publish(&mut self, task: Option<&RunningTask>) {
        let now = task.map(|task| (task.id, task.reached));
        if self.shown == Some(now) {
            return;
        }
        let goal = self.goal.as_ref().zip(task.and_then(goal)).map_or(Ok(()), |(topic, goal)| topic.write(&goal));
        let path = self.path.as_ref().map_or(Ok(()), |topic| topic.write(&path(task)));
        // What failed is tried again with the next answer.
        self.shown = Some(now).filter(|_| goal.is_ok() && path.is_ok());
        for fault in [goal, path].into_iter().filter_map(Result::err) {
            tracing::warn!(reason = fault, "the points of the task were not published");
        }
    }
}

/// The next point, if one is left.
fn goal(task: &RunningTask) -> Option<Value> {
    task.next.first().map(|point| pose(&task.frame, point))
}

/// The points that are left; none without a task.
fn path(task: Option<&RunningTask>) -> Value {
    let frame = task.map_or("", |task| &task.frame);
    let poses: Vec<_> = task.iter().flat_map(|task| &task.next).map(|point| pose(frame, point)).collect();
    json!({ "header": header(frame), "poses": poses })
}

/// A stamp of zero: transforms are those of the moment in which the controller looks.
fn header(frame: &str) -> Value {
    json!({ "frame_id": frame })
}

#[expect(clippy::cast_precision_loss, reason = "coordinates are below 2⁵³ µm")]
fn pose(frame: &str, Point { x_um, y_um, yaw_urad }: &Point) -> Value {
    let [x, y, half] = [(x_um, 1.0), (y_um, 1.0), (yaw_urad, 2.0)].map(|(&micro, by)| micro as f64 / 1e6 / by);
    let orientation = json!({ "x": 0.0, "y": 0.0, "z": half.sin(), "w": half.cos() });
    json!({ "header": header(frame), "pose": { "position": { "x": x, "y": y, "z": 0.0 }, "orientation": orientation } })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::graph::messages::builtin;

    fn task(next: &[(i64, i64, i64)]) -> RunningTask {
        let next = next.iter().map(|&(x_um, y_um, yaw_urad)| Point { x_um, y_um, yaw_urad }).collect();
        RunningTask { id: 7, service: "T/cmd_vel".into(), frame: "map".into(), reached: 1, next }
    }

    fn written(name: &str, value: &Value) -> String {
        let message = builtin::of(name).unwrap();
        let sample = builtin::sample(&message, value).unwrap();
        message.decode(sample.wire()).unwrap().to_yaml(None)
    }

    #[test]
    fn the_next_point_is_a_pose_in_the_frame_of_the_task() {
        let quarter = 1_570_796;
        let yaml = written(GOAL, &goal(&task(&[(-1_500_000, 2_250_000, quarter), (0, 0, 0)])).unwrap());
        for wanted in ["frame_id: map", "sec: 0", "x: -1.5", "y: 2.25", "z: 0.70710", "w: 0.70710"] {
            assert!(yaml.contains(wanted), "{wanted}: {yaml}");
        }
    }

    #[test]
    fn a_path_holds_the_points_that_are_left_and_is_empty_without_a_task() {
        let yaml = written(PATH, &path(Some(&task(&[(1_000_000, 0, 0), (2_000_000, 0, 0)]))));
        assert_eq!(yaml.matches("position:").count(), 2, "{yaml}");
        assert!(yaml.find("x: 1").unwrap() < yaml.find("x: 2").unwrap(), "in their order: {yaml}");
        assert!(written(PATH, &path(None)).contains("poses: []"));
    }

    #[test]
    fn a_task_without_points_left_has_no_goal() {
        assert_eq!(goal(&task(&[])), None);
    }

    #[test]
    fn an_answer_from_before_the_last_stop_shows_no_task_again_but_the_next_one_does() {
        let mut points = Points { goal: None, path: None, shown: None, runs: false, known: Instant::now() };
        let (task, before) = (task(&[(0, 0, 0)]), Instant::now());
        points.show(Some(&task), before);
        assert_eq!(points.shown, Some(Some((7, 1))));
        points.clear();
        points.show(Some(&task), before);
        assert_eq!(points.shown, Some(None));
        points.show(Some(&task), Instant::now());
        assert_eq!(points.shown, Some(Some((7, 1))));
    }

    #[test]
    fn the_voters_are_asked_until_they_say_that_no_task_runs() {
        let mut points = Points { goal: None, path: None, shown: None, runs: false, known: Instant::now() };
        let (asked, stale_after) = (Instant::now(), Duration::from_secs(3));
        assert_eq!(points.due(stale_after), None);
        points.show(Some(&task(&[(0, 0, 0)])), asked);
        assert_eq!(points.due(stale_after), Some((asked + Duration::from_secs(1), asked + stale_after)));
        points.clear();
        assert!(points.due(stale_after).is_some());
        points.show(None, Instant::now());
        assert_eq!(points.due(stale_after), None);
    }
}
