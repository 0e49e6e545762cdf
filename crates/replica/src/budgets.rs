//! Budgets: bytes and messages a second of identities, organisations and services. The limits are records of the ledger.
//!
//! Every node counts what blocks hold, in block time and in memory, so all nodes count the same and no message writes a record. A
//! gateway lets data in while these counts, and the count of what it has let in itself, are within the limits. A service
//! is only counted for what was permitted, so that a caller without rights uses up nothing of it. Control is counted and
//! never waits.
//!
//! The leader looks at what other gateways forward, and returns the data of those that are far beyond a limit. An honest
//! gateway forwards none of it. A gateway that lies may get more ordered before the count has it: that is a debt, which is paid in time.
//! Bytes without a valid signature, and repetitions, are a debt of the node that has forwarded them.

mod account;
mod forwarders;

use account::{Account, Counted, Rate};
use bytes::Bytes;
use forwarders::Forwarders;
use ledger::msp::{QUOTAS, Quotas, quotas_of};
use ledger::transaction::{Transaction, claimed_creator};
use ledger::{Ledger, Outcome, ServiceBudget};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::units::size;
use ledger_identity::Identity;
use ledger_raft::{Lane, Transactions};
use ledger_storage::result::Event;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

pub use account::BURST;

/// Limits are read from the state again after so long, microseconds.
const READ_AGAIN: u64 = 1_000_000;
/// Accounts kept before those that owe nothing are forgotten.
const ACCOUNTS_MAX: usize = 16_384;
/// How far beyond a burst the leader takes forwarded data, microseconds at the rate: two gateways may let in a burst each.
const FORWARDED: u64 = BURST;
/// The same for control, which only a gateway that lies brings in such an amount.
const FORWARDED_CONTROL: u64 = 3 * BURST;

/// The accounts of a node.
#[derive(Default)]
pub struct Budgets {
    accounts: Mutex<Accounts>,
}

#[derive(Default)]
struct Accounts {
    organisations: HashMap<String, Organisation>,
    /// By name, e.g. `Org1/Salma`.
    identities: HashMap<String, Account>,
    /// By name in full.
    services: HashMap<String, Account>,
    /// The budgets of services, by chaincode and the name that a call has for it.
    named: HashMap<(String, String), Named>,
    forwarders: Forwarders,
}

struct Organisation {
    quotas: Quotas,
    /// When they were read.
    read: u64,
    account: Account,
}

struct Named {
    budget: Option<ServiceBudget>,
    read: u64,
}

impl Budgets {
    /// Counts an executed block. Transactions without a valid signature, and repetitions,
    /// count for the node that has forwarded them to this one.
    pub fn executed(&self, outcome: &Outcome, ledger: &Ledger) {
        let time = outcome.header.time;
        let mut accounts = self.lock();
        accounts.forget(time);
        let published = |event: &Event| {
            ledger.registry().find(&event.chaincode).ok().and_then(|chaincode| chaincode.published(event))
        };
        let mut events = outcome.events.iter().filter_map(|emitted| Some((emitted.index?, &emitted.event))).peekable();
        for (position, (transaction, result)) in (0u32..).zip(outcome.transactions.iter().zip(&outcome.results)) {
            let bytes = transaction.len() as u64;
            let mut messages = 1;
            while let Some((_, event)) = events.next_if(|(index, _)| *index <= position) {
                if let Some(count) = published(event) {
                    messages = count;
                    let rate = accounts.rate_of(ledger, (&event.chaincode, &event.subject), time);
                    let counted = Counted { bytes, messages };
                    accounts.services.entry(event.subject.clone()).or_default().all.count(rate, time, counted);
                }
            }
            let authentic = result.not_after.is_some();
            if !authentic {
                accounts.forwarders.not_counted(transaction, result.code, time);
            }
            let creator = claimed_creator(transaction).filter(|_| authentic);
            if let Some(identity) = creator.and_then(|creator| ledger.counted_for(&creator)) {
                accounts.count(ledger, &identity, time, Counted { bytes, messages });
            }
        }
    }

    /// Lets data of a gateway's client in, if the budgets of its creator, the creator's organisation and the service have
    /// room for it, and counts it. An organisation may have at most `organisation_bytes` a second, as the disk has room
    /// ([`crate::space::Space::organisation_bytes`]). The steady clock and the node's clock are in microseconds.
    ///
    /// # Errors
    /// [`Code::Overloaded`], with the time after which it may be sent again.
    pub fn admit(
        &self,
        ledger: &Ledger,
        transaction: &Transaction,
        (elapsed, clock): (u64, u64),
        organisation_bytes: u64,
    ) -> Result<(), Rejection> {
        let Some(identity) = ledger.counted_for(&transaction.creator()) else { return Ok(()) };
        let (body, bytes) = (transaction.body(), transaction.encoded().len() as u64);
        let chaincode = ledger.registry().find(&body.chaincode).ok();
        let published = chaincode.and_then(|chaincode| chaincode.publishes(&body.function, &body.args));
        let counted = Counted { bytes, messages: published.map_or(1, |(_, messages)| messages) };
        let name = identity.id();

        let mut accounts = self.lock();
        let service = published.and_then(|(service, _)| {
            let budget = accounts.budget_of(ledger, (&body.chaincode, service), clock)?;
            let rate = accounts.service_rate(ledger, &budget, clock);
            Some((budget, rate))
        });
        let quotas = accounts.quotas(ledger, &identity.organisation, clock);
        let of_identity = Rate { bytes: quotas.identity_bytes_per_s, messages: quotas.identity_messages_per_s };
        let of_organisation =
            Rate { bytes: quotas.bytes_per_s.min(organisation_bytes), messages: quotas.messages_per_s };
        let small_disk = organisation_bytes < quotas.bytes_per_s;

        let wait = |account: Option<&Account>| account.map_or(0, |account| account.wait(elapsed, clock));
        let organisation = accounts.organisations.get(&identity.organisation).map(|found| &found.account);
        if let wait @ 1.. = wait(accounts.identities.get(&name)) {
            let raise = proposal(&identity.organisation, "identity_bytes_per_s");
            return Err(used_up(&name, of_identity, wait).next(again(wait, &raise)));
        }
        if let wait @ 1.. = wait(organisation) {
            let rejection = used_up(&identity.organisation, of_organisation, wait);
            return Err(match small_disk {
                true => rejection.next(again(wait, "free space on the node's disk")),
                false => rejection.next(again(wait, &proposal(&identity.organisation, "bytes_per_s"))),
            });
        }
        if let Some((budget, rate)) = &service
            && let wait @ 1.. = wait(accounts.services.get(&budget.service))
        {
            let ask = format!("an admin of {} can set its budget: ledgerctl robot set", budget.organisation);
            return Err(used_up(&budget.service, *rate, wait).next(again(wait, &ask)));
        }
        if let Some((budget, rate)) = service {
            accounts.services.entry(budget.service).or_default().own.count(rate, elapsed, counted);
        }
        accounts.identities.entry(name).or_default().own.count(of_identity, elapsed, counted);
        if let Some(organisation) = accounts.organisations.get_mut(&identity.organisation) {
            organisation.account.own.count(of_organisation, elapsed, counted);
        }
        Ok(())
    }

    /// Takes out of what the node `from` forwards what is far beyond the budgets of identities, and of data beyond those of
    /// organisations. It takes out all if that node has forwarded too much that counts for no identity. Nothing is counted: a
    /// block does that, once the signature was verified.
    pub fn take_excess(&self, ledger: &Ledger, from: u64, forwarded: &mut Transactions, clock: u64) -> Transactions {
        let mut accounts = self.lock();
        let owed = accounts.forwarders.wait(from, clock);
        let mut excess = |lane| {
            let transactions = match lane {
                Lane::Control => &mut forwarded.control,
                Lane::Data => &mut forwarded.data,
            };
            let owes = owed > if lane == Lane::Control { FORWARDED_CONTROL } else { FORWARDED };
            let over = |transaction: &Bytes| owes || accounts.is_over(ledger, lane, transaction, clock);
            let (over, within): (Vec<_>, Vec<_>) = std::mem::take(transactions).into_iter().partition(over);
            within.iter().for_each(|transaction| accounts.forwarders.forwarded(from, transaction));
            *transactions = within;
            over
        };
        let (control, data) = (excess(Lane::Control), excess(Lane::Data));
        Transactions { control, data, code: u32::from(Code::Overloaded.number()) }
    }

    /// Does the creator of this transaction owe something to its budget, at this time of the node? Then its calls wait.
    pub fn owes(&self, ledger: &Ledger, transaction: &Transaction, clock: u64) -> bool {
        let Some(identity) = ledger.counted_for(&transaction.creator()) else { return false };
        self.lock().identities.get(&identity.id()).is_some_and(|account| account.all.wait(clock) > 0)
    }

    fn lock(&self) -> MutexGuard<'_, Accounts> {
        self.accounts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Accounts {
    fn count(&mut self, ledger: &Ledger, identity: &Arc<Identity>, time: u64, counted: Counted) {
        let quotas = self.quotas(ledger, &identity.organisation, time);
        let rate = Rate { bytes: quotas.identity_bytes_per_s, messages: quotas.identity_messages_per_s };
        self.identities.entry(identity.id()).or_default().all.count(rate, time, counted);
        if let Some(organisation) = self.organisations.get_mut(&identity.organisation) {
            let rate = Rate { bytes: quotas.bytes_per_s, messages: quotas.messages_per_s };
            organisation.account.all.count(rate, time, counted);
        }
    }

    fn is_over(&self, ledger: &Ledger, lane: Lane, transaction: &Bytes, clock: u64) -> bool {
        let Some(identity) = claimed_creator(transaction).and_then(|creator| ledger.counted_for(&creator)) else {
            return false;
        };
        let owes = |account: Option<&Account>| account.map_or(0, |account| account.all.wait(clock));
        let of_identity = owes(self.identities.get(&identity.id()));
        match lane {
            Lane::Control => of_identity > FORWARDED_CONTROL,
            Lane::Data => {
                let organisation = self.organisations.get(&identity.organisation).map(|found| &found.account);
                of_identity.max(owes(organisation)) > FORWARDED
            }
        }
    }

    /// The quotas of an organisation, which has an account from now on. A limit that cannot be read now stays as it was.
    fn quotas(&mut self, ledger: &Ledger, name: &str, time: u64) -> Quotas {
        if let Some(known) = self.organisations.get(name)
            && known.read.abs_diff(time) < READ_AGAIN
        {
            return known.quotas.clone();
        }
        let read = quotas_of(&**ledger.state(), name).ok();
        let known = self.organisations.entry(name.to_owned()).or_insert_with(|| Organisation {
            quotas: QUOTAS,
            read: time,
            account: Account::default(),
        });
        known.read = time;
        known.quotas = read.unwrap_or_else(|| known.quotas.clone());
        known.quotas.clone()
    }

    /// The budget of the service that a call of a chaincode names, if there is such a service.
    fn budget_of(&mut self, ledger: &Ledger, (chaincode, name): (&str, &str), time: u64) -> Option<ServiceBudget> {
        let key = (chaincode.to_owned(), name.to_owned());
        if let Some(known) = self.named.get(&key).filter(|known| known.read.abs_diff(time) < READ_AGAIN) {
            return known.budget.clone();
        }
        let budget = ledger.service_budget(chaincode, name);
        self.named.insert(key, Named { budget: budget.clone(), read: time });
        budget
    }

    fn service_rate(&mut self, ledger: &Ledger, budget: &ServiceBudget, time: u64) -> Rate {
        let quotas = self.quotas(ledger, &budget.organisation, time);
        Rate {
            bytes: quotas.service_bytes_per_s.min(budget.bytes_per_s.unwrap_or(u64::MAX)),
            messages: quotas.service_messages_per_s.min(budget.messages_per_s.unwrap_or(u64::MAX)),
        }
    }

    fn rate_of(&mut self, ledger: &Ledger, service: (&str, &str), time: u64) -> Rate {
        match self.budget_of(ledger, service, time) {
            Some(budget) => self.service_rate(ledger, &budget, time),
            None => Rate::UNLIMITED,
        }
    }

    /// Forgets accounts that owe nothing, when there are many.
    fn forget(&mut self, time: u64) {
        if self.identities.len() + self.services.len() + self.named.len() > ACCOUNTS_MAX {
            self.identities.retain(|_, account| account.owes(time));
            self.services.retain(|_, account| account.owes(time));
            self.named.clear();
        }
    }
}

fn used_up(who: &str, rate: Rate, wait: u64) -> Rejection {
    Rejection::new(Code::Overloaded, format!("the budget of {who} is exhausted"))
        .found(format!("more than the budget, for the next {} ms", wait.div_ceil(1000)))
        .wanted(format!(
            "at most {} and {} messages per second, for {} s at once",
            size(rate.bytes),
            rate.messages,
            BURST / 1_000_000
        ))
}

fn again(wait: u64, otherwise: &str) -> String {
    format!("retry after {} ms; or send less; or {otherwise}", wait.div_ceil(1000))
}

fn proposal(organisation: &str, kind: &str) -> String {
    format!(
        "propose a larger quota: ledgerctl network propose msp set_quota '{{\"organisation\":\"{organisation}\",\"{kind}\":NUMBER}}'"
    )
}
