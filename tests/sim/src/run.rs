//! One seed from the genesis to the last word: a storm, then quiet, then everything must be as if nothing had happened.

use crate::client::{Call, SERVICES};
use crate::clock::{MILLISECOND, SECOND};
use crate::confidential::shows_a_secret;
use crate::coverage::Coverage;
use crate::invariant::{Check, Violation};
use crate::oracle;
use crate::people::People;
use crate::plan::HEAL_MAX;
use crate::seeds::{Report, violation};
use crate::world::World;
use ledger_base::rejection::Code;
use std::sync::Arc;

/// Runs one seed.
pub fn run(seed: u64, people: &Arc<People>, keep_trace: bool) -> Report<Coverage> {
    let mut world = World::new(seed, people, keep_trace);
    let violation = violation(seed, || play(&mut world));
    if let Some(violation) = &violation {
        let text = violation.to_string();
        world.note(format_args!("violation: {text}"));
    }
    world.coverage.elections = world.invariants.election_safety.elections();
    Report {
        seed,
        violation,
        trace_hash: world.trace.hash(),
        trace: world.trace.text().map(str::to_owned),
        counts: world.coverage,
    }
}

/// How often a user drives each robot in the end, at most.
const LAST_WORDS: usize = 3;

fn play(world: &mut World) -> Check {
    world.run_until(world.plan.chaos)?;
    world.heal();
    let deadline = world.now + HEAL_MAX;
    // First everybody finishes what they are doing, and the members are complete again.
    until(world, deadline, "the ledger wants what the operator wants", World::is_recorded)?;
    let settled =
        until(world, deadline, "the members are complete", |world| world.replacement.is_none() && world.is_settled());
    if settled.is_err() {
        world.invariants.members.at_rest(world.newest_members(), &world.records)?;
    }
    settled?;
    for client in &mut world.clients {
        client.obedient = true;
    }
    until(world, deadline, "every client has ended", |world| world.clients.iter().all(|client| !client.is_busy()))?;
    until(world, deadline, "lies to a robot are over", World::robot_is_free)?;
    last_word(world, deadline)?;
    // One command may come too late. Not all of them.
    for _ in 1..LAST_WORDS {
        if !world.robot_obeys("Org1/Nina") {
            last_word(world, deadline)?;
        }
    }
    if !world.robot_obeys("Org1/Nina") {
        let what = "a robot with an honest node does not let pass what its holder signs";
        return Err(Violation::new("the robot goes on", what));
    }
    until(world, deadline, "all nodes have the same chain", agree)?;
    // Nodes go on to attest what they have, so both must hold at one moment.
    let certified = |world: &World| agree(world) && world.is_certified();
    until(world, deadline, "the newest block is certified, and all nodes have it", certified)?;
    compare(world)?;
    oracle::judge(world)
}

/// The owner's admins put a set in force under which a user is served. All whose approval may be needed give it.
fn last_agreement(world: &mut World, deadline: u64) -> Check {
    if !world.plan.governs {
        return Ok(());
    }
    let proposal = world.last_proposal();
    obey(world, deadline, "Org2/admin", proposal)?;
    for (admin, orders) in world.last_approvals() {
        obey(world, deadline, admin, orders)?;
    }
    Ok(())
}

/// Somebody does what they are told, whatever comes of it.
fn obey(world: &mut World, deadline: u64, person: &str, orders: Vec<Call>) -> Check {
    let client = world.employ_for(person, orders, true);
    until(world, deadline, "an admin does what is wanted", |world| world.clients[client].orders.is_empty())
}

/// A user who has done nothing so far takes every service, uses it and gives it back.
fn last_word(world: &mut World, deadline: u64) -> Check {
    let policies = [crate::policy::Policy::ErringForbid, crate::policy::Policy::ForbidFarhad];
    let mut orders: Vec<Call> = vec![Call::Setup { open: true }];
    orders.extend(policies.map(Call::Remove));
    orders.push(Call::Resume { robot: "*" });
    orders.push(Call::Put(crate::policy::Policy::Trusted));
    orders.extend(SERVICES.map(|service| Call::Release { service: service.to_owned() }));
    last_agreement(world, deadline)?;
    obey(world, deadline, "Org2/admin", orders)?;
    let orders = SERVICES.iter().flat_map(|service| {
        let service = (*service).to_owned();
        [
            Call::Acquire { service: service.clone(), lease_ms: None },
            Call::Set { service: service.clone(), epoch: 0, seq: 0 },
            Call::Release { service },
        ]
    });
    let user = world.employ_for("Org1/Nina", orders.collect(), false);
    until(world, deadline, "a user is served", |world| world.clients[user].orders.is_empty())?;
    let mut codes = world.clients[user].obeyed.clone();
    if world.plan.confidential {
        for (person, orders) in world.last_secrets() {
            let client = world.employ_for(person, orders, false);
            until(world, deadline, "secrets are told", |world| world.clients[client].orders.is_empty())?;
            codes.extend(&world.clients[client].obeyed);
        }
    }
    if codes.iter().any(|code| *code != Code::Ok) {
        return Err(Violation::new("the cluster serves again", format!("verdicts {codes:?}")));
    }
    // Whatever is still due is done.
    world.run_until(world.now + 2 * SECOND)
}

fn until(world: &mut World, deadline: u64, what: &str, holds: impl Fn(&World) -> bool) -> Check {
    while !holds(world) {
        if world.now >= deadline {
            let tips: Vec<_> = world.nodes.keys().map(|id| (*id, world.tip(*id).map(|tip| tip.0))).collect();
            let what = format!("not within {} s: {what}; heights {tips:?}", HEAL_MAX / SECOND);
            return Err(Violation::new("the cluster serves again", what));
        }
        world.run_until(world.now + 50 * MILLISECOND)?;
    }
    Ok(())
}

/// All members run, and have executed the same.
fn agree(world: &World) -> bool {
    let members = world.newest_members();
    let tips: Vec<_> = members.voters.iter().chain(&members.learners).map(|id| world.tip(*id)).collect();
    tips.iter()
        .all(|tip| tip.as_ref().is_some_and(|tip| tip.0 == world.blocks.len() as u64 && Some(tip) == tips[0].as_ref()))
}

/// All members hold the same keys and values.
fn compare(world: &World) -> Check {
    let members = world.newest_members();
    let mut all = members.voters.iter().chain(&members.learners);
    let Some(first) = all.next() else { return Ok(()) };
    let reference = world.contents(*first);
    if reference.iter().any(|(key, value)| shows_a_secret(key) || shows_a_secret(value)) {
        return Err(Violation::new("only readers read", "a secret stands in the state"));
    }
    all.try_for_each(|id| world.invariants.state_agreement.compare((*first, &reference), (*id, &world.contents(*id))))
}
