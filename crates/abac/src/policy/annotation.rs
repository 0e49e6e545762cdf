//! Annotations of policies: what a `permit` says besides that it permits.
//!
//! Known ones only: a misspelt limit that nobody enforces would be worse than none.

use super::Permit;
use super::window::{self, State, Window};
use crate::arguments::shown;
use crate::rules::priority;
use cedar_policy::{Effect, Policy, PolicySet};
use ledger_base::nearest::did_you_mean;
use ledger_contract::Limits;

/// The priority of whom the policy permits, `@priority("7")`: for services with `priority=policy`.
const PRIORITY: &str = "priority";
/// The window of time in which it permits.
const BETWEEN: &str = "between";
/// Annotations for people, and the mark of a share.
const FOR_PEOPLE: [&str; 3] = ["id", "description", "share"];
/// Annotations that mean something.
const MEANT: [&str; 6] = [PRIORITY, "max_rate", "max_age", "max_linear", "max_angular", BETWEEN];
/// Largest rate (Hz) and speed (m/s, rad/s) of a limit.
const LIMIT_MAX: u64 = 10_000;
/// Longest age of a limit, in milliseconds.
const AGE_MS_MAX: u64 = 3_600_000;

/// May an answer by this text depend on the time because of a window?
pub(super) fn may_have_window(text: &str) -> bool {
    text.contains(BETWEEN)
}

/// Does the set use known annotations only, and these with values that they can have?
pub(super) fn check(policies: &PolicySet) -> Result<(), Vec<String>> {
    let mut faults = Vec::new();
    for policy in policies.policies() {
        for (name, value) in policy.annotations() {
            if FOR_PEOPLE.contains(&name) {
                continue;
            }
            if !MEANT.contains(&name) {
                let known = MEANT.into_iter().chain(FOR_PEOPLE);
                let near = did_you_mean(name, known.clone(), "");
                let near = if near.is_empty() { near } else { format!(" ({near})") };
                let known: Vec<&str> = known.collect();
                faults.push(format!("unknown annotation @{name}{near}; wanted one of @{}", known.join(", @")));
            } else if policy.effect() == Effect::Forbid {
                faults.push(format!("@{name} on a forbid; wanted it on a permit"));
            } else if let Err(wanted) = read(name, value, &mut Permit::default()) {
                faults.push(format!("@{name}({}): wanted {wanted}", shown(value)));
            }
        }
    }
    if faults.is_empty() { Ok(()) } else { Err(faults) }
}

/// The annotations of a policy that mean something.
pub(super) fn meant(policy: &Policy) -> impl Iterator<Item = (&str, &str)> {
    policy.annotations().filter(|(name, _)| MEANT.contains(name))
}

/// The word of a policy that matches.
pub(super) enum Said {
    /// It permits, and says this with it.
    Permits(Permit),
    /// It permits within this window only, which is closed.
    Closed(String),
}

/// The word of a policy that matches, at this time (milliseconds since the UNIX epoch).
///
/// # Errors
/// The annotation that cannot be read: it was put under rules that did not look at it.
pub(super) fn said(policy: &Policy, time_ms: i64) -> Result<Said, String> {
    let mut permit = Permit { policies: vec![policy.id().to_string()], ..Permit::default() };
    for (name, value) in policy.annotations() {
        read(name, value, &mut permit)
            .map_err(|wanted| format!("@{name}({}) of {}: wanted {wanted}", shown(value), policy.id()))?;
    }
    let Some((text, window)) = permit.limits.between.first().and_then(|text| Some((text, Window::parse(text)?))) else {
        return Ok(Said::Permits(permit));
    };
    match window.at(time_ms) {
        State::Closed => Ok(Said::Closed(text.clone())),
        State::Open(closes) => {
            let closes = closes.and_then(|end| u64::try_from(end).ok()).map(|end| end.saturating_mul(1000));
            Ok(Said::Permits(Permit { closes, ..permit }))
        }
    }
}

/// Reads one annotation. An unknown one says nothing.
///
/// # Errors
/// The form that is wanted.
fn read(name: &str, value: &str, permit: &mut Permit) -> Result<(), String> {
    let Limits { max_rate_mhz, max_age_ms, max_linear_mm_s, max_angular_mrad_s, between } = &mut permit.limits;
    let limit = |unit: &str, least: u64| {
        let read = thousandths(value).filter(|thousandths| (least..=LIMIT_MAX * 1000).contains(thousandths));
        read.map(Some).ok_or_else(|| {
            let least = if least == 0 { "0" } else { "0.001" };
            format!("{least} to {LIMIT_MAX} {unit}, with at most three decimals")
        })
    };
    match name {
        PRIORITY => {
            let most = priority::PRIORITY_MAX;
            permit.priority = priority::parse(value);
            permit.priority.map(drop).ok_or_else(|| format!("a whole number from -{most} to {most}"))?;
        }
        "max_rate" => *max_rate_mhz = limit("Hz", 1)?,
        "max_linear" => *max_linear_mm_s = limit("metres per second", 0)?,
        "max_angular" => *max_angular_mrad_s = limit("radians per second", 0)?,
        "max_age" => {
            let age = milliseconds(value).filter(|ms| (1..=AGE_MS_MAX).contains(ms));
            *max_age_ms = Some(age.ok_or_else(|| format!("1ms to {}s, e.g. 200ms or 2s", AGE_MS_MAX / 1000))?);
        }
        BETWEEN => {
            Window::parse(value).ok_or(window::WANTED)?;
            *between = vec![value.to_owned()];
        }
        _ => {}
    }
    Ok(())
}

/// A decimal number with at most three decimals, in thousandths.
fn thousandths(text: &str) -> Option<u64> {
    let (whole, decimals) = text.split_once('.').map_or((text, None), |(whole, decimals)| (whole, Some(decimals)));
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let decimals = match decimals {
        None => 0,
        Some(decimals) if digits(decimals) && decimals.len() <= 3 => format!("{decimals:0<3}").parse().ok()?,
        Some(_) => return None,
    };
    let whole: u64 = digits(whole).then(|| whole.parse().ok()).flatten()?;
    whole.checked_mul(1000)?.checked_add(decimals)
}

/// `200ms` or `2s`.
fn milliseconds(text: &str) -> Option<u64> {
    let (number, unit) = match text.strip_suffix("ms") {
        Some(number) => (number, 1),
        None => (text.strip_suffix('s')?, 1000),
    };
    let is_number = !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit());
    is_number.then(|| number.parse().ok()).flatten().and_then(|number: u64| number.checked_mul(unit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_exactly_or_not_at_all() {
        for (text, wanted) in [("0", 0), ("0.5", 500), ("1.0", 1000), ("50", 50_000), ("0.001", 1), ("12.345", 12_345)]
        {
            assert_eq!(thousandths(text), Some(wanted), "{text}");
        }
        for bad in ["", ".", "1.", ".5", "-1", "+1", "1e3", "0.0001", "NaN", "inf", "1 ", "1,5", "99999999999999999999"]
        {
            assert_eq!(thousandths(bad), None, "{bad}");
        }
        assert_eq!((milliseconds("200ms"), milliseconds("2s")), (Some(200), Some(2000)));
        for bad in ["", "ms", "s", "200", "1.5s", "-1s", "1m", "99999999999999999999s"] {
            assert_eq!(milliseconds(bad), None, "{bad}");
        }
    }
}
