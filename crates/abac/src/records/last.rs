//! The last message of a service: where it is, and which sequence number may follow it.
//!
//! The service's rule about sequences decides which key it has. Holders that publish side by side must not share one:
//! each would make the ledger forget the other's number, and a message could come again.

use super::store;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::{Latest, Sequence};
use serde::{Deserialize, Serialize};

/// Where the last message of a service is: key `last/…`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Last {
    /// The epoch it was published under; 0 without a grant.
    pub(crate) epoch: u64,
    /// Its sequence number.
    pub(crate) seq: u64,
    /// The block it is in.
    pub(crate) height: u64,
    /// The publisher.
    pub(crate) publisher: String,
    /// How many messages its transaction holds; their sequence numbers end with `seq`.
    pub(crate) count: u64,
    /// Block time (microseconds), where the service's rule asks for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) at: Option<u64>,
    /// The policies that permitted it without a grant: the number of their set, and their ids.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) permitted: Option<(u64, Vec<String>)>,
}

/// Most publishers of a service that are looked at.
const PUBLISHERS_MAX: usize = 1024;

impl From<Last> for Latest {
    fn from(last: Last) -> Self {
        let Last { epoch, seq, height, publisher, count, at: _, permitted: _ } = last;
        Self { publisher, epoch, seq, count, height }
    }
}

/// The smallest sequence number that may follow, from this publisher in this epoch.
pub(crate) fn next_sequence(
    ctx: &Context<'_>,
    service: &str,
    sequence: Sequence,
    epoch: u64,
    publisher: &str,
) -> Result<u64, Rejection> {
    Ok(follows(read(ctx, service, sequence, publisher)?.as_ref(), sequence, epoch))
}

/// The smallest sequence number that may follow a message, in this epoch.
pub(crate) fn follows(last: Option<&Last>, sequence: Sequence, epoch: u64) -> u64 {
    let counts_on = |last: &&Last| last.epoch == epoch || sequence != Sequence::PerEpoch;
    last.filter(counts_on).map_or(0, |last| last.seq + 1)
}

/// The last message of the service, or of this publisher.
pub(crate) fn read(
    ctx: &Context<'_>,
    service: &str,
    sequence: Sequence,
    publisher: &str,
) -> Result<Option<Last>, Rejection> {
    store::read(ctx, &key(service, sequence, publisher))
}

/// Where the last messages of a service are: of the service, or of each publisher.
pub(crate) fn all(ctx: &Context<'_>, service: &str) -> Result<Vec<Latest>, Rejection> {
    let own: Option<Last> = store::read(ctx, &store::last_key(service, None))?;
    let each = ctx.range(&store::last_key(service, Some("")), PUBLISHERS_MAX);
    let each = each.iter().map(|(key, value)| store::parse(key, value));
    own.into_iter().map(Ok).chain(each).map(|last| last.map(Latest::from)).collect()
}

/// Puts a message in the place of the last one.
pub(crate) fn write(ctx: &mut Context<'_>, service: &str, sequence: Sequence, last: &Last) -> Result<(), Rejection> {
    store::write(ctx, &key(service, sequence, &last.publisher), last)
}

/// An epoch that counts alone has one publisher, so the service has one last message.
fn key(service: &str, sequence: Sequence, publisher: &str) -> Vec<u8> {
    store::last_key(service, (sequence != Sequence::PerEpoch).then_some(publisher))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger::{Environment, Registry};
    use ledger_base::hash::Hash;
    use ledger_storage::state::MemoryState;
    use ledger_storage::state::Overlay;
    use std::sync::Arc;

    const SERVICE: &str = "Turtlebot4/cmd_vel";

    /// The next numbers of Salma in epoch 1 and of Farhad in epoch 2, after each has published, Farhad last.
    fn after_both(sequence: Sequence) -> [u64; 2] {
        let registry = Registry::new();
        let (submitter, network, transaction) = (None, Hash::ZERO, Hash::ZERO);
        let rules = ledger::Rules::NEWEST;
        let meter = ledger::Meter::of_query();
        let environment = Environment {
            registry: &registry,
            submitter,
            network,
            rules,
            height: 1,
            time: 0,
            transaction,
            executed: &|_, _| false,
            meter: &meter,
        };
        let (mut overlay, mut events) = (Overlay::new(Arc::new(MemoryState::default())), Vec::new());
        let mut ctx = Context::new(environment, "abac", &mut overlay, &mut events);
        for (epoch, seq, publisher) in [(1, 9, "Org1/Salma"), (2, 4, "Org1/Farhad")] {
            let publisher = publisher.to_owned();
            let last = Last { epoch, seq, height: 1, publisher, count: 1, at: None, permitted: None };
            write(&mut ctx, SERVICE, sequence, &last).unwrap();
        }
        [(1, "Org1/Salma"), (2, "Org1/Farhad")]
            .map(|(epoch, publisher)| next_sequence(&ctx, SERVICE, sequence, epoch, publisher).unwrap())
    }

    #[test]
    fn a_holder_beside_another_cannot_repeat_a_number_after_the_other_has_published() {
        assert_eq!(after_both(Sequence::PerPublisher), [10, 5]);
    }

    #[test]
    fn an_epoch_that_counts_alone_leaves_nothing_of_the_one_before() {
        assert_eq!(
            after_both(Sequence::PerEpoch),
            [0, 5],
            "who fences by the newest epoch takes no number of an older one"
        );
    }
}
