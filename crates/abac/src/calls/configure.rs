//! `configure`: changing settings of a robot or a service.

use crate::arguments::{Arguments, shown};
use crate::calls::{attributes, description, robot_change};
use crate::lifecycle::robots;
use crate::policy::decider::Decider;
use crate::records::service::Service;
use crate::records::store;
use crate::records::{robot, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{RobotSettings, ServiceSpec, Sharing};

/// Longest JSON of settings, in bytes: a stop message of 64 KiB in hexadecimal digits, and the rest.
const SETTINGS_BYTES_MAX: usize = 256 * 1024;

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
            return Err(Rejection::new(Code::BadArgument, "there is no rule setting of this name")
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
    let (name, topic) = target::split(id);
    let before = robot::find(ctx, name)?;
    robots::check_owner(&before, admin)?;
    let mut after = before.clone();
    if is_of_service(&settings) || !topic.is_empty() {
        let target = target::resolve(ctx, id)?;
        if target.is_for_readers() {
            let service = target.service_id();
            return Err(Rejection::new(
                Code::BadArgument,
                format!("the subscriber slots of {} have no settings of their own", target.id),
            )
            .found("subscriber slots")
            .wanted(service)
            .next(format!("change those of the service: ledgerctl robot set {service} KEY=VALUE")));
        }
        for service in after.services.iter_mut().filter(|service| service.topic == target.service.topic) {
            if let (Some(changes), false) = (&settings.attributes, topic.is_empty()) {
                attributes::change(&mut service.attributes, changes, attributes::OF_SERVICE_BYTES_MAX)?;
            }
            *service = description::check_service(decider, apply(&settings, service.clone())?)?;
        }
    }
    if let (Some(changes), true) = (&settings.attributes, topic.is_empty()) {
        attributes::change(&mut after.attributes, changes, attributes::OF_ROBOT_BYTES_MAX)?;
    }
    if let Some(required) = &settings.attribute_required {
        after.attribute_required = description::check_attribute(required)?;
    }
    if let Some(trusted) = settings.trusted {
        after.trusted = description::check_trusted(ctx, trusted)?;
    }
    store::json(&robot_change::change(ctx, decider, Some(before), after)?)
}
