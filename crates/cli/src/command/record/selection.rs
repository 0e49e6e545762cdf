//! The services to record, and the channels of a file that they get.

use crate::answer;
use crate::session::{ABAC, Session};
use crate::words::Words;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{RobotAsset, ServiceState};
use std::collections::BTreeSet;

/// The words of the command line where the chaincode has other names.
const WORDS: Words = Words { arguments: &[("ROBOT", "the robot")], help: "ledgerctl record" };

/// The services, each once, and the state that named them.
pub(super) struct Selection {
    pub(super) services: Vec<Chosen>,
    /// The robots that offer them.
    pub(super) robots: BTreeSet<String>,
    /// Height of that state: everything that anybody was told before is in it.
    pub(super) height: u64,
    /// Its block time, microseconds since the UNIX epoch.
    pub(super) time: u64,
}

/// A service and its channel.
pub(super) struct Chosen {
    pub(super) service: ServiceState,
    pub(super) topic: String,
}

impl Selection {
    /// Finds what was named: services, and robots for all their services.
    ///
    /// # Errors
    /// As the ledger says that there is none of this name; [`Code::BadArgument`] if two would share a channel.
    pub(super) async fn find(session: &Session, names: &[String], plain: bool) -> Result<Self, Rejection> {
        let mut found = Self { services: Vec::new(), robots: BTreeSet::new(), height: 0, time: 0 };
        for name in names {
            let function = if name.contains('/') { "service" } else { "robot" };
            let told = session.client.query(ABAC, function, vec![Bytes::from(name.clone())]).await;
            let told = told.map_err(|refused| WORDS.told(refused))?;
            (found.height, found.time) = (told.height, told.time);
            if function == "service" {
                found.add(answer::parse(&told.response, "a service")?, plain)?;
                continue;
            }
            let robot: RobotAsset = answer::parse(&told.response, "a robot")?;
            if robot.services.is_empty() {
                return Err(Rejection::new(Code::UnknownService, format!("{name} offers no service"))
                    .wanted("a robot with services")
                    .next("ledgerctl robot list"));
            }
            for service in robot.services {
                found.add(service, plain)?;
            }
        }
        Ok(found)
    }

    fn add(&mut self, service: ServiceState, plain: bool) -> Result<(), Rejection> {
        if self.services.iter().any(|chosen| chosen.service.service == service.service) {
            return Ok(());
        }
        let topic = if plain { service.topic.clone() } else { format!("/{}{}", part(&service.robot), service.topic) };
        if let Some(other) = self.services.iter().find(|chosen| chosen.topic == topic) {
            let (one, two) = (&other.service.service, &service.service);
            let next = if plain { "leave --plain-topics out" } else { "record them into two files" };
            return Err(Rejection::new(Code::BadArgument, format!("{one} and {two} would share a channel"))
                .found(topic)
                .wanted("a channel for each service")
                .next(next));
        }
        self.robots.insert(service.robot.clone());
        self.services.push(Chosen { service, topic });
        Ok(())
    }
}

/// The name of a robot as a part of a topic, which has fewer signs to choose from.
fn part(robot: &str) -> String {
    let mut part = String::with_capacity(robot.len());
    for c in robot.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }) {
        if c != '_' || !part.ends_with('_') {
            part.push(c);
        }
    }
    if part.starts_with(|c: char| c.is_ascii_digit()) { format!("_{part}") } else { part }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robots_name_becomes_a_part_of_a_topic() {
        for (robot, wanted) in
            [("Turtlebot4", "Turtlebot4"), ("arm-7.left", "arm_7_left"), ("a_-b", "a_b"), ("4wd", "_4wd")]
        {
            assert_eq!(part(robot), wanted);
        }
    }
}
