//! The terms of a share on the command line.

use crate::argument::attribute::Attribute;
use crate::argument::when::When;
use chrono::Local;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::ShareTerms;

#[derive(Debug, clap::Args)]
#[group(required = false)]
pub(super) struct Terms {
    /// The robot, or one of its services
    #[arg(value_name = "ROBOT[/TOPIC]", required = true)]
    resource: String,
    /// The organisation, or one identity of it
    #[arg(long, value_name = "ORG[/PERSON]", required = true)]
    with: String,
    /// Only identities with this attribute; KEY alone means KEY=true
    #[arg(long = "attr", value_name = "KEY[=VALUE]")]
    attribute: Option<Attribute>,
    /// Start: 10m for ten minutes from now, or a time such as 2027-05-01T08:00:00+02:00
    #[arg(long, value_name = "TIME")]
    from: Option<When>,
    /// End: 8h for eight hours from now, or a time such as 2027-05-01T18:00:00+02:00
    #[arg(long, value_name = "TIME")]
    until: Option<When>,
    /// Only within these hours: '08:00-18:00', '08:00-18:00 Mon-Fri +02:00'; without an offset, the current one of this
    /// machine, all year
    #[arg(long, value_name = "HOURS")]
    hours: Option<String>,
    /// Largest linear speed, m/s; enforced by the robot's gate
    #[arg(long, value_name = "SPEED")]
    max_linear: Option<String>,
    /// Largest angular speed, rad/s
    #[arg(long, value_name = "SPEED")]
    max_angular: Option<String>,
    /// Largest rate, messages per second
    #[arg(long, value_name = "HZ")]
    rate: Option<String>,
    /// Priority, for services with priority=policy
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    priority: Option<String>,
    /// Permit reading only
    #[arg(long, conflicts_with_all = ["max_linear", "max_angular", "rate", "priority"])]
    read_only: bool,
}

impl Terms {
    /// The terms, at a time of this machine's clock (microseconds).
    ///
    /// # Errors
    /// [`Code::BadArgument`] for hours that are none.
    pub(super) fn read(self, now: u64) -> Result<ShareTerms, Rejection> {
        let whole = |when: When| when.micros(now) / 1000 * 1000;
        let hours = match self.hours {
            Some(hours) => Some(with_offset(&hours, &Local::now().format("%:z").to_string())?),
            None => None,
        };
        Ok(ShareTerms {
            resource: self.resource,
            with: self.with,
            attribute: self.attribute.map(|Attribute { key, value }| format!("{key}={value}")),
            from: self.from.map(whole),
            until: self.until.map(whole),
            hours,
            max_linear: self.max_linear,
            max_angular: self.max_angular,
            rate: self.rate,
            priority: self.priority,
            read_only: self.read_only,
        })
    }
}

/// Hours with an offset from UTC; with this one if they have none.
fn with_offset(hours: &str, offset: &str) -> Result<String, Rejection> {
    let has_offset = |part: &str| part == "Z" || part.starts_with(['+', '-']);
    let parts: Vec<&str> = hours.split_whitespace().collect();
    match parts.as_slice() {
        [hours, days @ .., last] if has_offset(last) && days.len() <= 1 => {
            Ok([&[*hours], days, &[*last]].concat().join(" "))
        }
        [_] | [_, _] => Ok(format!("{} {offset}", parts.join(" "))),
        _ => Err(Rejection::new(Code::BadArgument, "the hours cannot be read")
            .found(format!("{hours:?}"))
            .wanted("HH:MM-HH:MM [DAYS] [OFFSET], such as '08:00-18:00 Mon-Fri +02:00'")
            .next("ledgerctl share --help")),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn hours_have_the_offset_of_this_machine_unless_they_name_one() {
        let read = |hours: &str| with_offset(hours, "+01:00").ok();
        assert_eq!(read("08:00-18:00").unwrap(), "08:00-18:00 +01:00");
        assert_eq!(read("08:00-18:00  Mon-Fri").unwrap(), "08:00-18:00 Mon-Fri +01:00");
        assert_eq!(read("08:00-18:00 Z").unwrap(), "08:00-18:00 Z");
        assert_eq!(read("08:00-18:00 Mon-Fri -05:00").unwrap(), "08:00-18:00 Mon-Fri -05:00");
        assert_eq!((read(""), read("a b c")), (None, None));
    }
}
