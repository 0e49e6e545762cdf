//! The publishers beside a route that delivers commands: who they are, and from when on they count. Without IO.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use crate::graph::{
    dds::{LEASE, Neighbour},
    mark::Mark,
    shm::OtherPublisher,
};

/// For so long a publisher in shared memory that says to be a bridge's may be unknown on DDS.
const INTRODUCTION: Duration = Duration::from_secs(5);
/// For so long those with the mark of a route may be an earlier run of this bridge, which was killed. It leaves with its lease;
/// the rest is for looks that come late.
const EARLIER_RUN: Duration = LEASE.saturating_add(Duration::from_secs(8));

/// Publishers beside a route.
#[derive(Debug, Default)]
pub(super) struct NearbyPublishers {
    /// Since when each in shared memory is there, and whether it was told.
    since: BTreeMap<u128, (Instant, bool)>,
    /// Those on DDS with the mark of the route: when they came, and when they were there last.
    marked: Option<(Instant, Instant)>,
    /// Do those count?
    marked_count: bool,
}

/// Those of them that count.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct RoguePublishers {
    pub(super) count: usize,
    /// Do those with the mark of the route count now, and did not before?
    pub(super) has_marked_news: bool,
    /// The processes of those in shared memory that did not count before.
    pub(super) news: Vec<Option<u32>>,
}

impl NearbyPublishers {
    /// These publish there now, on DDS and in shared memory. `own` is the mark of the route.
    pub(super) fn look(
        &mut self,
        on_dds: &[&Neighbour],
        own: Mark,
        mut in_memory: Vec<OtherPublisher>,
        now: Instant,
    ) -> RoguePublishers {
        let (marked, others): (Vec<&Neighbour>, Vec<&Neighbour>) =
            on_dds.iter().copied().partition(|publisher| publisher.mark == Some(own));
        let count = self.look_at_marked(!marked.is_empty(), now);
        let counted = std::mem::replace(&mut self.marked_count, count);
        let of_dds = if count { on_dds.len() } else { others.len() };
        let mut rogue = RoguePublishers { count: of_dds, has_marked_news: count && !counted, news: Vec::new() };
        if !count {
            // A bridge is in shared memory as well: its node there names its participant of DDS.
            in_memory.retain(|publisher| !publisher.bridge.is_some_and(|bridge| is_of(&marked, bridge)));
        }
        self.since.retain(|id, _| in_memory.iter().any(|publisher| publisher.id == *id));
        for OtherPublisher { id, process, bridge } in in_memory {
            let (since, is_told) = self.since.entry(id).or_insert((now, false));
            if bridge.is_some() && now.saturating_duration_since(*since) < INTRODUCTION {
                continue;
            }
            rogue.count = rogue.count.saturating_add(1);
            if !std::mem::replace(is_told, true) {
                rogue.news.push(process);
            }
        }
        rogue
    }

    /// Do those with the mark of the route count: are they there for longer than an earlier run of this bridge can be? One that
    /// comes soon after another has no time of its own.
    fn look_at_marked(&mut self, are_there: bool, now: Instant) -> bool {
        if !are_there {
            return false;
        }
        let goes_on = |(_, last): &(Instant, Instant)| now.saturating_duration_since(*last) <= EARLIER_RUN;
        let since = self.marked.filter(goes_on).map_or(now, |(since, _)| since);
        self.marked = Some((since, now));
        now.saturating_duration_since(since) > EARLIER_RUN
    }
}

/// Has one of these endpoints the participant with this GUID?
fn is_of(endpoints: &[&Neighbour], participant: [u8; 16]) -> bool {
    endpoints.iter().any(|endpoint| endpoint.participant == participant)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::endpoint::Role;
    use ledger_base::hash::Hash;
    use rtps::qos::Qos as Policies;

    fn own() -> Mark {
        Mark::new(&Hash([1; 32]), "T/cmd_vel")
    }

    fn publisher(number: u8, mark: Option<Mark>) -> Neighbour {
        let (topic, type_name) = ("rt/cmd_vel".to_owned(), "geometry_msgs::msg::dds_::Twist_".to_owned());
        Neighbour {
            guid: [number; 16],
            role: Role::Publisher,
            topic,
            type_name,
            qos: Policies::default(),
            mark,
            participant: [number; 16],
            is_strict: true,
            is_reachable: true,
        }
    }

    #[test]
    fn who_says_to_be_a_bridge_in_shared_memory_has_some_seconds_to_prove_it_on_dds() {
        let (start, mut met) = (Instant::now(), NearbyPublishers::default());
        let of = |bridge| vec![OtherPublisher { id: 7, process: Some(9), bridge }];
        let rogue =
            |count, news: &[Option<u32>]| RoguePublishers { count, has_marked_news: false, news: news.to_vec() };
        let mut look = |found, now| met.look(&[], own(), found, now);
        assert_eq!(look(of(None), start), rogue(1, &[Some(9)]));
        assert_eq!(look(of(None), start), rogue(1, &[]), "told once");
        assert_eq!(look(Vec::new(), start), rogue(0, &[]));
        assert_eq!(look(of(Some([1; 16])), start), rogue(0, &[]));
        assert_eq!(look(of(Some([1; 16])), start + INTRODUCTION), rogue(1, &[Some(9)]));
    }

    #[test]
    fn who_has_the_mark_of_a_bridge_for_longer_than_its_lease_is_a_stranger_and_no_earlier_run() {
        let (start, mut met, soon) = (Instant::now(), NearbyPublishers::default(), Duration::from_secs(1));
        let (copy, other, next) = (publisher(1, Some(own())), publisher(2, None), publisher(3, Some(own())));
        let mut look = |on_dds: &[&Neighbour], after: Duration| {
            let found = met.look(on_dds, own(), Vec::new(), start + after);
            (found.count, found.has_marked_news)
        };
        assert_eq!(look(&[&copy], Duration::ZERO), (0, false));
        assert_eq!(look(&[&copy, &other], LEASE), (1, false), "whoever has no mark counts at once");
        assert_eq!(look(&[&copy], EARLIER_RUN), (0, false));
        assert_eq!(look(&[&copy, &other], EARLIER_RUN + soon), (2, true));
        assert_eq!(look(&[&copy], EARLIER_RUN + soon * 2), (1, false), "told once");
        assert_eq!(look(&[], EARLIER_RUN + soon * 3), (0, false));
        assert_eq!(look(&[&next], EARLIER_RUN + soon * 4), (1, true), "another participant has no time of its own");
        assert_eq!(look(&[], EARLIER_RUN * 2), (0, false));
        assert_eq!(look(&[&copy], EARLIER_RUN * 4), (0, false), "much later it may be an earlier run again");
    }

    #[test]
    fn a_bridge_that_counts_as_a_stranger_on_dds_is_one_in_shared_memory_too() {
        let (start, mut met) = (Instant::now(), NearbyPublishers::default());
        let copy = publisher(1, Some(own()));
        let mut look = |after: Duration| {
            let in_memory = vec![OtherPublisher { id: 7, process: Some(9), bridge: Some([1; 16]) }];
            met.look(&[&copy], own(), in_memory, start + after).count
        };
        let counts = EARLIER_RUN + Duration::from_secs(1);
        assert_eq!((look(Duration::ZERO), look(EARLIER_RUN)), (0, 0));
        assert_eq!((look(counts), look(counts + INTRODUCTION)), (1, 2));
    }
}
