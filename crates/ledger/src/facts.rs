//! The facts that executing a block gives, and the hashes over them that voters sign.

use crate::chaincode::Registry;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_light::Change;
use ledger_light::control::{self, Write};
use ledger_light::fact::Fact;
use ledger_light::merkle;
use ledger_storage::result::{EmittedEvent, Roots, TransactionResult};
use ledger_storage::state::{StateRead, WriteSet};
use std::collections::BTreeMap;

/// Pairs of the state that are read at once.
const PAIRS_AT_ONCE: usize = 256;
/// Keys of the chaincode `msp` start with this.
const MSP_KEYS: &[u8] = b"msp\0";

/// Is this key of the world state one of the chaincode `msp`?
fn is_of_msp(key: &[u8]) -> bool {
    key.starts_with(MSP_KEYS)
}

/// The control writes of a block, in order of keys, with the hashes of their values.
pub(crate) struct ControlWrites(BTreeMap<Bytes, Option<Hash>>);

impl ControlWrites {
    /// Those among the writes of a block.
    pub(crate) fn of(writes: &WriteSet, registry: &Registry) -> Self {
        let writes = writes.iter().map(|(key, value)| (key, value.as_ref().map(|value| Hash::of(&[value]))));
        Self::among(writes, registry)
    }

    /// Those among writes whose values are told as hashes.
    pub(crate) fn among<'a>(writes: impl Iterator<Item = (&'a Bytes, Option<Hash>)>, registry: &Registry) -> Self {
        Self(writes.filter(|(key, _)| registry.is_control(key)).map(|(key, value)| (key.clone(), value)).collect())
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Do they change whom others trust: an organisation, a node, a member, a revocation, rules?
    pub(crate) fn govern(&self) -> bool {
        self.0.keys().any(|key| is_of_msp(key))
    }

    /// The two chains after the block at that height.
    fn extend(&self, before: &Roots, height: u64) -> Result<Roots, Rejection> {
        let writes = self.0.iter().map(|(key, value)| Write { key, value: *value });
        let (governing, control): (Vec<_>, Vec<_>) = writes.partition(|write| is_of_msp(write.key));
        let governing = control::extend(before.governing, height, &governing)?;
        Ok(Roots { governing, control: control::extend(before.control, height, &control)?, results: Hash::ZERO })
    }
}

/// The governing writes of a block, with their values, for a log of them in the world state.
pub(crate) fn change(height: u64, writes: &WriteSet, registry: &Registry) -> Change {
    let governing = writes.iter().filter(|(key, _)| is_of_msp(key) && registry.is_control(key));
    Change { height, writes: governing.map(|(key, value)| (key.clone(), value.clone())).collect() }
}

/// All control state that there is.
fn all(state: &dyn StateRead, registry: &Registry) -> Result<WriteSet, Rejection> {
    let mut all = WriteSet::new();
    for prefix in registry.control_keys() {
        let mut after: Option<Bytes> = None;
        loop {
            let pairs = state.range(&prefix, after.as_deref(), PAIRS_AT_ONCE)?;
            let Some((last, _)) = pairs.last() else { break };
            after = Some(last.clone());
            all.extend(pairs.into_iter().map(|(key, value)| (key, Some(value))));
        }
    }
    Ok(all)
}

/// All governing state as the block at that height has left it.
pub(crate) fn governing(state: &dyn StateRead, registry: &Registry, height: u64) -> Result<Change, Rejection> {
    Ok(change(height, &all(state, registry)?, registry))
}

/// Before the genesis.
pub(crate) const NOTHING: Roots = Roots { governing: Hash::ZERO, control: Hash::ZERO, results: Hash::ZERO };

/// The verdicts of a block in order.
pub(crate) fn verdicts<'a>(results: &'a [TransactionResult]) -> impl Iterator<Item = Fact<'a>> {
    (0u32..).zip(results).map(|(index, result)| Fact::Verdict {
        index,
        id: result.id(),
        code: result.code,
        response: Hash::of(&[&result.response]),
    })
}

/// The facts that executing a block gave: what its voters sign, once it is certified.
pub(crate) struct Facts<'a> {
    /// The first one.
    pub(crate) ground: Fact<'a>,
    /// The others in their order.
    pub(crate) others: Vec<Fact<'a>>,
}

impl<'a> Facts<'a> {
    /// Those of a block. `before` and `after` are the roots; the results root after it is not looked at.
    pub(crate) fn new(
        (before, after): (&Roots, &Roots),
        digest: Hash,
        (results, events): (&'a [TransactionResult], &'a [EmittedEvent]),
        writes: &'a ControlWrites,
    ) -> Self {
        let Roots { governing, control, .. } = *after;
        let events = events.iter().map(|EmittedEvent { index, event }| Fact::Event {
            index: *index,
            chaincode: &event.chaincode,
            name: &event.name,
            subject: &event.subject,
            payload: Hash::of(&[&event.payload]),
        });
        let control_writes = writes.0.iter().map(|(key, value)| Fact::Control { key, value: *value });
        Self {
            ground: Fact::Ground { governing, control, digest, previous: before.results },
            others: verdicts(results).chain(events).chain(control_writes).collect(),
        }
    }

    /// The leaves of its tree.
    pub(crate) fn leaves(&self) -> Vec<Hash> {
        std::iter::once(&self.ground).chain(&self.others).map(Fact::leaf).collect()
    }
}

/// The roots of a block that follows one with the roots `before`.
pub(crate) fn roots(
    before: &Roots,
    (height, digest): (u64, Hash),
    outcome: (&[TransactionResult], &[EmittedEvent]),
    writes: &ControlWrites,
) -> Result<Roots, Rejection> {
    let after = writes.extend(before, height)?;
    let facts = Facts::new((before, &after), digest, outcome, writes);
    Ok(Roots { results: merkle::root(facts.leaves()), ..after })
}
