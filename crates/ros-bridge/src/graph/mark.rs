//! The mark by which the bridges of a network know each other.
//!
//! Samples that a bridge publishes came from the ledger, and must not get there again: neither through this bridge nor
//! through another one, of whatever user or organisation. So every endpoint of a bridge says of which network and
//! service it is.
//!
//! - **On DDS** the mark is the QoS policy *lifespan* of the writer, and of a reader whose samples go to the ledger.
//!   Lifespan is part of the discovery data that each DDS carries, so a mark is known before the first sample is. A
//!   lifespan of more than 31 years ends no sample, and it is never compared when endpoints are matched.
//! - **In shared memory** each sample carries it, in the user header.
//!
//! Both times it is the same number: nanoseconds between 31 and 51 years, in steps of 16, because some DDS count
//! in fractions of a second that are no nanoseconds.
//!
//! ```text
//! nanoseconds = 1 000 000 000 000 000 000 + 16 * (network << 32 | service)
//! network     = the first 23 bits of SHA-256("ledgerd bridge" || network)
//! service     = the first 32 bits of SHA-256("ledgerd bridge" || network || service)
//! ```
//! A mark is no proof: a local process can copy it. Then it is not taken in, which harms no other process. Next to a route that
//! delivers commands it passes for an earlier run of the bridge, but only as long as that could be there.

use ledger_base::hash::Hash;
use rtps::{qos::Qos as Policies, time::Ticks};

const DOMAIN: &[u8] = b"ledgerd bridge";
/// 31.7 years: no lifespan of an application.
const FIRST_NANOS: u64 = 1_000_000_000_000_000_000;
/// Nanoseconds between two marks.
const STEP_NANOS: u64 = 16;
const SERVICE_BITS: u32 = 32;
const NETWORK_BITS: u32 = 23;

/// Of which network and service an endpoint of a bridge is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Mark {
    network: u32,
    service: u32,
}

impl Mark {
    /// The mark of a service of a network.
    pub fn new(network: &Hash, service: &str) -> Self {
        let first = |parts: &[&[u8]]| Hash::of(parts).0.first_chunk().copied().map_or(0, u32::from_be_bytes);
        Self {
            network: first(&[DOMAIN, &network.0]) >> (u32::BITS - NETWORK_BITS),
            service: first(&[DOMAIN, &network.0, service.as_bytes()]),
        }
    }

    /// Are both of the same network?
    pub fn is_of_network_of(self, other: Self) -> bool {
        self.network == other.network
    }

    /// The mark as it travels. Never zero.
    pub fn nanos(self) -> u64 {
        let number = u64::from(self.network) << SERVICE_BITS | u64::from(self.service);
        FIRST_NANOS + number * STEP_NANOS
    }

    /// The mark that travelled so; none if that is no mark. A DDS may have rounded it.
    pub fn from_nanos(nanos: u64) -> Option<Self> {
        let number = (nanos.checked_add(STEP_NANOS / 2)?.checked_sub(FIRST_NANOS)?) / STEP_NANOS;
        let network = u32::try_from(number >> SERVICE_BITS).ok().filter(|network| *network >> NETWORK_BITS == 0)?;
        let service = u32::try_from(number & u64::from(u32::MAX)).ok()?;
        Some(Self { network, service })
    }

    /// The policies of an endpoint with this mark.
    pub(crate) fn put_on(self, policies: Policies) -> Policies {
        Policies { lifespan: Ticks::from_nanos(self.nanos()), ..policies }
    }

    /// The mark of an endpoint with these policies.
    pub(crate) fn of(policies: &Policies) -> Option<Self> {
        Self::from_nanos(policies.lifespan.to_nanos()?)
    }
}

const _: () = assert!(
    FIRST_NANOS + ((1 << (SERVICE_BITS + NETWORK_BITS)) * STEP_NANOS) < 2_147_483_647 * 1_000_000_000,
    "the seconds of a DDS duration have 31 bits"
);

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::graph::qos::Qos;
    use proptest::prelude::*;

    #[test]
    fn a_mark_tells_networks_and_services_apart() {
        let (one, two) = (Hash([1; 32]), Hash([2; 32]));
        let mark = Mark::new(&one, "T/cmd_vel");
        assert_eq!(mark, Mark::new(&one, "T/cmd_vel"));
        assert!(mark.is_of_network_of(Mark::new(&one, "T/image")) && mark != Mark::new(&one, "T/image"));
        assert!(!mark.is_of_network_of(Mark::new(&two, "T/cmd_vel")));
    }

    proptest! {
        #[test]
        fn a_mark_survives_discovery_and_what_another_dds_rounds(network: [u8; 32], service in ".{0,40}", off in 0u64..16) {
            let mark = Mark::new(&Hash(network), &service);
            let policies = mark.put_on(Qos::default().policies());
            prop_assert_eq!(Mark::of(&policies), Some(mark));
            prop_assert_eq!(Mark::from_nanos(mark.nanos() + off - 8), Some(mark));
            prop_assert_eq!(Policies { lifespan: Ticks::INFINITE, ..policies }, Qos::default().policies());
        }
    }

    #[test]
    fn a_lifespan_of_an_application_is_no_mark() {
        let of = |lifespan| Mark::of(&Policies { lifespan, ..Policies::default() });
        assert_eq!([Ticks::INFINITE, Ticks::ZERO, Ticks::INVALID].map(of), [None; 3]);
        assert_eq!([10, 900_000_000].map(|seconds| of(Ticks::from_micros(seconds * 1_000_000))), [None; 2]);
        assert_eq!(Mark::from_nanos(0), None);
        assert_eq!(Mark::from_nanos(u64::MAX), None);
    }

    #[test]
    fn the_format_of_a_mark_does_not_change() {
        let mark = Mark { network: 1, service: 2 };
        assert_eq!(mark.nanos(), 1_000_000_068_719_476_768);
        assert_eq!(Mark::from_nanos(mark.nanos()).unwrap(), mark);
    }
}
