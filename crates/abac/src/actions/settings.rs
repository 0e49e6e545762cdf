//! Changing a robot: some of its settings (`configure`), or its whole description (`replace`). Both answer with what changed
//! and what ended; a grant that the new settings still allow goes on.

use super::robots::{self, ROBOTS_PER_SETUP_MAX};
use super::{attributes, describe, end, show};
use crate::arguments::{Arguments, shown};
use crate::policy::decider::Decider;
use crate::records::robot::{self, Robot};
use crate::records::service::{self, Service};
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{RobotChange, RobotSettings, ServiceSpec, SettingChange, Sharing};

/// Longest JSON of settings, in bytes: a stop message of 64 KiB in hexadecimal digits, and the rest.
const SETTINGS_BYTES_MAX: usize = 256 * 1024;

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

fn is_of_service(settings: &RobotSettings) -> bool {
    let of_robot = RobotSettings {
        attribute_required: settings.attribute_required.clone(),
        trusted: settings.trusted.clone(),
        attributes: settings.attributes.clone(),
        ..RobotSettings::default()
    };
    *settings != of_robot
}

/// The service as it is to be.
fn apply(settings: &RobotSettings, service: Service) -> Result<ServiceSpec, Rejection> {
    let Service { topic, type_name, mode, direction, max_age_ms, lease_ms, lease_ms_max, stop_hex, .. } = service;
    let (mut sharing, attributes) = (service.sharing, service.attributes);
    for key in &settings.clear {
        if !sharing.clear(key) {
            let keys: Vec<&str> = Sharing::keys().collect();
            return Err(Rejection::new(Code::BadArgument, "no setting of a rule has this name")
                .found(shown(key))
                .wanted(keys.join(", "))
                .next(did_you_mean(key, keys, "")));
        }
    }
    sharing.change(&settings.sharing);
    Ok(ServiceSpec {
        topic,
        type_name: settings.type_name.clone().unwrap_or(type_name),
        mode: Some(settings.mode.clone().unwrap_or(mode)),
        direction: settings.direction.unwrap_or(direction),
        max_age_ms: Some(settings.max_age_ms.unwrap_or(max_age_ms)),
        lease_ms: Some(settings.lease_ms.unwrap_or(lease_ms)),
        lease_ms_max: Some(settings.lease_ms_max.unwrap_or(lease_ms_max)),
        stop_hex: settings.stop_hex.clone().or(stop_hex).filter(|digits| !digits.is_empty()),
        sharing,
        attributes: (!attributes.is_empty()).then_some(attributes),
    })
}

/// `configure ROBOT[/TOPIC] SETTINGS_JSON`: changes some settings; by an admin of the robot's owner.
pub(crate) fn configure(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("configure ROBOT[/TOPIC] SETTINGS_JSON", args, 2, 2)?;
    let admin = robots::admin(ctx, "change robots")?;
    let id = args.text(0, "ROBOT[/TOPIC]")?;
    let wanted = "JSON of some of attribute_required, trusted, type, mode, direction, max_age_ms, lease_ms, lease_ms_max, \
                  stop_hex, sharing, clear, attributes";
    let bad = |found: String| args.bad(1, "SETTINGS_JSON", found, wanted);
    let settings: RobotSettings = serde_json::from_str(args.document(1, "SETTINGS_JSON", SETTINGS_BYTES_MAX)?)
        .map_err(|fault| bad(fault.to_string()))?;
    if settings == RobotSettings::default() {
        return Err(bad("nothing to change".to_owned()));
    }
    let (name, topic) = service::split(id);
    let before = robot::find(ctx, name)?;
    robots::check_owner(&before, admin)?;
    let mut after = before.clone();
    if is_of_service(&settings) || !topic.is_empty() {
        let target = service::resolve(ctx, id)?;
        if target.is_for_readers() {
            let service = target.service_id();
            return Err(Rejection::new(
                Code::BadArgument,
                format!("the places {} have no settings of their own", target.id),
            )
            .found("places of subscribers")
            .wanted(service)
            .next(format!("set those of the service: ledgerctl robot set {service} KEY=VALUE")));
        }
        for service in after.services.iter_mut().filter(|service| service.topic == target.service.topic) {
            if let (Some(changes), false) = (&settings.attributes, topic.is_empty()) {
                attributes::change(&mut service.attributes, changes, attributes::OF_SERVICE_BYTES_MAX)?;
            }
            *service = describe::check_service(decider, apply(&settings, service.clone())?)?;
        }
    }
    if let (Some(changes), true) = (&settings.attributes, topic.is_empty()) {
        attributes::change(&mut after.attributes, changes, attributes::OF_ROBOT_BYTES_MAX)?;
    }
    if let Some(required) = &settings.attribute_required {
        after.attribute_required = describe::check_attribute(required)?;
    }
    if let Some(trusted) = settings.trusted {
        after.trusted = describe::check_trusted(ctx, trusted)?;
    }
    store::json(&change(ctx, decider, Some(before), after)?)
}

/// `replace ROBOT_JSON...`: as `setup`, also for robots that exist; by an admin of their owner.
pub(crate) fn replace(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("replace ROBOT_JSON...", args, 1, ROBOTS_PER_SETUP_MAX)?;
    let admin = robots::admin(ctx, "change robots")?;
    let mut changes = Vec::new();
    for index in 0..args.rest(0).len() {
        let spec = describe::read_spec(args, index)?;
        let before = robots::registered(ctx, &spec.name)?;
        if let Some(robot) = &before {
            robots::check_owner(robot, admin)?;
        }
        let after = describe::describe(ctx, decider, &admin.organisation, spec, before.as_ref())?;
        changes.push(change(ctx, decider, before, after)?);
    }
    store::json(&changes)
}

/// Puts the robot in the place of what it was. If it is the same, nothing is written or told. Its grants are decided
/// again all the same: a policy that speaks of the time may have stopped permitting one.
fn change(
    ctx: &mut Context<'_>,
    decider: &Decider,
    before: Option<Robot>,
    after: Robot,
) -> Result<RobotChange, Rejection> {
    let changed = before.as_ref().map_or_else(Vec::new, |before| differences(before, &after));
    let ended = match &before {
        Some(before) if changed.is_empty() => end::robot_changed(ctx, decider, before, before)?,
        before => robots::put(ctx, decider, before.as_ref(), after.clone())?,
    };
    Ok(RobotChange { robot: show::asset(ctx, decider, &robot::find(ctx, &after.name)?)?, changed, ended })
}

fn differences(before: &Robot, after: &Robot) -> Vec<SettingChange> {
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
