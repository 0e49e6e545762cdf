//! The addresses of this host. A participant of DDS announces those that there were when it began, and listens to multicasts on
//! their interfaces. Where others have taken their place nobody reaches it, so the graph is joined again.

use std::{collections::BTreeSet, net::Ipv4Addr, time::Duration};

use ledger_base::rejection::{Code, Rejection};
use tokio::{task::spawn_blocking, time::sleep};

use super::reach::{Range, Reach};

/// Between two looks. A change must be the same at two of them: networks come up step by step.
const LOOK_EVERY: Duration = Duration::from_secs(2);

/// The number of an interface, and an address of it. An interface that is made anew has another number.
type Address = (u32, Ipv4Addr);

/// The addresses that there were when a participant began.
#[derive(Debug, Clone)]
pub(crate) struct Addresses {
    began: BTreeSet<Address>,
    /// Does it meet other hosts? Then a new address may lead to some.
    is_far: bool,
    /// The addresses that are used; none = all.
    used: Option<Vec<Ipv4Addr>>,
}

impl Addresses {
    /// Those of this moment.
    ///
    /// # Errors
    /// [`Code::Internal`] if they cannot be read.
    pub(crate) async fn read(reach: &Reach) -> Result<Self, Rejection> {
        let reach = reach.clone();
        spawn_blocking(move || Self::now(&reach)).await.map_err(|error| {
            Rejection::new(Code::Internal, format!("the addresses of this host cannot be read: {error}"))
        })
    }

    /// Blocks for some system calls.
    fn now(reach: &Reach) -> Self {
        let is_far = reach.range != Range::Localhost || !reach.static_peers.is_empty();
        let mut addresses = Self { began: BTreeSet::new(), is_far, used: reach.interfaces.clone() };
        addresses.began = addresses.look();
        addresses
    }

    /// Waits until a participant of that time is out of date, and tells why.
    pub(crate) async fn outdated(self) -> String {
        let mut last = self.began.clone();
        loop {
            sleep(LOOK_EVERY).await;
            let looking = self.clone();
            let Ok(now) = spawn_blocking(move || looking.look()).await else { continue };
            let is_settled = now == last;
            match self.compared(&now) {
                Some(why) if is_settled => return why,
                _ => last = now,
            }
        }
    }

    fn look(&self) -> BTreeSet<Address> {
        let interfaces = netdev::get_interfaces().into_iter();
        let all = interfaces.flat_map(|interface| {
            let index = interface.index;
            interface.ipv4.into_iter().map(move |net| (index, net.addr()))
        });
        all.filter(|(_, address)| self.used.as_ref().is_none_or(|used| used.contains(address))).collect()
    }

    /// Why the addresses of now need a new participant. A loss alone does not: what comes back as it was is used again. Nor does
    /// an address more, where only processes of this host are met: they have others in common.
    fn compared(&self, now: &BTreeSet<Address>) -> Option<String> {
        let gone: Vec<&Address> = self.began.difference(now).collect();
        let new: Vec<&Address> = now.difference(&self.began).collect();
        let is_outdated = !new.is_empty() && (self.is_far || !gone.is_empty());
        is_outdated
            .then(|| [list(&gone, "gone"), list(&new, "new")].into_iter().flatten().collect::<Vec<_>>().join(", "))
    }
}

fn list(addresses: &[&Address], what: &str) -> Option<String> {
    let names: Vec<String> = addresses.iter().map(|(_, address)| address.to_string()).collect();
    (!names.is_empty()).then(|| format!("{what}: {}", names.join(" and ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LO: Address = (1, Ipv4Addr::LOCALHOST);
    const WLAN: Address = (2, Ipv4Addr::new(10, 0, 0, 1));
    const WLAN_LATER: Address = (2, Ipv4Addr::new(10, 0, 0, 2));
    const WLAN_ANEW: Address = (3, Ipv4Addr::new(10, 0, 0, 1));
    const DOCKER: Address = (4, Ipv4Addr::new(172, 17, 0, 1));

    fn compared(is_far: bool, began: &[Address], now: &[Address]) -> Option<String> {
        let addresses = Addresses { began: began.iter().copied().collect(), is_far, used: None };
        addresses.compared(&now.iter().copied().collect())
    }

    #[test]
    fn another_address_or_another_interface_in_the_place_of_one_needs_a_new_participant() {
        for is_far in [false, true] {
            assert_eq!(compared(is_far, &[LO, WLAN], &[LO, WLAN]), None);
            assert_eq!(compared(is_far, &[LO, WLAN], &[LO]), None, "it may come back as it was");
            let why = compared(is_far, &[LO, WLAN], &[LO, WLAN_LATER]);
            assert_eq!(why.as_deref(), Some("gone: 10.0.0.1, new: 10.0.0.2"));
            assert!(compared(is_far, &[LO, WLAN], &[LO, WLAN_ANEW]).is_some());
        }
    }

    #[test]
    fn an_address_more_counts_only_for_who_meets_other_hosts() {
        assert_eq!(compared(false, &[LO], &[LO, DOCKER]), None);
        assert_eq!(compared(true, &[LO], &[LO, WLAN]).as_deref(), Some("new: 10.0.0.1"));
    }

    #[test]
    fn the_loopback_of_this_host_is_among_its_addresses() {
        let began = Addresses::now(&Reach::default()).began;
        assert!(began.iter().any(|(_, address)| *address == Ipv4Addr::LOCALHOST), "{began:?}");
        let used = Some(vec![Ipv4Addr::LOCALHOST]);
        assert_eq!(Addresses::now(&Reach { interfaces: used, ..Reach::default() }).began.len(), 1);
    }
}
