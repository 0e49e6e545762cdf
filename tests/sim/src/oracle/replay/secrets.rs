//! Only readers read (docs/decisions/0105). A judge with every reading key of everybody, also of those who are readers no more,
//! takes all that stands in the blocks, and tries to open every message:
//!
//! - nobody opens one that was sent after they had been taken out, revoked, or denied by a policy;
//! - a reader of the moment when the key was shared, which still is one, opens it, and finds what was sealed;
//! - no block has a secret in the clear.

use super::super::model::{Listed, Model};
use crate::confidential::{PAIRS, SERVICE, Sealed, pair, shows_a_secret};
use crate::coverage::Coverage;
use crate::people::Person;
use crate::world::World;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_confidential::Keyring;
use ledger_contract::{Envelope, Share};
use std::collections::{BTreeMap, BTreeSet};

/// A reader's name, and the public half of a pair.
type Pair = (String, String);

/// The judge.
pub(super) struct Secrets<'a> {
    network: Hash,
    sealed: &'a Sealed,
    /// Everybody's pairs, each with all content keys that were ever wrapped for it.
    keyrings: BTreeMap<Pair, Keyring>,
    /// The time of each content key, and the readers for whom it was good, by publisher and height.
    shared: BTreeMap<(String, u64), (u64, BTreeSet<Pair>)>,
    /// Those who have been readers.
    were: BTreeSet<Pair>,
    pub(super) coverage: Coverage,
}

/// A message on the chain.
struct Message<'a> {
    publisher: &'a str,
    epoch: u64,
    sequence: u64,
    payload: &'a Bytes,
    key: u64,
    time: u64,
}

impl<'a> Secrets<'a> {
    pub(super) fn new(world: &'a World) -> Self {
        Self {
            network: world.network,
            sealed: &world.sealed,
            keyrings: BTreeMap::new(),
            shared: BTreeMap::new(),
            were: BTreeSet::new(),
            coverage: Coverage::default(),
        }
    }

    /// A transaction was executed, and the model is where it was left.
    pub(super) fn follow(
        &mut self,
        model: &Model,
        transaction: &Transaction,
        code: Code,
        (height, time): (u64, u64),
    ) -> Result<(), String> {
        if shows_a_secret(transaction.encoded()) {
            return Err("a secret in the clear".to_owned());
        }
        let body = transaction.body();
        let creator = model.people().by_fingerprint(&transaction.creator()).map(Person::id);
        let Some(publisher) = creator.filter(|_| code == Code::Ok && body.chaincode == "abac") else { return Ok(()) };
        let text = |at: usize| body.args.get(at).map(|bytes| String::from_utf8_lossy(bytes)).unwrap_or_default();
        match (&*body.function, body.args.as_slice()) {
            ("share", [service, _, share]) if service == SERVICE => {
                let share = serde_json::from_slice(share).map_err(|_| "a share that is none")?;
                self.learn(model, &publisher, (height, time), &share);
            }
            ("set", [service, _, _, payload]) if service == SERVICE => {
                let Some(Envelope { key, .. }) = Envelope::parse(payload) else { return Ok(()) };
                let (epoch, sequence) = (text(1).parse().unwrap(), text(2).parse().unwrap());
                let message = Message { publisher: &publisher, epoch, sequence, payload, key, time };
                self.judge(model, &message)?;
            }
            _ => {}
        }
        Ok(())
    }

    /// Everybody tries to unwrap a content key.
    fn learn(&mut self, model: &Model, publisher: &str, (height, time): (u64, u64), share: &Share) {
        if self.keyrings.is_empty() {
            let people: BTreeSet<String> = model.people().all.iter().map(Person::id).collect();
            for (name, nth) in people.iter().flat_map(|name| (0..PAIRS).map(move |nth| (name, nth))) {
                let own = pair(name, nth);
                let key = own.public_hex();
                self.keyrings.insert((name.clone(), key), Keyring::new(self.network, name.clone(), own));
            }
        }
        for keyring in self.keyrings.values_mut() {
            keyring.learn(SERVICE, publisher, height, share);
        }
        let readers = model.readers(SERVICE, time).into_iter().filter(|listed| listed.may_read);
        let readers: BTreeSet<Pair> = readers.map(|Listed { reader, key, .. }| (reader, key)).collect();
        self.were.extend(readers.iter().cloned());
        self.shared.insert((publisher.to_owned(), height), (time, readers));
    }

    /// Everybody tries to open a message.
    fn judge(&mut self, model: &Model, message: &Message<'_>) -> Result<(), String> {
        let Message { publisher, epoch, sequence, payload, key, time } = *message;
        let of = (publisher.to_owned(), key);
        let (shared_at, readers) = self.shared.get(&of).ok_or("it names a content key that nobody shared")?;
        // A condition on the time in a policy counts with the next share.
        let now: BTreeMap<Pair, bool> = model
            .readers(SERVICE, *shared_at)
            .into_iter()
            .map(|Listed { reader, key, may_read }| ((reader, key), may_read))
            .collect();
        for (pair, keyring) in &self.keyrings {
            let opened = keyring.open(SERVICE, publisher, epoch, sequence, payload).ok();
            let is_reader = now.get(pair).copied();
            let lingers = is_reader.is_none() && model.may_linger(SERVICE, &pair.0, &pair.1, time);
            match opened {
                Some(found) if self.sealed.get(payload) != Some(&found) => {
                    return Err(format!("{} finds something else than was sealed", pair.0));
                }
                Some(_) if !readers.contains(pair) => return Err(format!("{} opens it without a key", pair.0)),
                Some(_) if is_reader == Some(true) => self.coverage.confides("message opened by a reader"),
                Some(_) if lingers => self.coverage.confides("message read by one who had left"),
                Some(_) => return Err(format!("{} opens it, and may read no more", pair.0)),
                None if is_reader == Some(true) && readers.contains(pair) => {
                    return Err(format!("{} may read it, and cannot open it", pair.0));
                }
                None if is_reader == Some(true) => self.coverage.confides("message kept from one who came later"),
                None if self.were.contains(pair) => self.coverage.confides("message kept from one who was taken out"),
                None => {}
            }
        }
        Ok(())
    }
}
