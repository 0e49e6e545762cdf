//! Robots to which nobody may publish any more: a set of policies that makes one is put only by who says that it is meant.

use crate::lifecycle::people;
use crate::policy::action::Action;
use crate::policy::decider::Decider;
use crate::policy::{Texts, limits, texts};
use crate::records::target::Target;
use crate::records::{robot, store};
use ledger::{Context, Page, Paging};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Direction;

/// Most people who are asked about.
const PEOPLE_MAX: usize = 512;

/// Most questions to the policies.
const QUESTIONS_MAX: u64 = 4096;

/// Most steps of all these questions.
const STEPS_MAX: u64 = 16 * 1024 * 1024;

/// Most robots that a refusal names.
const NAMED_MAX: usize = 8;

/// Refuses a set under which nobody whom the ledger knows may publish to some robot any more, unless it is meant.
///
/// # Errors
/// [`Code::NobodyMayPublish`] with the robots.
pub(crate) fn check(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
    set: &Texts,
    means_it: bool,
) -> Result<(), Rejection> {
    if means_it {
        return Ok(());
    }
    let robots = cut_off(ctx, decider, organisation, set)?;
    if robots.is_empty() {
        return Ok(());
    }
    let more = robots.len().saturating_sub(NAMED_MAX);
    let mut names = robots.into_iter().take(NAMED_MAX).collect::<Vec<_>>().join(", ");
    if more > 0 {
        names = format!("{names} and {more} more");
    }
    Err(Rejection::new(Code::NobodyMayPublish, "no known identity could publish to a robot any more")
        .found(names)
        .wanted("an identity that may acquire one of its services and publish on it"))
}

/// The robots of an organisation to which nobody with a certificate of a CA of the network may publish any more under a set, at
/// any time of the day. None where that takes too many questions to tell, and where no CA of the network has issued a certificate.
pub(crate) fn cut_off(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
    set: &Texts,
) -> Result<Vec<String>, Rejection> {
    let names = robot::names_of(ctx, organisation);
    let set = if set.is_empty() { texts::built_in() } else { set.clone() };
    let mut robots = unreachable(ctx, decider, (organisation, names), &set)?;
    if !robots.is_empty() {
        let in_force = texts::in_force(ctx, organisation)?;
        let before = unreachable(ctx, decider, (organisation, robots.clone()), &in_force)?;
        robots.retain(|robot| !before.contains(robot));
    }
    Ok(robots)
}

fn unreachable(
    ctx: &mut Context<'_>,
    decider: &Decider,
    (organisation, names): (&str, Vec<String>),
    set: &Texts,
) -> Result<Vec<String>, Rejection> {
    let steps = limits::steps_of_all(set)?;
    let most = (STEPS_MAX / steps.max(1)).min(QUESTIONS_MAX);
    let mut robots = Vec::new();
    for name in names {
        let robot = robot::find(ctx, &name)?;
        let commands = Target::all_of(&robot).filter(|target| target.service.direction == Direction::Command);
        robots.push((name, commands.filter(|target| !target.is_for_readers()).collect::<Vec<_>>()));
    }
    robots.retain(|(_, commands)| !commands.is_empty());
    let (mut asked, mut people, mut after) = (0, 0, None);
    while !robots.is_empty() {
        let page = ctx.call("msp", "enrolled", &[store::json(&Paging::at(after))?])?;
        let page: Page<String> = store::parse(b"msp enrolled", &page)?;
        for id in page.items {
            let Ok(principal) = people::certified(ctx, &id) else { continue };
            people += 1;
            robots.retain(|(_, commands)| {
                !commands.iter().any(|target| {
                    asked += 2;
                    let may = |action| decider.could(ctx, &principal, target, action, set);
                    asked <= most && may(Action::Acquire) && may(Action::Publish)
                })
            });
            if asked > most || people >= PEOPLE_MAX {
                robots.clear();
            }
        }
        after = page.next;
        if after.is_none() {
            break;
        }
    }
    let question = || Hash::of(&[b"reachable\0", &texts::hash(set).0]);
    ctx.charge_steps(organisation, steps.saturating_mul(asked.min(most)), question);
    if people == 0 {
        robots.clear();
    }
    Ok(robots.into_iter().map(|(name, _)| name).collect())
}
