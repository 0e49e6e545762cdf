//! The topic of a robot's commands, samples for it that tell themselves apart, and a reader that is asked for the next one.

use ledger_gate::sample::{CDR_LE, Sample};
use ros_bridge::{
    dds::Reader,
    names::{TopicName, TypeName},
    qos::{Durability, Qos, Reliability},
    queue::Incoming,
};
use rustdds::{QosPolicies, QosPolicyBuilder, policy};
use std::time::Duration;

/// A machine with other work is slow, and not broken.
pub(crate) const DEADLINE: Duration = Duration::from_secs(60);

pub(crate) fn topic() -> TopicName {
    TopicName::parse("/cmd_vel").unwrap()
}

pub(crate) fn twist() -> TypeName {
    TypeName::parse("geometry_msgs/msg/Twist").unwrap()
}

pub(crate) fn numbered(number: u32) -> Sample {
    Sample::new(CDR_LE, &number.to_le_bytes().repeat(12)).unwrap()
}

pub(crate) async fn next(reader: &mut Reader) -> Incoming {
    tokio::time::timeout(DEADLINE, reader.next()).await.unwrap().unwrap()
}

/// The policies of a participant of RustDDS with this quality of service.
pub(crate) fn rust_dds(qos: &Qos) -> QosPolicies {
    let depth = i32::try_from(qos.depth).unwrap();
    let builder = QosPolicyBuilder::new().history(policy::History::KeepLast { depth });
    let builder = builder.durability(match qos.durability {
        Durability::Volatile => policy::Durability::Volatile,
        Durability::TransientLocal => policy::Durability::TransientLocal,
    });
    match qos.reliability {
        Reliability::Reliable => builder.reliable(rustdds::Duration::ZERO).build(),
        Reliability::BestEffort => builder.best_effort().build(),
    }
}
