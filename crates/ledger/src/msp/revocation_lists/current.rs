//! The lists that say something about today: a CA that has a new key, or puts its lists elsewhere, leaves others behind.

use super::ListRecord;
use std::collections::BTreeMap;

/// Most lists of one authority that are kept, of all its keys and scopes. Beyond it the oldest is forgotten.
pub(super) const LISTS_OF_AUTHORITY_MAX: usize = 8;

/// The newest list of each authority about people, and the newest of each scope that leaves out some of them.
pub(in super::super) fn current(lists: Vec<ListRecord>) -> Vec<ListRecord> {
    let mut newest = BTreeMap::new();
    for list in lists {
        let scope = list.scope.filter(|_| list.partial);
        match newest.get(&(list.issuer, scope)) {
            Some(known) if age(known) >= age(&list) => {}
            _ => drop(newest.insert((list.issuer, scope), list)),
        }
    }
    newest.into_values().collect()
}

/// The list of an authority that is forgotten if there are too many.
pub(super) fn superfluous(lists: Vec<ListRecord>) -> Option<ListRecord> {
    if lists.len() <= LISTS_OF_AUTHORITY_MAX { None } else { lists.into_iter().min_by_key(age) }
}

/// The order in which lists were made; of one moment, in which they were recorded.
fn age(list: &ListRecord) -> (u64, u64) {
    (list.this_update, list.height)
}
