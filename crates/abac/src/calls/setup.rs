//! `setup`: registering robots.

use crate::arguments::Arguments;
use crate::calls::{description, views};
use crate::lifecycle::{registration, robots};
use crate::policy::decider::Decider;
use crate::records::robot::Robot;
use crate::records::{grant, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};

/// Most robots of one `setup`.
pub(crate) const ROBOTS_PER_SETUP_MAX: usize = 64;

/// `setup ROBOT_JSON...`: registers robots; by an admin of their owner. A robot that exists is refused: see `settings`.
pub(crate) fn setup(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("setup ROBOT_JSON...", args, 1, ROBOTS_PER_SETUP_MAX)?;
    let admin = robots::admin(ctx, "register robots")?;
    let mut assets = Vec::new();
    for index in 0..args.rest(0).len() {
        let spec = description::read_spec(args, index)?;
        if let Some(existing) = description::registered(ctx, &spec.name)? {
            let owned = robots::check_owner(&existing, admin);
            owned.map_err(|refused| refused.next("choose another name for your robot"))?;
            return Err(exists(ctx, &existing)?);
        }
        description::check_base(&spec.name, None, spec.base.as_deref())?;
        description::check_look(ctx, &spec.name)?;
        let robot = description::describe(ctx, decider, &admin.organisation, spec, None)?;
        registration::put(ctx, decider, None, robot.clone())?;
        assets.push(views::asset(ctx, decider, &robot)?);
    }
    store::json(&assets)
}

fn exists(ctx: &Context<'_>, robot: &Robot) -> Result<Rejection, Rejection> {
    let mut services = Vec::new();
    for service in &robot.services {
        let holders: Vec<_> = grant::live(ctx, &robot.service_id(service))?;
        let holders: Vec<_> = holders.iter().map(|holding| holding.grant.holder.as_str()).collect();
        let held = if holders.is_empty() { String::new() } else { format!(", held by {}", holders.join(", ")) };
        services.push(format!("{} ({}{held})", robot.service_id(service), service.mode));
    }
    let name = &robot.name;
    Ok(Rejection::new(Code::AlreadyExists, format!("robot {name} is registered already"))
        .found(format!("robot of {} with {}", robot.organisation, services.join(", ")))
        .wanted("an unused name")
        .next(format!(
            "to change it: ledgerctl robot set {name} KEY=VALUE; to replace it completely: ledgerctl robot add {name} \
             --replace …"
        )))
}
