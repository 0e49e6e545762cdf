//! The contest for a service as its rule sees it: the holders, the queue, and the contender.

use crate::policy::Permit;
use crate::records::grant::Holding;
use crate::records::line::Waiting;
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{grant, line, used};
use crate::rules::priority::Source;
use crate::rules::priority::{self, PRIORITY_MAX};
use crate::rules::{Claim, Decision, Rule, Situation};
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Place;
use std::collections::BTreeMap;

/// The priority of one who took a service whatever its rule says: above all others.
pub(crate) const OVERRIDING: i64 = i64::MAX;

/// Holders and line of a service at one moment.
pub(crate) struct Contest<'t> {
    target: &'t Target,
    /// Oldest grant first.
    pub(crate) holders: Vec<Holding>,
    /// In order of arrival.
    pub(crate) line: Vec<Waiting>,
    /// Past use of the service within the last hour (microseconds).
    used: BTreeMap<String, u64>,
    now: u64,
}

impl<'t> Contest<'t> {
    /// As it stands on the ledger.
    pub(crate) fn of(ctx: &Context<'_>, target: &'t Target) -> Result<Self, Rejection> {
        let (holders, line) = (grant::live(ctx, &target.id)?, line::all(ctx, &target.id)?);
        Ok(Self { target, holders, line, used: used::all(ctx, &target.id)?, now: ctx.block_time() })
    }

    /// The decision of the rule about a contender, who may be in line.
    pub(crate) fn decide(&self, rule: &dyn Rule, contender: &Claim) -> Decision {
        let holders = self.claims(self.holders.iter().map(claim_of_holder));
        let others =
            self.line.iter().filter(|waiting| waiting.ticket != contender.ticket && !self.holds(&waiting.contender));
        let line = self.claims(others.map(claim));
        let contender = Claim { used: self.used_by(&contender.who), ..contender.clone() };
        rule.decide(&contender, &self.situation(&holders, &line))
    }

    /// Does this contender hold the service? Its places in line are passed over until that ends.
    pub(crate) fn holds(&self, contender: &str) -> bool {
        self.holders.iter().any(|holding| holding.grant.holder == contender)
    }

    /// The line in the order in which its turns come.
    pub(crate) fn in_order(&self, rule: &dyn Rule) -> impl Iterator<Item = &Waiting> {
        let holders = self.claims(self.holders.iter().map(claim_of_holder));
        let line = self.claims(self.line.iter().map(claim));
        let order = rule.order(&self.situation(&holders, &line));
        order.into_iter().filter_map(|index| self.line.get(index))
    }

    /// Claims with the past use of whoever claims.
    fn claims(&self, claims: impl Iterator<Item = Claim>) -> Vec<Claim> {
        claims.map(|claim| Claim { used: self.used_by(&claim.who), ..claim }).collect()
    }

    fn used_by(&self, who: &str) -> u64 {
        self.used.get(who).copied().unwrap_or(0)
    }

    /// Everybody's place, the next one first.
    pub(crate) fn places(&self, rule: &dyn Rule) -> Vec<Place> {
        let ordered = self.in_order(rule).zip(1_u64..);
        ordered.map(|(waiting, position)| self.place(waiting, position)).collect()
    }

    fn place(&self, waiting: &Waiting, position: u64) -> Place {
        let Waiting { contender, priority, since, until, task, .. } = waiting.clone();
        let service = self.target.id.clone();
        Place { service, contender, position, priority, since, until, expected: self.expected(position), task }
    }

    /// When the turn of a position comes if nobody renews: places become free in the order of the leases' ends, then
    /// each holder after that has a lease.
    fn expected(&self, position: u64) -> Option<u64> {
        let mut ends: Vec<u64> = self.holders.iter().map(|holding| holding.grant.expires).collect();
        ends.sort_unstable();
        let places = u64::try_from(ends.len()).ok().filter(|places| *places > 0)?;
        let (round, place) = ((position - 1) / places, (position - 1) % places);
        let leases = round.saturating_mul(self.target.service.lease_ms).saturating_mul(1000);
        ends.get(usize::try_from(place).ok()?).map(|end| end.saturating_add(leases))
    }

    fn situation<'a>(&'a self, holders: &'a [Claim], line: &'a [Claim]) -> Situation<'a> {
        Situation { sharing: &self.target.service.sharing, holders, line, now: self.now }
    }
}

/// A contender in line as the rule sees it.
pub(crate) fn claim(waiting: &Waiting) -> Claim {
    let Waiting { contender, ticket, priority, since, .. } = waiting;
    Claim { who: contender.clone(), priority: *priority, since: *since, ticket: *ticket, used: 0 }
}

/// A contender that comes now.
pub(crate) fn newcomer(ctx: &Context<'_>, who: String, priority: i64) -> Claim {
    Claim { who, priority, since: ctx.block_time(), ticket: u64::MAX, used: 0 }
}

pub(crate) fn claim_of_holder(holding: &Holding) -> Claim {
    let (who, since) = (holding.grant.holder.clone(), holding.held_since());
    Claim { who, priority: holding.priority, since, ticket: 0, used: 0 }
}

/// The priority of a contender: what the service's source says, or less if it asks for less.
///
/// # Errors
/// [`Code::BadArgument`] if its attribute is no priority.
pub(crate) fn priority(
    target: &Target,
    principal: &Principal,
    permit: &Permit,
    asked: Option<i64>,
) -> Result<i64, Rejection> {
    let own = match Source::of(target.service.sharing.priority.as_deref())? {
        Source::Fixed(priority) => priority,
        Source::Policy => permit.priority.unwrap_or(0),
        Source::Attribute(name) => of_attribute(target, principal, name)?,
    };
    Ok(asked.map_or(own, |asked| asked.min(own)))
}

/// Attributes count only if the owner trusts the organisation that signed them.
fn of_attribute(target: &Target, principal: &Principal, name: &str) -> Result<i64, Rejection> {
    let value = principal.attributes.get(name).filter(|_| target.robot.trusted.contains(&principal.organisation));
    let Some(value) = value else { return Ok(0) };
    priority::parse(value).ok_or_else(|| {
        Rejection::new(Code::BadArgument, format!("the attribute {name} of {} is not a priority", principal.id()))
            .found(format!("{name}={value:?}"))
            .wanted(format!(
                "a whole number from -{PRIORITY_MAX} to {PRIORITY_MAX}: {} takes priorities from it",
                target.id
            ))
            .next(format!("ask an admin of {} for another value, then enrol again", principal.organisation))
    })
}
