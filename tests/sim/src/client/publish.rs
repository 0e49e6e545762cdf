//! The wishes of admins who bring what the CA of their organisation has signed, and now and then something else.

use super::Call;
use crate::clock::{EPOCH, SECOND};
use crate::lists::Signed;
use crate::people::Person;
use crate::world::World;
use bytes::Bytes;
use std::collections::BTreeSet;
use std::sync::Arc;
use testkit::Random;

/// How long a list is good, seconds.
const GOOD_FOR: u64 = 3_600;
/// Longer than a list may come from the future, seconds.
const FUTURE: u64 = 700;
/// The greatest number that is one byte in DER.
const NUMBER_MAX: u8 = 127;
/// The CA that counts its lists. The others do not, as that of Fabric.
const COUNTS: &str = "Org1";

impl World {
    /// A list for an admin to bring.
    pub(super) fn publish(&mut self, organisation: &str) -> Call {
        let kind = self.random.governance.below(100);
        let before = self.lists.of(organisation);
        let earlier = self.random.governance.pick(before).cloned();
        let list = match (kind, earlier) {
            // Perhaps somebody has brought it already, or brought a newer one.
            (0..=24, Some(earlier)) => earlier,
            (25..=30, _) => self.sign_list("Org3"),
            (31..=38, _) => {
                // The last byte belongs to the signature.
                let mut changed = self.sign_list(organisation).to_vec();
                changed.iter_mut().next_back().into_iter().for_each(|byte| *byte ^= 1);
                changed.into()
            }
            _ => self.sign_list(organisation),
        };
        // A number that nothing uses: the seeds that find deliberate bugs count on the rest of this stream.
        self.random.governance.below(100);
        Call::Publish { list: hex::encode(list) }
    }

    /// The CA of an organisation signs a list: mostly the one before with one more certificate, made now.
    fn sign_list(&mut self, organisation: &str) -> Bytes {
        let people = Arc::clone(&self.people);
        let of = |one: &&Person| one.identity.organisation == organisation;
        let serial = |one: &Person| one.identity.serial.clone();
        let former: BTreeSet<Vec<u8>> = people.former.iter().filter(of).map(serial).collect();
        // Everybody has another certificate. The first admin goes on, so that somebody sets everything right in the end.
        let first = people.persons().iter().filter(|one| one.nth == 0 && one.identity.name != "admin");
        let revocable: Vec<Vec<u8>> = first.filter(of).map(serial).collect();
        let before = self.lists.of(organisation);
        let known = before.iter().filter_map(|der| self.lists.find(der));
        let serials: BTreeSet<Vec<u8>> = known.flat_map(|list| list.serials.iter().cloned()).collect();
        let made = (EPOCH + self.now) / SECOND;
        let number = u8::try_from(before.len() + 1).unwrap_or(NUMBER_MAX).min(NUMBER_MAX);
        let number = (organisation == COUNTS).then_some(number);
        let random = &mut self.random.governance;
        let mut list = Signed { organisation: organisation.to_owned(), made, until: made + GOOD_FOR, number, serials };
        list.serials.extend(random.pick(&revocable).cloned().filter(|_| random.percent(15)));
        list.serials.extend(former.iter().filter(|_| random.percent(30)).cloned());
        err(random, &mut list, &former);
        self.lists.sign(&people, list)
    }
}

/// Now and then a CA errs, or somebody who has its key lies.
fn err(random: &mut Random, list: &mut Signed, former: &BTreeSet<Vec<u8>>) {
    match random.below(20) {
        0..=1 => drop(list.serials.pop_last()),
        2 => drop(list.serials.pop_first()),
        3..=6 => list.serials.retain(|serial| !former.contains(serial)),
        7..=9 => list.made -= random.between(1, 60),
        10 => list.number = list.number.map(|number| number - 1).filter(|_| random.percent(50)),
        11 => (list.made, list.until) = (list.made + FUTURE, list.until + FUTURE),
        12 => (list.made, list.until) = (list.made - GOOD_FOR, list.made - 60),
        _ => {}
    }
}
