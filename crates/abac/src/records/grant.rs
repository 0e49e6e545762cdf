//! Grants: leases with an epoch that fences off every earlier holder.
//!
//! A grant is *live* while its expiry lies after block time and nothing has ended it. A grant that is no longer live
//! counts nowhere, even while it still lies in the state waiting to be swept.
//!
//! Two more keys find a grant: by the time at which it is due, and by its holder's certificate. They are written, moved
//! and removed with it, and only here.

use super::principal::Principal;
use super::robot::Robot;
use super::service::Service;
use super::target::Target;
use super::{store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::mutation::lease_clock;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Grant, Limits, POLICIES_TOLD_MAX, Reason};
use serde::{Deserialize, Serialize};

/// Most holders of one service.
pub(crate) const HOLDERS_MAX: usize = 256;

/// The types of messages that command a speed.
const WITH_SPEED: [&str; 2] = ["geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"];

/// A grant as the state holds it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Holding {
    pub(crate) grant: Grant,
    pub(crate) principal: Principal,
    /// The priority with which it was given.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub(crate) priority: i64,
    /// Set when the grant has ended and its event is still to come.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) ending: Option<Reason>,
    /// When the window of the policies that permit it closes (block time, microseconds).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) closes: Option<u64>,
    /// When it ends whatever its holder does, if whoever passed it on said so (block time, microseconds).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) ends_by: Option<u64>,
    /// Since when the service has been held without a break, if it was passed on (block time, microseconds).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) since: Option<u64>,
    /// Does the rule remember how long it was held?
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(crate) counted: bool,
    /// Those who passed it on and may take it back, the first one first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) givers: Vec<Giver>,
}

/// One who passed a grant on for a while, with what it had.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Giver {
    pub(crate) principal: Principal,
    #[serde(default, skip_serializing_if = "is_zero")]
    pub(crate) priority: i64,
    pub(crate) lease_ms: u64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) ends_by: Option<u64>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(crate) may_delegate: bool,
}

impl Holding {
    /// Does it count at this block time?
    pub(crate) fn is_live(&self, now: u64) -> bool {
        self.ending.is_none() && self.grant.expires > lease_clock(now)
    }

    /// Why it ended, if it is not live.
    pub(crate) fn reason(&self) -> Reason {
        self.ending.unwrap_or(Reason::Expired)
    }

    /// When the lease ends if it is renewed `now`. Certificates of its holder and its givers end it sooner; so do the window of
    /// its policies, and the end that a giver set.
    pub(crate) fn extended(&self, now: u64) -> u64 {
        let certificates = self.principals().map(|principal| principal.not_after);
        let ends = self.givers.iter().filter_map(|giver| giver.ends_by).chain(self.ends_by).chain(self.closes);
        certificates.chain(ends).fold(now.saturating_add(self.grant.lease_ms.saturating_mul(1000)), u64::min)
    }

    /// Since when the service is held without a break, whoever held it (block time, microseconds).
    pub(crate) fn held_since(&self) -> u64 {
        self.since.unwrap_or(self.grant.acquired_at)
    }

    /// Its holder, and those who passed it on.
    pub(crate) fn principals(&self) -> impl Iterator<Item = &Principal> {
        [&self.principal].into_iter().chain(self.givers.iter().map(|giver| &giver.principal))
    }

    /// Takes note of the policies that permitted it, those of a set with this number.
    pub(crate) fn decided_by(&mut self, version: u64, policies: &[String]) {
        self.grant.policy_version = version;
        self.grant.policies = policies.iter().take(POLICIES_TOLD_MAX).cloned().collect();
    }

    /// Binds it to what policies say. Speeds are limited where messages have them.
    pub(crate) fn bind(&mut self, service: &Service, limits: &Limits, closes: Option<u64>) {
        self.grant.limits = limits.clone();
        if !WITH_SPEED.contains(&service.type_name.as_str()) {
            (self.grant.limits.max_linear_mm_s, self.grant.limits.max_angular_mrad_s) = (None, None);
        }
        self.closes = closes;
        self.grant.expires = self.grant.expires.min(closes.unwrap_or(u64::MAX));
    }

    /// Extends the lease from `now`.
    pub(crate) fn extend(&mut self, now: u64) {
        self.grant.expires = self.extended(now);
    }
}

fn is_zero(number: &i64) -> bool {
    *number == 0
}

/// Every grant of a service in the state, live or not, oldest first.
pub(crate) fn stored(ctx: &Context<'_>, service: &str) -> Result<Vec<Holding>, Rejection> {
    let pairs = ctx.range(&store::grants_prefix(service), HOLDERS_MAX);
    let mut holdings: Vec<Holding> =
        pairs.iter().map(|(key, value)| store::parse(key, value)).collect::<Result<_, _>>()?;
    holdings.sort_by_key(|holding| holding.grant.epoch);
    Ok(holdings)
}

/// The live grants of a service, oldest first.
pub(crate) fn live(ctx: &Context<'_>, service: &str) -> Result<Vec<Holding>, Rejection> {
    let now = ctx.block_time();
    Ok(stored(ctx, service)?.into_iter().filter(|holding| holding.is_live(now)).collect())
}

/// The live grant of one holder.
pub(crate) fn held_by(ctx: &Context<'_>, service: &str, holder: &str) -> Result<Option<Holding>, Rejection> {
    let holding: Option<Holding> = store::read(ctx, &store::grant_key(service, holder))?;
    Ok(holding.filter(|holding| holding.is_live(ctx.block_time())))
}

/// The newest epoch that was ever given for a service; 0 before the first.
pub(crate) fn newest_epoch(ctx: &Context<'_>, service: &str) -> Result<u64, Rejection> {
    Ok(store::read(ctx, &store::epoch_key(service))?.unwrap_or(0))
}

/// Writes a grant that is not there, and its index keys.
pub(crate) fn put(ctx: &mut Context<'_>, holding: &Holding) -> Result<(), Rejection> {
    check(ctx, holding, None);
    check_offered(ctx, &holding.grant.service)?;
    write(ctx, holding)
}

/// A service that is granted is one of a registered robot: what ends with a robot is found by its services.
fn check_offered(ctx: &mut Context<'_>, id: &str) -> Result<(), Rejection> {
    let robot: Option<Robot> = store::read(ctx, &store::robot_key(target::split(id).0))?;
    let offers = robot.as_ref().is_some_and(|robot| Target::all_of(robot).any(|target| target.id == id));
    if !offers {
        ctx.contradicted(
            Rejection::new(Code::Corrupt, format!("{id} is granted, but no robot offers it"))
                .found(robot.map_or_else(|| "no robot".to_owned(), |robot| format!("robot {}", robot.name)))
                .wanted("a registered robot with that service")
                .next("stop the node and delete its directory state/; it is rebuilt from the blocks"),
        );
    }
    Ok(())
}

fn write(ctx: &mut Context<'_>, holding: &Holding) -> Result<(), Rejection> {
    let (service, holder) = (&holding.grant.service, &holding.grant.holder);
    store::write(ctx, &store::grant_key(service, holder), holding)?;
    ctx.put(&due_key(holding), Bytes::new());
    for key in certificate_keys(holding) {
        ctx.put(&key, Bytes::new());
    }
    Ok(())
}

/// Replaces a grant by itself with another expiry or state.
pub(crate) fn replace(ctx: &mut Context<'_>, before: &Holding, after: &Holding) -> Result<(), Rejection> {
    check(ctx, before, Some(before));
    ctx.delete(&due_key(before));
    write(ctx, after)
}

/// Removes a grant and its index keys.
pub(crate) fn remove(ctx: &mut Context<'_>, holding: &Holding) {
    check(ctx, holding, Some(holding));
    ctx.delete(&store::grant_key(&holding.grant.service, &holding.grant.holder));
    ctx.delete(&due_key(holding));
    for key in certificate_keys(holding) {
        ctx.delete(&key);
    }
}

/// Before a grant changes, the state has it exactly as `wanted`, with both index keys or without any. Everything that ends
/// rights finds grants by these keys: a grant that they miss would stay for ever.
fn check(ctx: &mut Context<'_>, holding: &Holding, wanted: Option<&Holding>) {
    let grant_key = store::grant_key(&holding.grant.service, &holding.grant.holder);
    let stored = ctx.get(&grant_key);
    let agrees = match (&stored, wanted) {
        (None, None) => true,
        (Some(value), Some(wanted)) => {
            store::parse::<Holding>(&grant_key, value).is_ok_and(|stored| stored == *wanted)
                && ctx.get(&due_key(wanted)).is_some()
                && certificate_keys(wanted).iter().all(|key| ctx.get(key).is_some())
        }
        _ => false,
    };
    if !agrees {
        let Grant { service, holder, epoch, .. } = &holding.grant;
        let found =
            stored.map_or_else(|| "no such grant".to_owned(), |value| String::from_utf8_lossy(&value).into_owned());
        ctx.contradicted(
            Rejection::new(Code::Corrupt, format!("the grant of {service} to {holder} does not match its index keys"))
                .found(found)
                .wanted(wanted.map_or_else(
                    || "no grant before this one".to_owned(),
                    |_| format!("the grant with epoch {epoch} and the keys that find it"),
                ))
                .next("stop the node and delete its directory state/; it is rebuilt from the blocks"),
        );
    }
}

fn due_key(holding: &Holding) -> Vec<u8> {
    store::due_key(holding.grant.expires, &holding.grant.service, &holding.grant.holder)
}

/// A key for the certificate of everybody whose revocation ends the grant.
fn certificate_keys(holding: &Holding) -> Vec<Vec<u8>> {
    let suffix = format!("{}\0{}", holding.grant.service, holding.grant.holder);
    let key = |principal: &Principal| {
        let serial = hex::decode(&principal.serial).unwrap_or_default();
        [store::certificate_prefix(&principal.issuer.0, &serial).as_slice(), suffix.as_bytes()].concat()
    };
    holding.principals().map(key).collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::fixture::block;
    use crate::records::robot;
    use crate::records::service::Service;
    use ledger_base::hash::Hash;
    use ledger_contract::{Direction, Mode, Sharing};
    use ledger_identity::Role;
    use std::collections::BTreeMap;

    fn holding(expires: u64) -> Holding {
        let grant = Grant {
            service: "Turtlebot4/cmd_vel".to_owned(),
            holder: "Org1/Salma".to_owned(),
            epoch: 1,
            expires,
            mode: Mode::EXCLUSIVE,
            acquired_at: 0,
            lease_ms: 1,
            next_seq: 0,
            taken: None,
            limits: Limits::default(),
            givers: Vec::new(),
            may_delegate: false,
            follows: None,
            task: None,
            policy_version: 0,
            policies: Vec::new(),
        };
        let principal = Principal {
            organisation: "Org1".to_owned(),
            name: "Salma".to_owned(),
            role: Role::Member,
            attributes: BTreeMap::new(),
            issuer: Hash::ZERO,
            serial: "01".to_owned(),
            fingerprint: Hash::ZERO,
            not_after: u64::MAX,
        };
        Holding {
            grant,
            principal,
            priority: 0,
            ending: None,
            closes: None,
            ends_by: None,
            since: None,
            counted: false,
            givers: Vec::new(),
        }
    }

    /// The robot of the service.
    fn register(ctx: &mut Context<'_>) {
        let service = Service {
            topic: "/cmd_vel".to_owned(),
            type_name: "geometry_msgs/msg/Twist".to_owned(),
            mode: Mode::EXCLUSIVE,
            direction: Direction::Command,
            max_age_ms: 1,
            lease_ms: 1,
            lease_ms_max: 1,
            stop_hex: None,
            sharing: Sharing::default(),
            attributes: Default::default(),
        };
        let mut robot = Robot {
            name: "Turtlebot4".to_owned(),
            organisation: "Org2".to_owned(),
            attribute_required: String::new(),
            trusted: Vec::new(),
            services: vec![service],
            attributes: Default::default(),
            version: Hash::ZERO,
        };
        robot::write(ctx, &mut robot).unwrap();
    }

    /// A change that only a fault of the program would make, and its name.
    type Break = (&'static str, fn(&mut Context<'_>));

    #[test]
    fn a_grant_is_written_moved_and_removed_with_its_index_keys() {
        block(|ctx| {
            register(ctx);
            put(ctx, &holding(5)).unwrap();
            replace(ctx, &holding(5), &holding(9)).unwrap();
            assert_eq!(ctx.range(b"due/", 9).len(), 1);
            remove(ctx, &holding(9));
            assert_eq!(ctx.range(b"", 9).len(), 2, "the robot, and what finds it by its owner");
        })
        .unwrap();
    }

    #[test]
    fn a_grant_that_does_not_agree_with_its_index_keys_stops_the_node() {
        let breaks: [Break; 6] = [
            ("a grant is given twice", |ctx| put(ctx, &holding(5)).unwrap()),
            ("it is not found when it is due", |ctx| {
                ctx.delete(&due_key(&holding(5)));
                remove(ctx, &holding(5));
            }),
            ("it is not found by its certificate", |ctx| {
                certificate_keys(&holding(5)).iter().for_each(|key| ctx.delete(key));
                replace(ctx, &holding(5), &holding(9)).unwrap();
            }),
            ("it is another than was read", |ctx| replace(ctx, &holding(7), &holding(9)).unwrap()),
            ("its robot is not registered", |ctx| {
                remove(ctx, &holding(5));
                ctx.delete(&store::robot_key("Turtlebot4"));
                put(ctx, &holding(5)).unwrap();
            }),
            ("it ends twice", |ctx| {
                remove(ctx, &holding(5));
                remove(ctx, &holding(5));
            }),
        ];
        for (name, broken) in breaks {
            let fault = block(|ctx| {
                register(ctx);
                put(ctx, &holding(5)).unwrap();
                broken(ctx);
            });
            assert_eq!(fault.unwrap_err().code, Code::Corrupt, "{name}");
        }
    }
}
