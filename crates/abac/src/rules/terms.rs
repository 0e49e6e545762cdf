//! The settings of a service's rule: their defaults, their bounds, and which of them go together.

use super::Rule;
use super::priority::Source;
use crate::arguments::shown;
use crate::records::grant::HOLDERS_MAX;
use ledger::msp::QUOTAS_MAX;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{OnConflict, Sharing};

/// Most that wait in one line.
pub(crate) const QUEUE_MAX: u64 = 1024;
/// Most that wait in line unless the owner says otherwise.
const QUEUE_MAX_DEFAULT: u64 = 64;
/// How long (milliseconds) a contender waits at most unless the owner says otherwise.
const QUEUE_WAIT_MS_DEFAULT: u64 = 600_000;
/// How long (milliseconds) confirmations are waited for unless the owner says otherwise.
const CONFIRM_WITHIN_MS_DEFAULT: u64 = 60_000;
/// Most identities that must confirm a contender.
const CONFIRM_MAX: u64 = 16;
/// The longest of all times (milliseconds): a day.
const TIME_MS_MAX: u64 = 86_400_000;
/// The shortest time (milliseconds) after which anything is looked at again: block time has not to be finer.
const TIME_MS_MIN: u64 = 100;

/// The settings with every default filled in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Terms {
    pub(crate) on_conflict: OnConflict,
    /// 0 if nobody waits.
    pub(crate) queue_max: u64,
    pub(crate) queue_wait_max_us: u64,
    pub(crate) min_hold_us: u64,
    pub(crate) idle_release_us: Option<u64>,
    pub(crate) confirm_within_us: u64,
}

impl Terms {
    /// The settings of a service.
    pub(crate) fn of(sharing: &Sharing) -> Self {
        let on_conflict = sharing.on_conflict.unwrap_or(OnConflict::Deny);
        let queue_max = match on_conflict {
            OnConflict::Queue => sharing.queue_max.unwrap_or(QUEUE_MAX_DEFAULT),
            // Who cannot preempt waits only if the owner gives the service a line.
            _ => sharing.queue_max.unwrap_or(0),
        };
        Self {
            on_conflict,
            queue_max,
            queue_wait_max_us: sharing.queue_wait_max_ms.unwrap_or(QUEUE_WAIT_MS_DEFAULT).saturating_mul(1000),
            min_hold_us: sharing.min_hold_ms.unwrap_or(0).saturating_mul(1000),
            confirm_within_us: sharing.confirm_within_ms.unwrap_or(CONFIRM_WITHIN_MS_DEFAULT).saturating_mul(1000),
            idle_release_us: sharing.idle_release_ms.map(|ms| ms.saturating_mul(1000)),
        }
    }
}

/// The settings that go with every rule.
const OF_ALL: [&str; 5] = ["confidential", "bytes_per_s", "messages_per_s", "max_linear_mm_s", "max_angular_mrad_s"];

/// Largest of all speeds, in thousandths of a metre or a radian per second: what no policy can raise either.
const SPEED_MAX: u64 = 10_000_000;

/// The range of a number among the settings, and its unit.
type Bounds = (&'static str, fn(&Sharing) -> Option<u64>, u64, u64, &'static str);

const BOUNDS: [Bounds; 13] = [
    ("publishers", |sharing| sharing.publishers, 1, HOLDERS_MAX as u64, ""),
    ("subscribers", |sharing| sharing.subscribers, 1, HOLDERS_MAX as u64, ""),
    ("queue_max", |sharing| sharing.queue_max, 1, QUEUE_MAX, ""),
    ("queue_wait_max_ms", |sharing| sharing.queue_wait_max_ms, TIME_MS_MIN, TIME_MS_MAX, " ms"),
    ("aging_ms", |sharing| sharing.aging_ms, TIME_MS_MIN, TIME_MS_MAX, " ms"),
    ("min_hold_ms", |sharing| sharing.min_hold_ms, TIME_MS_MIN, TIME_MS_MAX, " ms"),
    ("idle_release_ms", |sharing| sharing.idle_release_ms, TIME_MS_MIN, TIME_MS_MAX, " ms"),
    ("confirm", |sharing| sharing.confirm, 1, CONFIRM_MAX, ""),
    ("confirm_within_ms", |sharing| sharing.confirm_within_ms, TIME_MS_MIN, TIME_MS_MAX, " ms"),
    ("bytes_per_s", |sharing| sharing.bytes_per_s, 1, QUOTAS_MAX.service_bytes_per_s, ""),
    ("messages_per_s", |sharing| sharing.messages_per_s, 1, QUOTAS_MAX.service_messages_per_s, ""),
    ("max_linear_mm_s", |sharing| sharing.max_linear_mm_s, 0, SPEED_MAX, " mm/s"),
    ("max_angular_mrad_s", |sharing| sharing.max_angular_mrad_s, 0, SPEED_MAX, " mrad/s"),
];

/// Checks the settings of a service on this topic.
///
/// # Errors
/// [`Code::BadArgument`]: what is out of range, missing, or does not go together.
pub(crate) fn check(rule: &dyn Rule, sharing: &Sharing, topic: &str) -> Result<(), Rejection> {
    let refuse = |message: String| Rejection::new(Code::BadArgument, message);
    let mode = rule.mode();
    if let Some((key, value)) = sharing.set().find(|(key, _)| !rule.keys().contains(key) && !OF_ALL.contains(key)) {
        return Err(refuse(format!("mode={mode} and {key} of service {topic} cannot be combined"))
            .found(format!("{key}={}", shown(&value)))
            .wanted(match rule.keys() {
                [] => format!("no other setting with mode={mode}"),
                keys => format!("with mode={mode}: {}", keys.join(", ")),
            })
            .next(format!("omit {key}, or choose another mode")));
    }
    let required = rule.required();
    if !required.is_empty() && required.iter().all(|key| sharing.shown(key).is_empty()) {
        let keys = required.join(" or ");
        return Err(refuse(format!("mode={mode} of service {topic} needs {keys}"))
            .found(format!("no {}", required.join(", no ")))
            .wanted(required.iter().map(|key| format!("{key}=N")).collect::<Vec<_>>().join(" or "))
            .next(format!("set {keys}, or choose another mode")));
    }
    for (key, read, min, max, unit) in BOUNDS {
        if let Some(value) = read(sharing).filter(|value| !(min..=max).contains(value)) {
            return Err(refuse(format!("{key} of service {topic} is out of range"))
                .found(format!("{value}{unit}"))
                .wanted(format!("{min} to {max}{unit}"))
                .next("use a value within this range"));
        }
    }
    Source::of(sharing.priority.as_deref())?;
    check_together(sharing, topic)
}

/// A key that has no effect without another one, or undoes it, is a mistake of its owner.
fn check_together(sharing: &Sharing, topic: &str) -> Result<(), Rejection> {
    if sharing.confirm_within_ms.is_some() && sharing.confirm.is_none() {
        return Err(Rejection::new(Code::BadArgument, format!("confirm_within_ms of service {topic} needs confirm"))
            .found(format!("confirm_within_ms={}", sharing.shown("confirm_within_ms")))
            .wanted("confirm=N with confirm_within")
            .next("omit confirm_within, or set confirm"));
    }
    if sharing.confirm.is_some() && sharing.delegable == Some(true) {
        return Err(Rejection::new(
            Code::BadArgument,
            format!("confirm and delegable of service {topic} cannot be combined"),
        )
        .found("delegable=true: a receiver without confirmations")
        .wanted("one of the two")
        .next("omit one of them"));
    }
    let terms = Terms::of(sharing);
    let on_conflict = terms.on_conflict;
    let pointless = match () {
        () if on_conflict == OnConflict::Deny => {
            ["queue_max", "queue_wait_max_ms", "priority", "aging_ms", "min_hold_ms"].as_slice()
        }
        () if on_conflict == OnConflict::Queue => &["min_hold_ms"],
        () if terms.queue_max == 0 => &["queue_wait_max_ms", "aging_ms"],
        () => &[],
    };
    let Some((key, value)) = sharing.set().find(|(key, _)| pointless.contains(key)) else { return Ok(()) };
    let other = match on_conflict {
        OnConflict::Preempt => "no queue_max".to_owned(),
        _ => format!("on_conflict={on_conflict}"),
    };
    Err(Rejection::new(Code::BadArgument, format!("{other} and {key} of service {topic} cannot be combined"))
        .found(format!("{key}={}", shown(&value)))
        .wanted(match key {
            "min_hold_ms" => "on_conflict=preempt with min_hold",
            "queue_wait_max_ms" | "aging_ms" | "queue_max" => "a queue: on_conflict=queue, or preempt with queue_max",
            _ => "on_conflict=queue or preempt with priority",
        })
        .next(format!("omit {key}, or set the other one")))
}
