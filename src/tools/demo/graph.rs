//! The ROS 2 nodes of the demo: operators that publish `/cmd_vel`, and the robot that listens to it. They know nothing
//! of any ledger.

use super::messages::Command;
use super::messages::{Twist, read_twist, twist};
use super::user::User;
use ledger_base::rejection::{Code, Rejection};
use ros_bridge::dds::{Participant, Reader, Writer};
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::Limits;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval};

/// Time for two participants to find each other.
pub const DISCOVERY_TIME_MAX: Duration = Duration::from_secs(15);
/// The speed that the operators publish (m/s).
const SPEED: f64 = 0.2;

/// A Twist that the robot received.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Received {
    /// The publisher; none for a stop message.
    pub operator: Option<User>,
    /// Its number.
    pub number: usize,
    /// When.
    pub at: Instant,
}

/// A fault of the middleware, for people.
pub fn failed(error: &ros_bridge::error::Error) -> Rejection {
    Rejection::new(Code::MiddlewareFailed, error.to_string())
}

/// The topic of the robot's commands.
pub fn cmd_vel() -> Result<(TopicName, TypeName), Rejection> {
    let topic = TopicName::parse("/cmd_vel").map_err(|error| failed(&error))?;
    let kind = TypeName::parse("geometry_msgs/msg/Twist").map_err(|error| failed(&error))?;
    Ok((topic, kind))
}

/// A node that publishes `/cmd_vel` at a steady rate.
pub struct Publisher {
    _participant: Participant,
    writer: Writer,
    operator: User,
    /// How much it has published, which is the number of the next message.
    published: Arc<AtomicUsize>,
}

impl Publisher {
    /// Joins a ROS 2 domain.
    pub async fn open(domain: u16, operator: User) -> Result<Self, Rejection> {
        let (topic, kind) = cmd_vel()?;
        let name = format!("{operator:?}_teleop").to_lowercase();
        let participant = Participant::open(domain, &name).await.map_err(|error| failed(&error))?;
        let writer = participant.writer(&topic, &kind, &Qos::default()).map_err(|error| failed(&error))?;
        Ok(Self { _participant: participant, writer, operator, published: Arc::default() })
    }

    /// Waits until somebody listens.
    pub async fn matched(&mut self) -> Result<(), Rejection> {
        let matched = self.writer.matched();
        tokio::time::timeout(DISCOVERY_TIME_MAX, matched.at_least(1))
            .await
            .map(drop)
            .map_err(|_| nobody_there("the operator's bridge"))
    }

    /// Publishes at `hz` for a while, on a fixed schedule; answers with the time of each message, by number.
    pub async fn publish(&mut self, hz: u32, how_long: Duration) -> Result<Vec<Instant>, Rejection> {
        let period = Duration::from_secs(1) / hz;
        let count = usize::try_from(how_long.as_nanos() / period.as_nanos()).unwrap_or(usize::MAX);
        let mut schedule = interval(period);
        schedule.set_missed_tick_behavior(MissedTickBehavior::Burst);
        let mut times = Vec::with_capacity(count);
        for _ in 0..count {
            schedule.tick().await;
            let command = Command { linear: SPEED, angular: 0.0 };
            let sample = twist(command, self.next_number(), self.operator)?;
            times.push(Instant::now());
            self.writer.write(&sample).map_err(|error| failed(&error))?;
            self.published.fetch_add(1, Ordering::Relaxed);
        }
        Ok(times)
    }

    /// The number that the next message will have.
    pub fn next_number(&self) -> usize {
        self.published.load(Ordering::Relaxed)
    }

    /// How much it has published, for whoever watches.
    pub fn published(&self) -> Arc<AtomicUsize> {
        Arc::clone(&self.published)
    }
}

/// The robot: keeps every Twist that it receives.
pub struct Robot {
    _participant: Participant,
    matched: ros_bridge::dds::Matched,
    received: Arc<Mutex<Vec<Received>>>,
    task: JoinHandle<()>,
}

impl Robot {
    /// Joins a ROS 2 domain and listens to `/cmd_vel`.
    pub async fn open(domain: u16) -> Result<Self, Rejection> {
        let (topic, kind) = cmd_vel()?;
        let participant = Participant::open(domain, "turtlebot4_base").await.map_err(|error| failed(&error))?;
        let mut reader: Reader =
            participant.reader(&topic, &kind, &Qos::default(), Limits::default()).map_err(|error| failed(&error))?;
        let matched = reader.matched().clone();
        let received = Arc::new(Mutex::new(Vec::new()));
        let kept = Arc::clone(&received);
        let task = tokio::spawn(async move {
            while let Some(incoming) = reader.next().await {
                if let Some(Twist { user, number, .. }) = read_twist(&incoming.sample.body()) {
                    let received = Received { operator: user, number, at: incoming.received };
                    kept.lock().unwrap_or_else(PoisonError::into_inner).push(received);
                }
            }
        });
        Ok(Self { _participant: participant, matched, received, task })
    }

    /// Waits until the robot's bridge is there.
    pub async fn matched(&mut self) -> Result<(), Rejection> {
        tokio::time::timeout(DISCOVERY_TIME_MAX, self.matched.at_least(1))
            .await
            .map(drop)
            .map_err(|_| nobody_there("the robot's bridge"))
    }

    /// How many of an operator's messages were received since the last [`Robot::take`].
    pub fn received_from(&self, operator: User) -> usize {
        let received = self.received.lock().unwrap_or_else(PoisonError::into_inner);
        received.iter().filter(|message| message.operator == Some(operator)).count()
    }

    /// The samples received so far; starts anew.
    pub fn take(&self) -> Vec<Received> {
        std::mem::take(&mut *self.received.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// The rejection of a wait for another side that was not discovered.
pub fn nobody_there(who: &str) -> Rejection {
    Rejection::new(Code::MiddlewareFailed, format!("{who} was not discovered on the ROS 2 graph"))
        .wanted(format!("a match on /cmd_vel within {DISCOVERY_TIME_MAX:?}"))
        .next("check that UDP traffic on the loopback interface is allowed")
}
