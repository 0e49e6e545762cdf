//! The audience: who has subscriptions at this node, so that nobody takes the place of everybody.
//!
//! An identity has at most as many subscriptions as there are places free. So has another organisation with all its
//! identities together, because its CA can make as many identities as it likes. A part of the places is kept for robots
//! and nodes: a robot that hears nothing stops.

use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// One of so many places is reserved for robots and nodes.
const KEPT_PART: u64 = 4;

/// The subscriptions of a node.
pub(crate) struct Audience {
    places_max: u64,
    /// The node's own organisation, which answers for its members itself.
    own: String,
    table: Mutex<Table>,
}

#[derive(Default)]
struct Table {
    all: u64,
    /// Of members and admins.
    people: u64,
    /// By identity, e.g. `Org1/Salma`.
    identities: HashMap<String, u64>,
    /// By organisation.
    organisations: HashMap<String, u64>,
}

/// The place of one subscription, until it is dropped.
pub(crate) struct Listener {
    audience: Arc<Audience>,
    identity: String,
    organisation: String,
    person: bool,
}

impl Audience {
    /// So many places at a node of this organisation.
    pub(crate) fn new(places_max: u64, own: String) -> Arc<Self> {
        Arc::new(Self { places_max, own, table: Mutex::default() })
    }

    /// Subscriptions that are open.
    pub(crate) fn len(&self) -> u64 {
        self.lock().all
    }

    /// A place for a subscription of this identity.
    ///
    /// # Errors
    /// [`Code::Overloaded`] beyond the share of the identity or of its organisation, or if there is no place.
    pub(crate) fn enter(self: &Arc<Self>, reader: &Identity) -> Result<Listener, Rejection> {
        self.place(reader.id(), reader.organisation.clone(), reader.role)
    }

    fn place(self: &Arc<Self>, identity: String, organisation: String, role: Role) -> Result<Listener, Rejection> {
        let person = matches!(role, Role::Member | Role::Admin);
        let mut table = self.lock();
        let free = match self.places_max.saturating_sub(table.all) {
            free if person => free.min((self.places_max - self.places_max / KEPT_PART).saturating_sub(table.people)),
            free => free,
        };
        if free == 0 {
            return Err(self.full(person));
        }
        let open_of = |counts: &HashMap<String, u64>, name: &str| counts.get(name).copied().unwrap_or_default();
        let of_identity = open_of(&table.identities, &identity);
        if of_identity >= free {
            return Err(self.beyond_share(&identity, of_identity, free));
        }
        let of_organisation = open_of(&table.organisations, &organisation);
        if organisation != self.own && of_organisation >= free {
            return Err(self.beyond_share(&organisation, of_organisation, free));
        }
        table.all += 1;
        table.people += u64::from(person);
        *table.identities.entry(identity.clone()).or_default() += 1;
        *table.organisations.entry(organisation.clone()).or_default() += 1;
        drop(table);
        Ok(Listener { audience: Arc::clone(self), identity, organisation, person })
    }

    fn full(&self, person: bool) -> Rejection {
        let kept = if person { ", a quarter of which is reserved for robots and nodes" } else { "" };
        Rejection::new(Code::Overloaded, "the node has reached its limit of subscriptions")
            .wanted(format!("at most {} (limits.subscribers_max){kept}", self.places_max))
            .next("subscribe through another node")
    }

    fn beyond_share(&self, who: &str, open: u64, free: u64) -> Rejection {
        Rejection::new(Code::Overloaded, format!("{who} has too many subscriptions at this node"))
            .found(format!("{open} subscriptions"))
            .wanted(format!(
                "at most as many as there are free slots, {free} of {} (limits.subscribers_max)",
                self.places_max
            ))
            .next("close unused subscriptions, or subscribe through another node")
    }

    fn lock(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        let mut table = self.audience.lock();
        table.all -= 1;
        table.people -= u64::from(self.person);
        less(&mut table.identities, &self.identity);
        less(&mut table.organisations, &self.organisation);
    }
}

fn less(counts: &mut HashMap<String, u64>, name: &str) {
    match counts.get_mut(name) {
        Some(count) if *count > 1 => *count -= 1,
        _ => drop(counts.remove(name)),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn audience(places_max: u64) -> Arc<Audience> {
        Audience::new(places_max, "Org1".into())
    }

    fn enter(audience: &Arc<Audience>, organisation: &str, name: &str, role: Role) -> Result<Listener, Rejection> {
        audience.place(format!("{organisation}/{name}"), organisation.into(), role)
    }

    fn fill(audience: &Arc<Audience>, organisation: &str, name: &str, role: Role) -> Vec<Listener> {
        std::iter::from_fn(|| enter(audience, organisation, name, role).ok()).collect()
    }

    #[test]
    fn one_identity_cannot_take_all_places() {
        let audience = audience(1024);
        let taken = fill(&audience, "Org1", "Mallory", Role::Member);
        assert_eq!(taken.len(), 384, "half of what is not reserved for robots and nodes");
        let refused = enter(&audience, "Org1", "Mallory", Role::Member).err().unwrap();
        assert_eq!(refused.code, Code::Overloaded);
        assert!(refused.message.contains("Org1/Mallory") && refused.found.contains("384"), "{refused}");
        let more = fill(&audience, "Org1", "Farhad", Role::Member);
        assert_eq!(more.len(), 192, "half of what is left then");
        drop((taken, more));
        assert_eq!(audience.len(), 0, "places come back");
        assert!(audience.lock().identities.is_empty() && audience.lock().organisations.is_empty());
    }

    #[test]
    fn robots_and_nodes_have_places_that_people_cannot_take() {
        let audience = audience(64);
        let crowd: Vec<_> = (0..64).flat_map(|n| fill(&audience, "Org1", &format!("P{n}"), Role::Member)).collect();
        assert_eq!(crowd.len(), 48);
        let refused = enter(&audience, "Org1", "Salma", Role::Member).err().unwrap();
        assert!(refused.wanted.contains("reserved for robots and nodes"), "{refused}");
        for (name, role) in [("Husky", Role::Robot), ("node1", Role::Node)] {
            enter(&audience, "Org1", name, role).unwrap();
        }
    }

    #[test]
    fn another_organisation_cannot_take_all_places_however_many_identities_it_makes() {
        let audience = audience(64);
        let robots = (0..100).flat_map(|n| fill(&audience, "Org2", &format!("R{n}"), Role::Robot));
        let strangers: Vec<_> = robots.collect();
        assert_eq!(strangers.len(), 32);
        let refused = enter(&audience, "Org2", "Husky", Role::Robot).err().unwrap();
        assert!(refused.message.starts_with("Org2 has"), "{refused}");
        enter(&audience, "Org1", "Salma", Role::Member).unwrap();
        enter(&audience, "Org3", "Spot", Role::Robot).unwrap();
    }

    #[test]
    fn a_node_that_accepts_one_subscription_accepts_it_from_anybody() {
        for role in [Role::Member, Role::Robot] {
            let audience = audience(1);
            let _only = enter(&audience, "Org2", "Husky", role).unwrap();
            assert_eq!(enter(&audience, "Org1", "Salma", role).err().unwrap().code, Code::Overloaded);
        }
    }
}
