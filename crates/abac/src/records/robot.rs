//! Robots: what an organisation registers.

use super::service::Service;
use super::store;
use crate::arguments::shown;
use bytes::Bytes;
use ledger::Context;
use ledger_base::hash::Hash;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Attributes;
use ledger_identity::{Identity, Role};
use serde::{Deserialize, Serialize};

/// Most robots of which one is suggested to who mistypes a name.
const SUGGESTED_MAX: usize = 64;
/// Most services of one robot.
pub(crate) const SERVICES_MAX: usize = 64;
/// Longest robot name, in bytes.
const NAME_BYTES_MAX: usize = 64;

/// Checks that a name is one that a robot can have.
///
/// # Errors
/// [`Code::BadName`].
pub(crate) fn check_name(name: &str) -> Result<(), Rejection> {
    let allowed = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'-' | b'.');
    if (1..=NAME_BYTES_MAX).contains(&name.len()) && name.bytes().all(allowed) {
        return Ok(());
    }
    Err(Rejection::new(Code::BadName, "the name of the robot is not usable")
        .found(shown(name))
        .wanted(format!("1 to {NAME_BYTES_MAX} letters, digits, \"_\", \"-\" and \".\"")))
}

/// A registered robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Robot {
    pub(crate) name: String,
    /// The organisation that owns it.
    pub(crate) organisation: String,
    /// `KEY=VALUE`.
    pub(crate) attribute_required: String,
    /// Sorted.
    pub(crate) trusted: Vec<String>,
    /// In the order of the owner's description.
    pub(crate) services: Vec<Service>,
    /// Facts for policies.
    #[serde(default, skip_serializing_if = "Attributes::is_empty")]
    pub(crate) attributes: Attributes,
    /// Hash over all of the above: names this state of the robot in caches.
    pub(crate) version: Hash,
}

impl Robot {
    /// The id of one of its services.
    pub(crate) fn service_id(&self, service: &Service) -> String {
        format!("{}{}", self.name, service.topic)
    }

    /// Is it the robot itself who calls?
    pub(crate) fn is(&self, caller: &Identity) -> bool {
        caller.role == Role::Robot && caller.organisation == self.organisation && caller.name == self.name
    }

    /// Name and value of the required attribute.
    pub(crate) fn required(&self) -> (&str, &str) {
        self.attribute_required.split_once('=').unwrap_or((&self.attribute_required, "true"))
    }
}

/// All registered robots in order of their names.
pub(crate) fn all(ctx: &Context<'_>) -> Result<Vec<Robot>, Rejection> {
    ctx.range(b"robot/", usize::MAX).iter().map(|(key, value)| store::parse(key, value)).collect()
}

/// The robot of that name.
///
/// # Errors
/// [`Code::UnknownRobot`] with the nearest name.
pub(crate) fn find(ctx: &Context<'_>, name: &str) -> Result<Robot, Rejection> {
    if name.len() <= NAME_BYTES_MAX
        && let Some(robot) = store::read(ctx, &store::robot_key(name))?
    {
        return Ok(robot);
    }
    let keys = ctx.range(b"robot/", SUGGESTED_MAX);
    let names = keys.iter().filter_map(|(key, _)| std::str::from_utf8(key).ok()?.strip_prefix("robot/"));
    Err(Rejection::new(Code::UnknownRobot, format!("no robot {} is registered", shown(name)))
        .found(shown(name))
        .wanted("the name of a registered robot")
        .next(did_you_mean(name, names, "ledgerctl robot list")))
}

/// The names of the robots of an organisation, in order.
pub(crate) fn names_of(ctx: &Context<'_>, organisation: &str) -> Vec<String> {
    let prefix = store::owned_prefix(organisation);
    let keys = ctx.range(&prefix, usize::MAX);
    keys.iter().filter_map(|(key, _)| String::from_utf8(key.strip_prefix(&prefix[..])?.to_vec()).ok()).collect()
}

/// Writes a robot with the hash that names this state of it.
pub(crate) fn write(ctx: &mut Context<'_>, robot: &mut Robot) -> Result<(), Rejection> {
    robot.version = Hash::ZERO;
    robot.version = Hash::of(&[&store::json(&robot)?]);
    ctx.put(&store::owned_key(&robot.organisation, &robot.name), Bytes::new());
    store::write(ctx, &store::robot_key(&robot.name), &robot)
}

/// Removes a robot.
pub(crate) fn remove(ctx: &mut Context<'_>, robot: &Robot) {
    ctx.delete(&store::owned_key(&robot.organisation, &robot.name));
    ctx.delete(&store::robot_key(&robot.name));
}
