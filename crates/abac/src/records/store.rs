//! The keys of this chaincode and the JSON behind them.
//!
//! | key | value |
//! |---|---|
//! | `robot/<name>` | the registered robot |
//! | `owned/<organisation>/<robot>` | nothing: finds the robots of an organisation |
//! | `undecided/<organisation>/<robot>` | key of the last grant that was decided again, or nothing; while some are left |
//! | `epoch/<service>` | newest epoch given, decimal; outlives grants and robots, so that no epoch comes twice |
//! | `grant/<service>␀<holder>` | who holds it |
//! | `due/<expiry, 16 hex digits>/<service>␀<holder>` | nothing: orders grants by expiry |
//! | `certificate/<issuer>/<serial>/<service>␀<holder>` | nothing: finds the grants of a revoked certificate |
//! | `line/<service>␀<contender>[␀<task, 16 hex digits>]` | a place in line, as all that follow down to the stop |
//! | `contender/<service>␀<contender>[␀<task>]` | the certificate of a contender in line |
//! | `waiting/<issuer>/<serial>/<service>␀<contender>[␀<task>]` | nothing: finds the places of a revoked certificate |
//! | `pending/<service>␀<contender>` | a contender that waits to be confirmed |
//! | `asking/<issuer>/<serial>/<service>␀<contender>` | nothing: finds what a revoked certificate asks for or has confirmed |
//! | `look/<service>` | when the service is looked at again (block time, microseconds) |
//! | `looks/<time, 16 hex digits>/<service>` | nothing: orders services by that time |
//! | `used/<service>␀<holder>` | when a holder had the service within the last hour, for rules that remember it |
//! | `tasks/` | the newest number of a task, decimal |
//! | `task/<task>` | a task, without its points |
//! | `points/<task>` | the points of a task |
//! | `open/<service>␀<task>` | nothing: finds the tasks of a service that have not ended |
//! | `submitted/<issuer>/<serial>/<task>` | nothing: finds the tasks of a certificate that have not ended |
//! | `times/<service>␀<time, 16 hex digits>/<task>` | nothing: orders tasks by the time at which they join the line or expire |
//! | `ended/<service>␀<time>/<task>` | nothing: orders the tasks of a service that have ended; the newest 16 are kept |
//! | `cancelled/<robot>` | stops that a `resume` has cancelled before they were ordered |
//! | `stopped/<robot>` | who stopped the robot, and why; while it is stopped |
//! | `door/<service>` | the last report of a side door of the service |
//! | `reader/<service>␀<reader>` | a reader of a confidential service, with its reading key, as the next three |
//! | `reading/<issuer>/<serial>/<service>` | its name: finds what a revoked certificate reads |
//! | `readers/<service>` | how often the readers of the service have changed; outlives them |
//! | `shared/<service>␀<publisher>` | where a publisher's newest content key is, and for which readers it was made |
//! | `last/<service>` | last message of a service whose sequences count by epoch |
//! | `last/<service>␀<publisher>` | last message of a publisher of any other |
//! | `policy/<organisation>/<id>` | Cedar text |
//! | `version/<organisation>` | hash over the organisation's policies, their steps, and the number of the set; absent while it has never had any |
//! | `set/<organisation>/<version, 16 hex digits>` | a numbered set of policies, without its texts; the newest are kept |
//! | `text/<organisation>/<SHA-256>` | Cedar text of a policy in a kept set, or in a proposal |
//! | `proposed/<id>` | a set that waits for approvals, or to be applied |
//! | `approving/<issuer>/<serial>/<id>` | nothing: finds what a revoked certificate has approved |
//! | `approvals/` | the network's rule for who must agree to a set |
//!
//! ␀ is a NUL byte: topics and identities contain `/`, so a `/` could not tell where one ends.

use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;

/// The key of a robot.
pub(crate) fn robot_key(name: &str) -> Vec<u8> {
    ["robot/", name].concat().into_bytes()
}

/// The prefix of the robots of an organisation.
pub(crate) fn owned_prefix(organisation: &str) -> Vec<u8> {
    format!("owned/{organisation}/").into_bytes()
}

/// The key that finds a robot by its owner.
pub(crate) fn owned_key(organisation: &str, robot: &str) -> Vec<u8> {
    format!("owned/{organisation}/{robot}").into_bytes()
}

/// The key of the newest epoch of a service.
pub(crate) fn epoch_key(service: &str) -> Vec<u8> {
    format!("epoch/{service}").into_bytes()
}

/// The prefix of the grants of a service.
pub(crate) fn grants_prefix(service: &str) -> Vec<u8> {
    format!("grant/{service}\0").into_bytes()
}

/// The prefix of the grants of all services of a robot.
pub(crate) fn grants_of_robot(robot: &str) -> Vec<u8> {
    ["grant/", robot, "/"].concat().into_bytes()
}

/// The prefix of [`undecided_key`].
pub(crate) const UNDECIDED: &[u8] = b"undecided/";

/// The key of a robot whose grants are to be decided again.
pub(crate) fn undecided_key(organisation: &str, robot: &str) -> Vec<u8> {
    format!("undecided/{organisation}/{robot}").into_bytes()
}

/// Reads [`undecided_key`]: organisation, robot.
pub(crate) fn parse_undecided_key(key: &[u8]) -> Option<(&str, &str)> {
    std::str::from_utf8(key.strip_prefix(UNDECIDED)?).ok()?.split_once('/')
}

/// The key of one grant.
pub(crate) fn grant_key(service: &str, holder: &str) -> Vec<u8> {
    ["grant/", service, "\0", holder].concat().into_bytes()
}

/// The key that orders a grant by its expiry (microseconds).
pub(crate) fn due_key(expires: u64, service: &str, holder: &str) -> Vec<u8> {
    format!("due/{expires:016x}/{service}\0{holder}").into_bytes()
}

/// Reads [`due_key`]: expiry, service, holder.
pub(crate) fn parse_due_key(key: &[u8]) -> Option<(u64, &str, &str)> {
    let (expires, rest) = std::str::from_utf8(key).ok()?.strip_prefix("due/")?.split_once('/')?;
    let (service, holder) = rest.split_once('\0')?;
    Some((u64::from_str_radix(expires, 16).ok()?, service, holder))
}

/// The prefix of the grants that a certificate holds.
pub(crate) fn certificate_prefix(issuer: &[u8; 32], serial: &[u8]) -> Vec<u8> {
    format!("certificate/{}/{}/", hex::encode(issuer), hex::encode(serial)).into_bytes()
}

/// Reads what follows [`certificate_prefix`]: service, holder.
pub(crate) fn parse_certificate_key<'k>(key: &'k [u8], prefix: &[u8]) -> Option<(&'k str, &'k str)> {
    std::str::from_utf8(key.strip_prefix(prefix)?).ok()?.split_once('\0')
}

/// The prefix of the places in line.
pub(crate) fn line_prefix(service: &str) -> Vec<u8> {
    format!("line/{service}\0").into_bytes()
}

/// The key of a place in line.
pub(crate) fn line_key(service: &str, place: &str) -> Vec<u8> {
    ["line/", service, "\0", place].concat().into_bytes()
}

/// The key of the certificate of a contender in line.
pub(crate) fn contender_key(service: &str, place: &str) -> Vec<u8> {
    ["contender/", service, "\0", place].concat().into_bytes()
}

/// The prefix of the places in line of a certificate.
pub(crate) fn waiting_prefix(issuer: &[u8; 32], serial: &[u8]) -> Vec<u8> {
    format!("waiting/{}/{}/", hex::encode(issuer), hex::encode(serial)).into_bytes()
}

/// The prefix of those who wait to be confirmed for a service.
pub(crate) fn pending_prefix(service: &str) -> Vec<u8> {
    format!("pending/{service}\0").into_bytes()
}

/// The key of one who waits to be confirmed.
pub(crate) fn pending_key(service: &str, contender: &str) -> Vec<u8> {
    ["pending/", service, "\0", contender].concat().into_bytes()
}

/// The prefix of what a certificate asks to be confirmed, or has confirmed.
pub(crate) fn asking_prefix(issuer: &[u8; 32], serial: &[u8]) -> Vec<u8> {
    format!("asking/{}/{}/", hex::encode(issuer), hex::encode(serial)).into_bytes()
}

/// The key of the time at which a service is looked at again.
pub(crate) fn look_key(service: &str) -> Vec<u8> {
    ["look/", service].concat().into_bytes()
}

/// The prefix of [`looks_key`].
pub(crate) const LOOKS: &[u8] = b"looks/";

/// The key that orders services by the time (microseconds) at which they are looked at again.
pub(crate) fn looks_key(time: u64, service: &str) -> Vec<u8> {
    format!("looks/{time:016x}/{service}").into_bytes()
}

/// Reads [`looks_key`]: time, service.
pub(crate) fn parse_looks_key(key: &[u8]) -> Option<(u64, &str)> {
    let (time, service) = std::str::from_utf8(key.strip_prefix(LOOKS)?).ok()?.split_once('/')?;
    Some((u64::from_str_radix(time, 16).ok()?, service))
}

/// The prefix of the past use of a service.
pub(crate) fn used_prefix(service: &str) -> Vec<u8> {
    format!("used/{service}\0").into_bytes()
}

/// The key of the past use of a service by one holder.
pub(crate) fn used_key(service: &str, holder: &str) -> Vec<u8> {
    ["used/", service, "\0", holder].concat().into_bytes()
}

/// The newest number of a task.
pub(crate) const TASKS: &[u8] = b"tasks/";

/// The prefix of [`task_key`].
pub(crate) const TASK: &[u8] = b"task/";

/// The key of a task.
pub(crate) fn task_key(task: u64) -> Vec<u8> {
    format!("task/{task:016x}").into_bytes()
}

/// The key of the points of a task.
pub(crate) fn points_key(task: u64) -> Vec<u8> {
    format!("points/{task:016x}").into_bytes()
}

/// The prefix of the tasks of a service that have not ended.
pub(crate) fn open_prefix(service: &str) -> Vec<u8> {
    format!("open/{service}\0").into_bytes()
}

/// The prefix of the tasks of a certificate that have not ended.
pub(crate) fn submitted_prefix(issuer: &[u8; 32], serial: &[u8]) -> Vec<u8> {
    format!("submitted/{}/{}/", hex::encode(issuer), hex::encode(serial)).into_bytes()
}

/// The prefix of the proposed sets of policies that a certificate has approved.
pub(crate) fn approving_prefix(issuer: &[u8; 32], serial: &[u8]) -> Vec<u8> {
    format!("approving/{}/{}/", hex::encode(issuer), hex::encode(serial)).into_bytes()
}

/// The serial numbers of an authority's certificates that have something here which ends with them.
pub(crate) fn serials(ctx: &Context<'_>, issuer: &[u8; 32]) -> BTreeSet<Vec<u8>> {
    let mut serials = BTreeSet::new();
    for kind in ["certificate", "waiting", "asking", "submitted", "reading", "approving"] {
        let prefix = format!("{kind}/{}/", hex::encode(issuer)).into_bytes();
        for (key, _) in ctx.range(&prefix, usize::MAX) {
            let rest = key.strip_prefix(&prefix[..]).unwrap_or_default();
            serials.extend(rest.split(|byte| *byte == b'/').next().and_then(|serial| hex::decode(serial).ok()));
        }
    }
    serials
}

/// The prefix of the tasks of a service by the time (microseconds) at which they join the line or expire.
pub(crate) fn times_prefix(service: &str) -> Vec<u8> {
    format!("times/{service}\0").into_bytes()
}

/// The prefix of the tasks of a service that have ended, by the time (microseconds) of that.
pub(crate) fn ended_prefix(service: &str) -> Vec<u8> {
    format!("ended/{service}\0").into_bytes()
}

/// A key that names a task behind this prefix.
pub(crate) fn with_task(mut prefix: Vec<u8>, task: u64) -> Vec<u8> {
    prefix.extend_from_slice(format!("{task:016x}").as_bytes());
    prefix
}

/// A key that names a time (microseconds) and a task behind this prefix.
pub(crate) fn with_time(mut prefix: Vec<u8>, time: u64, task: u64) -> Vec<u8> {
    prefix.extend_from_slice(format!("{time:016x}/{task:016x}").as_bytes());
    prefix
}

/// The number of the task that [`with_task`] or [`with_time`] has put behind this prefix, and the time.
pub(crate) fn parse_task(key: &[u8], prefix: &[u8]) -> Option<(u64, u64)> {
    let rest = std::str::from_utf8(key.strip_prefix(prefix)?).ok()?;
    let (time, task) = rest.split_once('/').unwrap_or(("0", rest));
    Some((u64::from_str_radix(time, 16).ok()?, u64::from_str_radix(task, 16).ok()?))
}

/// The key of the stop of a robot.
pub(crate) fn stopped_key(robot: &str) -> Vec<u8> {
    ["stopped/", robot].concat().into_bytes()
}

/// The key of the cancelled stops of a robot.
pub(crate) fn cancelled_key(robot: &str) -> Vec<u8> {
    ["cancelled/", robot].concat().into_bytes()
}

/// The key of the last report of a side door of a service.
pub(crate) fn side_door_key(service: &str) -> Vec<u8> {
    ["door/", service].concat().into_bytes()
}

/// The key of a reader of a service; without a reader the prefix of all.
pub(crate) fn reader_key(service: &str, reader: &str) -> Vec<u8> {
    ["reader/", service, "\0", reader].concat().into_bytes()
}

/// The prefix of what a certificate reads; the service follows.
pub(crate) fn reading_prefix(issuer: &[u8; 32], serial: &[u8]) -> Vec<u8> {
    format!("reading/{}/{}/", hex::encode(issuer), hex::encode(serial)).into_bytes()
}

/// The key of how often the readers of a service have changed.
pub(crate) fn readers_key(service: &str) -> Vec<u8> {
    ["readers/", service].concat().into_bytes()
}

/// The key of the height of the newest block in which somebody was revoked, or an organisation left.
pub(crate) const REVOKED: &[u8] = b"revoked/";

/// The key of the newest content key of a publisher; without a publisher the prefix of all of a service.
pub(crate) fn shared_key(service: &str, publisher: &str) -> Vec<u8> {
    ["shared/", service, "\0", publisher].concat().into_bytes()
}

/// The key of the last message of a service, or of one of its publishers (see [`super::last`]).
pub(crate) fn last_key(service: &str, publisher: Option<&str>) -> Vec<u8> {
    publisher.map_or_else(|| format!("last/{service}"), |who| format!("last/{service}\0{who}")).into_bytes()
}

/// The prefix of an organisation's policies.
pub(crate) fn policies_prefix(organisation: &str) -> Vec<u8> {
    format!("policy/{organisation}/").into_bytes()
}

/// The key of a policy.
pub(crate) fn policy_key(organisation: &str, id: &str) -> Vec<u8> {
    format!("policy/{organisation}/{id}").into_bytes()
}

/// The key of the hash over an organisation's policies.
pub(crate) fn version_key(organisation: &str) -> Vec<u8> {
    format!("version/{organisation}").into_bytes()
}

/// The prefix of the numbered sets of an organisation.
pub(crate) fn sets_prefix(organisation: &str) -> Vec<u8> {
    format!("set/{organisation}/").into_bytes()
}

/// The key of a numbered set.
pub(crate) fn set_key(organisation: &str, version: u64) -> Vec<u8> {
    format!("set/{organisation}/{version:016x}").into_bytes()
}

/// The prefix of the texts of an organisation.
pub(crate) fn texts_prefix(organisation: &str) -> Vec<u8> {
    format!("text/{organisation}/").into_bytes()
}

/// The key of a text by its SHA-256 in hexadecimal digits.
pub(crate) fn text_key(organisation: &str, sha256: &str) -> Vec<u8> {
    format!("text/{organisation}/{sha256}").into_bytes()
}

/// The prefix of [`proposed_key`].
pub(crate) const PROPOSED: &[u8] = b"proposed/";

/// The key of a proposed set.
pub(crate) fn proposed_key(id: &str) -> Vec<u8> {
    format!("proposed/{id}").into_bytes()
}

/// The key of the network's rule for who must agree to a set.
pub(crate) const APPROVALS: &[u8] = b"approvals/";

/// JSON of a response, an event or a value.
pub(crate) fn json(value: &impl Serialize) -> Result<Bytes, Rejection> {
    serde_json::to_vec(value)
        .map(Bytes::from)
        .map_err(|fault| Rejection::new(Code::Internal, "a value cannot be encoded as JSON").found(fault.to_string()))
}

/// Reads the JSON of a value that this chaincode wrote.
pub(crate) fn parse<T: DeserializeOwned>(key: &[u8], value: &[u8]) -> Result<T, Rejection> {
    serde_json::from_slice(value).map_err(|fault| {
        Rejection::new(Code::Corrupt, format!("value of key {:?} is not readable", String::from_utf8_lossy(key)))
            .found(fault.to_string())
            .next("stop the node and delete its directory state/; it is rebuilt from the blocks")
    })
}

/// Reads a key.
pub(crate) fn read<T: DeserializeOwned>(ctx: &Context<'_>, key: &[u8]) -> Result<Option<T>, Rejection> {
    ctx.get(key).map(|value| parse(key, &value)).transpose()
}

/// Writes a key.
pub(crate) fn write(ctx: &mut Context<'_>, key: &[u8], value: &impl Serialize) -> Result<(), Rejection> {
    let value = json(value)?;
    ctx.put(key, value);
    Ok(())
}
