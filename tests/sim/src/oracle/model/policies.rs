//! The word of an owner's policies, and where it has none of its own.

use super::services::{Robot, Service};
use super::{Model, Person};
use crate::policy::{Act, Asked, Policy, Says};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use std::collections::BTreeSet;

impl Model {
    /// Do the policies let them hold a service, or publish on it? From a place of a subscriber one reads.
    pub(super) fn permits(&self, who: &Person, robot: &Robot, service: &Service, time: u64) -> Result<(), Code> {
        let act = if service.reads { Act::Subscribe } else { Act::Use };
        let mut said = self.said(who, robot, act, time);
        let name = who.id();
        let asked = asked(who, &name, robot, act, time);
        if said.is_empty() {
            said.push(Policy::Attribute.says(&asked));
            // The people and machines that carry the owner's robots read what they send.
            let carries = matches!(who.identity.role, Role::Admin | Role::Node | Role::Robot);
            if act == Act::Subscribe && carries && who.identity.organisation == robot.owner {
                said.push(Says::Permit);
            }
        }
        if said.contains(&Says::Error) {
            Err(Code::PolicyError)
        } else if said.contains(&Says::Forbid) {
            Err(Code::DeniedByPolicy)
        } else if said.contains(&Says::Permit) {
            Ok(())
        } else if asked.trusted && !asked.attribute && self.ask_for_the_attribute(robot) {
            Err(Code::MissingAttribute)
        } else {
            Err(Code::DeniedByPolicy)
        }
    }

    /// Do the owner's policies look at the attribute that the robot requires?
    fn ask_for_the_attribute(&self, robot: &Robot) -> bool {
        let mut own = self.policies.iter().filter(|((organisation, _), _)| *organisation == robot.owner).peekable();
        own.peek().is_none() || own.any(|(_, policy)| *policy == Policy::Attribute)
    }

    /// May they do to a robot what its owner's admins always may, and others only by a policy?
    pub(super) fn governs(&self, who: &Person, robot: &Robot, time: u64) -> Result<(), Code> {
        if who.identity.role == Role::Admin && who.identity.organisation == robot.owner {
            return Ok(());
        }
        // The default policy permits none of it to anybody who is simulated.
        let said = self.said(who, robot, Act::Govern, time);
        if said.contains(&Says::Error) {
            Err(Code::PolicyError)
        } else if said.contains(&Says::Permit) && !said.contains(&Says::Forbid) {
            Ok(())
        } else {
            Err(Code::DeniedByPolicy)
        }
    }

    /// May they stop a robot? By rule it may itself, and those who hold one of its command services: no policy of the collection
    /// forbids stop by name.
    pub(super) fn may_stop(&self, who: &Person, robot: &Robot, time: u64) -> Result<(), Code> {
        let mut commands = robot.services.iter().map(|service| format!("{}{}", robot.name, service.topic));
        let holds = commands.any(|id| self.live(&id, time).iter().any(|grant| grant.holder == who.id()));
        if holds || who.is_robot(&robot.owner, &robot.name) { Ok(()) } else { self.governs(who, robot, time) }
    }

    /// May they read the messages of a service now?
    pub(in crate::oracle) fn may_read(&self, who: &Person, id: &str, time: u64) -> Result<(), Code> {
        let (robot, service) = self.find(id)?;
        let Some(places) = service.places_to_read() else {
            let reading = Service { reads: true, ..service };
            return self.permits(who, &robot, &reading, time);
        };
        self.permits(who, &robot, &places, time)?;
        let carries = matches!(who.identity.role, Role::Robot | Role::Node) && who.identity.organisation == robot.owner;
        let has_place = self.own(who, &format!("{id}:subscribe"), time).is_some();
        if carries || has_place { Ok(()) } else { Err(Code::NotHolder) }
    }

    /// The robots of this owner to which nobody with a certificate of a CA of the network may publish.
    pub(super) fn unreachable(&self, owner: &str, time: u64) -> BTreeSet<String> {
        let people: Vec<&Person> = self.certified(time).collect();
        let may =
            |robot: &Robot, service: &Service| people.iter().any(|who| self.permits(who, robot, service, time).is_ok());
        let unreachable = |robot: &Robot| {
            let mut commands = robot.services.iter().filter(|service| !service.reads).peekable();
            commands.peek().is_some() && !commands.any(|service| may(robot, service))
        };
        let robots = self.robots.values().filter(|robot| robot.owner == owner && !people.is_empty());
        robots.filter(|robot| unreachable(robot)).map(|robot| robot.name.clone()).collect()
    }

    /// The word of the owner's own policies to anything that they want to do with a robot.
    fn said(&self, who: &Person, robot: &Robot, act: Act, time: u64) -> Vec<Says> {
        let name = who.id();
        let asked = asked(who, &name, robot, act, time);
        let own = self.policies.iter().filter(|((organisation, _), _)| *organisation == robot.owner);
        own.map(|(_, policy)| policy.says(&asked)).collect()
    }
}

/// A question about a robot.
fn asked<'a>(who: &Person, name: &'a str, robot: &Robot, act: Act, time: u64) -> Asked<'a> {
    let attribute = who.identity.attributes.get(&robot.attribute_required).is_some_and(|value| value == "true");
    let trusted = robot.trusted.contains(&who.identity.organisation);
    Asked { who: name, trusted, attribute, time_ms: time / 1000, act }
}
