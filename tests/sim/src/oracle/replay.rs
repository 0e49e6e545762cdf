//! The chain through the model: every verdict, every refusal, every read.

mod policies;
mod secrets;
mod told;

use super::model::{Judged, Listed, Model, State};
use crate::coverage::Coverage;
use crate::history::{Asks, Kind, Outcome};
use crate::invariant::Violation;
use crate::world::World;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_base::rejection::Code;
use ledger_contract::Readers;
use ledger_storage::result::TransactionResult;
use secrets::Secrets;
use serde::Deserialize;
use told::Standing;

const NAME: &str = "the oracle agrees";
/// The promise about confidential services.
const SECRET: &str = "only readers read";

/// The fields that are read of a grant.
#[derive(Clone, Copy, Deserialize)]
struct Granted {
    epoch: u64,
    expires: u64,
}

/// The fields that are read of an answer: of a grant, of a place in line, of a task by itself, or of one that was submitted.
#[derive(Default, Deserialize)]
struct Answer {
    #[serde(flatten)]
    own: Option<Granted>,
    grant: Option<Granted>,
    queued: Option<Place>,
    #[serde(flatten)]
    task_itself: Option<OfTask>,
    /// In a grant only its number.
    task: Option<serde_json::Value>,
}

#[derive(Clone, Copy, Deserialize)]
struct OfTask {
    id: u64,
    state: State,
    reached: u64,
}

#[derive(Clone, Copy, Deserialize)]
struct Place {
    position: u64,
    priority: i64,
    until: u64,
}

/// The fields that are read of a service.
#[derive(Deserialize)]
struct Served {
    holders: Vec<String>,
    epoch: u64,
    expires: u64,
}

/// The field that is read of what somebody may do.
#[derive(Deserialize)]
struct Authorized {
    name: String,
}

/// Something that a node said on the state of some height.
enum Claim<'a> {
    /// That a transaction is to be refused.
    Refusal { encoded: &'a Bytes, code: Code, is_late: bool },
    /// That this is who holds a service, or whether one may read it.
    Read { asks: Asks, service: &'a str, code: Code, response: &'a Bytes, person: usize },
}

/// Replays everything; answers with how many facts were checked.
pub(super) fn replay(world: &World) -> Result<(u64, Coverage), Violation> {
    let mut claims = claims(world);
    claims.sort_by_key(|(height, ..)| *height);
    let mut claims = claims.into_iter().peekable();
    let mut model = Model::new(&world.people, world.network, &world.plan, &world.lists);
    let (mut standing, mut secrets) = (Standing::default(), Secrets::new(world));
    let (mut time, mut checks) = (0, 0);
    for height in 0..=world.blocks.len() as u64 {
        if let Some(block) = height.checked_sub(1).and_then(|at| world.blocks.get(at as usize)) {
            time = block.outcome.header.time.max(time);
            // Also a block that changes the members begins, and turns come in it.
            model.begin(time);
            for (at, (encoded, result)) in block.outcome.transactions.iter().zip(&block.outcome.results).enumerate() {
                let transaction = Transaction::decode(encoded.clone()).ok();
                let judged = model.execute(transaction.as_ref(), time);
                let says = transaction.as_ref().map(|transaction| transaction.body().clone());
                let wrong = |what: String| {
                    let what = format!("block {height}, transaction {at}: {what}; {says:?}");
                    Violation::new(NAME, what)
                };
                if judged.code != result.code() {
                    let (found, wanted) = (result.code().name(), judged.code.name());
                    return Err(wrong(format!("verdict {found}, the model says {wanted}")));
                }
                let found = answered(result);
                if let Some(grant) = judged.grant
                    && Some(grant) != found.grant
                {
                    return Err(wrong(format!("grant {:?}, the model says {grant:?}", found.grant)));
                }
                if let Some(place) = judged.place
                    && Some(place) != found.place
                {
                    return Err(wrong(format!("place {:?}, the model says {place:?}", found.place)));
                }
                if let Some(task) = judged.task
                    && Some(task) != found.task
                {
                    return Err(wrong(format!("task {:?}, the model says {task:?}", found.task)));
                }
                policies::check(&mut model, &judged, result).map_err(wrong)?;
                if let Some(transaction) = &transaction {
                    let leaks = |what| Violation::new(SECRET, format!("block {height}, transaction {at}: {what}"));
                    secrets.follow(&model, transaction, result.code(), (height, time)).map_err(leaks)?;
                }
                checks += 1;
            }
            standing.follow(&block.outcome);
            standing.check(&model, &block.outcome)?;
            checks += 1;
        }
        let members = world.members.get(height as usize).unwrap_or(world.newest_members());
        model.next(height + 1, members);
        while let Some((_, judged_at, claim)) = claims.next_if(|(of, ..)| *of == height) {
            check(&model, height, judged_at, &claim)?;
            checks += 1;
        }
    }
    match claims.next() {
        None => Ok((checks, secrets.coverage)),
        Some((height, ..)) => Err(Violation::new(NAME, format!("a node spoke of height {height}, which never came"))),
    }
}

/// The answer of a transaction as far as the model tells it.
fn answered(result: &TransactionResult) -> Judged {
    let Answer { own, grant, queued, task_itself, task } = serde_json::from_slice(&result.response).unwrap_or_default();
    Judged {
        code: result.code(),
        grant: own.or(grant).map(|Granted { epoch, expires }| (epoch, expires)),
        place: queued.map(|Place { position, priority, until }| (position, priority, until)),
        version: None,
        agreed: None,
        task: task_itself
            .or(task.and_then(|task| serde_json::from_value(task).ok()))
            .map(|OfTask { id, state, reached }| (id, state, reached)),
    }
}

/// Everything that nodes claimed, with the height and the time by which they judged.
fn claims(world: &World) -> Vec<(u64, u64, Claim<'_>)> {
    let mut claims = Vec::new();
    for operation in &world.history.operations {
        match (&operation.kind, &operation.result) {
            (Kind::Submit { encoded, .. }, Outcome::Refused { code, judged: Some((height, time)), .. }) => {
                // A call that is late by the node's clock only is judged by block time.
                let is_late = Transaction::decode(encoded.clone()).is_ok_and(|call| call.body().not_after < *time);
                let block = height.checked_sub(1).and_then(|index| world.blocks.get(usize::try_from(index).ok()?));
                let time = block.filter(|_| is_late).map_or(*time, |block| block.outcome.header.time);
                claims.push((*height, time, Claim::Refusal { encoded, code: *code, is_late }));
            }
            (Kind::Read { asks, service, person, .. }, Outcome::Read { height, judged_at, code, response }) => {
                let claim = Claim::Read { asks: *asks, service, code: *code, response, person: *person };
                claims.push((*height, *judged_at, claim));
            }
            _ => {}
        }
    }
    claims
}

fn check(model: &Model, height: u64, time: u64, claim: &Claim<'_>) -> Result<(), Violation> {
    match claim {
        Claim::Refusal { encoded, code, is_late } => {
            let transaction = Transaction::decode((*encoded).clone()).unwrap();
            let wanted = model.admit(&transaction, time);
            let is_older = || model.by_older_rules().is_some_and(|model| model.admit(&transaction, time) == *code);
            // It does not ask again whether a late one was signed too far ahead.
            let is_judged = !*is_late || wanted != Code::NotAfterTooFar;
            if is_judged && wanted != *code && !is_older() {
                let (found, wanted, body) = (code.name(), wanted.name(), transaction.body());
                let what = format!("refused with {found} at height {height}, the model says {wanted}: {body:?}");
                return Err(Violation::new(NAME, what));
            }
        }
        Claim::Read { asks: Asks::MayRead, service, code, response, person } => {
            let who = &model.people().all[*person];
            let wanted = match model.find(service) {
                _ if model.is_revoked_now(*person) => Err(Code::Revoked),
                Err(code) => Err(code),
                Ok(_) => Ok(model.may_read(who, service, time).err().unwrap_or(Code::Ok).name().to_owned()),
            };
            let found = match code {
                Code::Ok => Ok(serde_json::from_slice::<Authorized>(response).unwrap().name),
                code => Err(*code),
            };
            if found != wanted {
                let who = who.id();
                let what = format!("may {who} read {service} at height {height}: {found:?}, the model says {wanted:?}");
                return Err(Violation::new(NAME, what));
            }
        }
        Claim::Read { asks: Asks::Readers, service, code, response, person } => {
            let wanted = match model.find(service).map(drop) {
                _ if model.is_revoked_now(*person) => Err(Code::Revoked),
                Err(code) => Err(code),
                Ok(()) => Ok((model.readers(service, time), model.key_places(service))),
            };
            let found = if *code == Code::Ok { Ok(read_readers(response)) } else { Err(*code) };
            if found != wanted {
                let what = format!("readers of {service} at height {height}: {found:?}, the model says {wanted:?}");
                return Err(Violation::new(NAME, what));
            }
        }
        Claim::Read { service, code, response, person, .. } => {
            let wanted = match model.find(service) {
                _ if model.is_revoked_now(*person) => Err(Code::Revoked),
                Err(code) => Err(code),
                Ok(_) => {
                    let live = model.live(service, time);
                    let expires = live.first().map_or(0, |grant| grant.expires);
                    Ok((live.into_iter().map(|grant| grant.holder).collect::<Vec<_>>(), model.epoch(service), expires))
                }
            };
            let found = match code {
                Code::Ok => {
                    let served: Served = serde_json::from_slice(response).unwrap();
                    Ok((served.holders, served.epoch, served.expires))
                }
                code => Err(*code),
            };
            if found != wanted {
                let what = format!("{service} at height {height} read as {found:?}, the model says {wanted:?}");
                return Err(Violation::new(NAME, what));
            }
        }
    }
    Ok(())
}

/// The readers of a service, and where the newest content keys are.
fn read_readers(response: &[u8]) -> (Vec<Listed>, Vec<(String, u64)>) {
    let Readers { readers, keys, .. } = serde_json::from_slice(response).unwrap();
    let listed = readers.into_iter().map(|one| Listed { reader: one.reader, key: one.key, may_read: one.may_read });
    (listed.collect(), keys.into_iter().map(|place| (place.publisher, place.key)).collect())
}
