//! Random stories of readers, compared with a small model.

use super::{HOUR, POSES, Person, member, own_policies, send, share};
use crate::fleet::{Fleet, SECOND, bytes, camera, owner};
use ledger_base::rejection::Code;
use ledger_confidential::Sealer;
use proptest::prelude::*;
use std::collections::BTreeSet;

/// A block of the random story.
#[derive(Clone, Debug)]
enum Step {
    Enter(usize),
    Leave(usize),
    Remove(usize),
    Revoke(usize),
    Forbid(usize),
    Allow(usize),
    Configure(bool),
    Wait(u64),
    Share,
    Send,
}

const PEOPLE: usize = 4;

fn step() -> impl Strategy<Value = Step> {
    let who = 0..PEOPLE;
    prop_oneof![
        4 => who.clone().prop_map(Step::Enter),
        1 => who.clone().prop_map(Step::Leave),
        1 => who.clone().prop_map(Step::Remove),
        1 => (1..PEOPLE).prop_map(Step::Revoke),
        2 => who.clone().prop_map(Step::Forbid),
        2 => who.prop_map(Step::Allow),
        1 => any::<bool>().prop_map(Step::Configure),
        2 => prop_oneof![Just(SECOND), Just(HOUR / 3), Just(HOUR)].prop_map(Step::Wait),
        5 => Just(Step::Share),
        8 => Just(Step::Send),
    ]
}

/// All that decides who reads, as it can be said in a few lines. The first of the people is an admin of the owner.
#[derive(Clone, Debug, Default, PartialEq)]
struct Model {
    entered: BTreeSet<usize>,
    revoked: BTreeSet<usize>,
    forbidden: BTreeSet<usize>,
    configured: bool,
    /// How often a reader was taken out or revoked.
    losses: u64,
    /// How often one came, or went of its own accord, and when last.
    moves: u64,
    moved_at: u64,
    /// How often somebody was revoked.
    revocations: u64,
}

impl Model {
    fn readers(&self) -> BTreeSet<usize> {
        let reads = |who: &&usize| **who == 0 || !self.forbidden.contains(*who);
        self.entered.iter().filter(reads).copied().collect()
    }

    fn made_for(&self) -> (u64, BTreeSet<usize>, bool) {
        (self.losses, self.forbidden.clone(), self.configured)
    }

    fn moves(&mut self, time: u64) {
        (self.moves, self.moved_at) = (self.moves + 1, time);
    }
}

/// The newest key: for whom, made for what, after how many moves and revocations, until when.
type Newest = (Sealer, BTreeSet<usize>, (u64, BTreeSet<usize>, bool), (u64, u64), u64);

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn readers_read_what_the_model_says_and_nothing_else(steps in proptest::collection::vec(step(), 1..60)) {
        let mut fleet = Fleet::of_the_paper();
        fleet.ok(&owner(), "configure", &[POSES, r#"{"sharing":{"confidential":true}}"#]);
        own_policies(&mut fleet);
        let names = ["admin", "Ada", "Ben", "Cleo"];
        let mut people: Vec<Person> =
            [owner(), member("Ada", 71), member("Ben", 72), member("Cleo", 73)].map(Person::new).into();
        let (mut model, mut seq) = (Model::default(), 0);
        let mut newest: Option<Newest> = None;
        for step in steps {
            match step {
                Step::Enter(who) if !model.revoked.contains(&who) => {
                    let entered = people[who].enter(&mut fleet, POSES).is_ok();
                    prop_assert_eq!(entered, who == 0 || !model.forbidden.contains(&who));
                    if entered {
                        model.entered.insert(who);
                        model.moves(fleet.time);
                    }
                }
                Step::Leave(who) | Step::Remove(who) => {
                    let by = if matches!(step, Step::Leave(_)) { people[who].identity.clone() } else { owner() };
                    let id = people[who].identity.id();
                    let left = fleet.call(&by, "reader", &bytes(&[POSES, "none", &id])).is_ok();
                    prop_assert_eq!(left, model.entered.remove(&who));
                    match by.id() == id {
                        _ if !left => {}
                        true => model.moves(fleet.time),
                        false => model.losses += 1,
                    }
                }
                Step::Revoke(who) => {
                    fleet.revoke(&people[who].identity);
                    model.revoked.insert(who);
                    model.revocations += 1;
                    model.losses += u64::from(model.entered.remove(&who));
                }
                Step::Forbid(who) if who > 0 && model.forbidden.insert(who) => {
                    let text = format!("forbid (principal, action, resource) when {{ principal.name == \"{}\" }};", names[who]);
                    fleet.ok(&owner(), "policy", &["put", names[who], &text]);
                }
                Step::Allow(who) if model.forbidden.remove(&who) => {
                    fleet.ok(&owner(), "policy", &["remove", names[who]]);
                }
                Step::Configure(other) => {
                    let age = if other { 900 } else { 1000 };
                    fleet.ok(&owner(), "configure", &[POSES, &format!(r#"{{"max_age_ms":{age}}}"#)]);
                    model.configured = other;
                }
                Step::Wait(time) => fleet.time += time,
                Step::Share => match share(&mut fleet, &camera(), POSES, 0) {
                    Ok((sealer, given)) => {
                        let readers = model.readers();
                        prop_assert!(readers.contains(&0), "a share without the owner");
                        for (who, person) in people.iter_mut().enumerate() {
                            let learnt = person.keyring.learn(POSES, "Org2/OptiTrack", sealer.key(), &given);
                            prop_assert_eq!(learnt, readers.contains(&who), "{}", names[who]);
                        }
                        newest = Some((sealer, readers, model.made_for(), (model.moves, model.revocations), fleet.time + HOUR));
                    }
                    Err(refused) => {
                        prop_assert_eq!(refused.code, Code::ReadersChanged);
                        prop_assert!(!model.readers().contains(&0), "{}", refused);
                    }
                },
                Step::Send => if let Some((sealer, readers, made_for, (moves, revocations), until)) = &newest {
                    seq += 1;
                    let sent = send(&mut fleet, &camera(), sealer, (POSES, 0, seq));
                    let is_over = fleet.time >= model.moved_at + 2 * SECOND || *revocations != model.revocations;
                    let has_moved = *moves != model.moves && is_over;
                    let is_good = *made_for == model.made_for() && fleet.time < *until && !has_moved;
                    prop_assert_eq!(sent.is_ok(), is_good, "{:?}", sent);
                    if let Ok(sealed) = sent {
                        // Nobody reads who has lost the right; who has come or gone just now counts with the next key.
                        prop_assert!(*moves != model.moves || *readers == model.readers());
                        for (who, person) in people.iter().enumerate() {
                            let opened = person.keyring.open(POSES, "Org2/OptiTrack", 0, seq, &sealed);
                            prop_assert_eq!(opened.is_ok(), readers.contains(&who), "{}", names[who]);
                            prop_assert!(opened.is_err() || !model.revoked.contains(&who));
                        }
                    }
                },
                _ => {}
            }
        }
    }
}
