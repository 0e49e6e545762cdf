//! The facts that executing a block gives, and the hashes over them that voters sign: since rules 3.

use crate::chaincode::Registry;
use bytes::Bytes;
use ledger_hash::Hash;
use ledger_light::control::{self, Write};
use ledger_light::fact::Fact;
use ledger_light::merkle;
use ledger_rejection::Rejection;
use ledger_storage::result::{EmittedEvent, Roots, TransactionResult};
use ledger_storage::state::{StateRead, WriteSet};
use std::collections::BTreeMap;
use std::ops::Bound;

/// Pairs of the state that are read at once.
const PAIRS_AT_ONCE: usize = 256;
/// Keys of the chaincode `msp` start with this.
const MSP_KEYS: &[u8] = b"msp\0";

/// Do these writes change whom others trust: an organisation, a node, a member, a revocation, rules?
pub(crate) fn govern(writes: &WriteSet, registry: &Registry) -> bool {
    let from: (Bound<&[u8]>, Bound<&[u8]>) = (Bound::Included(MSP_KEYS), Bound::Unbounded);
    let mut of_msp = writes.range::<[u8], _>(from).take_while(|(key, _)| key.starts_with(MSP_KEYS));
    of_msp.any(|(key, _)| registry.is_control(key))
}

/// The control writes of a block, in order of keys, with the hashes of their values.
pub(crate) struct ControlWrites(BTreeMap<Bytes, Option<Hash>>);

impl ControlWrites {
    /// Those among the writes of a block.
    pub(crate) fn of(writes: &WriteSet, registry: &Registry) -> Self {
        let control = writes.iter().filter(|(key, _)| registry.is_control(key));
        Self(control.map(|(key, value)| (key.clone(), value.as_ref().map(|value| Hash::of(&[value])))).collect())
    }

    /// All control state that there is, as if one block had written it.
    fn all(state: &dyn StateRead, registry: &Registry) -> Result<Self, Rejection> {
        let mut all = BTreeMap::new();
        for prefix in registry.control_keys() {
            let mut after: Option<Bytes> = None;
            loop {
                let pairs = state.range(&prefix, after.as_deref(), PAIRS_AT_ONCE)?;
                let Some((last, _)) = pairs.last() else { break };
                after = Some(last.clone());
                all.extend(pairs.into_iter().map(|(key, value)| (key, Some(Hash::of(&[&value])))));
            }
        }
        Ok(Self(all))
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn extend(&self, previous: Hash, height: u64) -> Result<Hash, Rejection> {
        let writes: Vec<_> = self.0.iter().map(|(key, value)| Write { key, value: *value }).collect();
        control::extend(previous, height, &writes)
    }
}

/// The roots before the first block that has any, for a network that began with older rules. The control chain begins with
/// all control state that the block at that height has left, and there is no results root.
pub(crate) fn begin(state: &dyn StateRead, registry: &Registry, height: u64) -> Result<Roots, Rejection> {
    let control = ControlWrites::all(state, registry)?.extend(Hash::ZERO, height)?;
    Ok(Roots { control, results: Hash::ZERO })
}

/// Before the genesis.
pub(crate) const NOTHING: Roots = Roots { control: Hash::ZERO, results: Hash::ZERO };

/// The roots of a block that follows one with the roots `before`.
pub(crate) fn roots(
    before: &Roots,
    (height, digest): (u64, Hash),
    (results, events): (&[TransactionResult], &[EmittedEvent]),
    writes: &ControlWrites,
) -> Result<Roots, Rejection> {
    let control = writes.extend(before.control, height)?;
    let ground = Fact::Ground { control, digest, previous: before.results };
    let verdicts = (0u32..).zip(results).map(|(index, result)| Fact::Verdict {
        index,
        id: result.id(),
        code: result.code,
        response: Hash::of(&[&result.response]),
    });
    let events = events.iter().map(|EmittedEvent { index, event }| Fact::Event {
        index: *index,
        chaincode: &event.chaincode,
        name: &event.name,
        subject: &event.subject,
        payload: Hash::of(&[&event.payload]),
    });
    let control_facts = writes.0.iter().map(|(key, value)| Fact::Control { key, value: *value });
    let mut leaves = Vec::with_capacity(1 + results.len() + events.len() + writes.0.len());
    leaves.push(ground.leaf());
    leaves.extend(verdicts.chain(events).chain(control_facts).map(|fact| fact.leaf()));
    Ok(Roots { control, results: merkle::root(leaves) })
}
