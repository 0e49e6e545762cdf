//! The change of a robot, setting by setting.

use crate::calls::{attributes, views};
use crate::lifecycle::{ends, registration};
use crate::policy::decider::Decider;
use crate::records::robot;
use crate::records::robot::Robot;
use crate::records::service::Service;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::{RobotChange, SettingChange, Sharing};

/// The name of a setting, and its value for people.
type Setting<T> = (&'static str, fn(&T) -> String);

/// The settings of a service.
const OF_SERVICE: [Setting<Service>; 7] = [
    ("type", |service| service.type_name.clone()),
    ("mode", |service| service.mode.to_string()),
    ("direction", |service| service.direction.to_string()),
    ("max_age_ms", |service| service.max_age_ms.to_string()),
    ("lease_ms", |service| service.lease_ms.to_string()),
    ("lease_ms_max", |service| service.lease_ms_max.to_string()),
    ("stop_hex", |service| service.stop_hex.clone().unwrap_or_default()),
];

/// The settings of a robot.
const OF_ROBOT: [Setting<Robot>; 2] =
    [("attribute_required", |robot| robot.attribute_required.clone()), ("trusted", |robot| robot.trusted.join(", "))];

/// Puts the robot in the place of what it was. If it is the same, nothing is written or told. Its grants are decided
/// again all the same: a policy that speaks of the time may have stopped permitting one.
pub(crate) fn change(
    ctx: &mut Context<'_>,
    decider: &Decider,
    before: Option<Robot>,
    after: Robot,
) -> Result<RobotChange, Rejection> {
    let changed = before.as_ref().map_or_else(Vec::new, |before| differences(before, &after));
    let ended = match &before {
        Some(before) if changed.is_empty() => ends::robot_changed(ctx, decider, before, before)?,
        before => registration::put(ctx, decider, before.as_ref(), after.clone())?,
    };
    Ok(RobotChange { robot: views::asset(ctx, decider, &robot::find(ctx, &after.name)?)?, changed, ended })
}

/// The settings that have another value.
pub(crate) fn differences(before: &Robot, after: &Robot) -> Vec<SettingChange> {
    let mut changes = Vec::new();
    let mut note = |topic: &str, setting: &str, before: String, after: String| {
        if before != after {
            changes.push(SettingChange { topic: topic.to_owned(), setting: setting.to_owned(), before, after });
        }
    };
    for (setting, value) in OF_ROBOT {
        note("", setting, value(before), value(after));
    }
    attributes::differences(&before.attributes, &after.attributes, |name, before, after| note("", name, before, after));
    let same = |services: &[Service], topic: &str| services.iter().find(|service| service.topic == topic).cloned();
    for service in &before.services {
        match same(&after.services, &service.topic) {
            Some(now) => {
                for (setting, value) in OF_SERVICE {
                    note(&service.topic, setting, value(service), value(&now));
                }
                for key in Sharing::keys() {
                    note(&service.topic, key, service.sharing.shown(key), now.sharing.shown(key));
                }
                attributes::differences(&service.attributes, &now.attributes, |name, before, after| {
                    note(&service.topic, name, before, after);
                });
            }
            None => note(&service.topic, "service", service.type_name.clone(), String::new()),
        }
    }
    for service in &after.services {
        if same(&before.services, &service.topic).is_none() {
            note(&service.topic, "service", String::new(), service.type_name.clone());
        }
    }
    changes
}
