//! Revocation lists (docs/fabric.md, "Revocation lists"). The CAs say what they have signed.

use super::{Model, Person, Verdict, only_admins};
use crate::clock::SECOND;
use crate::lists::{Lists, Signed};
use ledger_base::rejection::Code;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::Arc;

/// How far a list may come from the future.
const AHEAD_MAX: u64 = 5 * 60 * SECOND;

/// The lists that CAs have signed, and the newest one of each that the ledger has.
#[derive(Clone)]
pub(super) struct Kept {
    signed: Arc<Lists>,
    newest: BTreeMap<String, Signed>,
}

#[derive(Deserialize)]
struct Record {
    list: String,
}

impl Kept {
    pub(super) fn new(signed: &Lists) -> Self {
        Self { signed: Arc::new(signed.clone()), newest: BTreeMap::new() }
    }
}

impl Model {
    pub(super) fn record_list(&mut self, who: &Person, argument: &str, time: u64) -> Verdict {
        let Record { list } = serde_json::from_str(argument).map_err(|_| Code::BadArgument)?;
        only_admins(who)?;
        let organisation = &who.identity.organisation;
        let der = hex::decode(list).map_err(|_| Code::BadArgument)?;
        let list = self.lists.signed.find(&der).filter(|list| list.organisation == *organisation);
        let list = list.cloned().ok_or(Code::Untrusted)?;
        let before = self.lists.newest.get(organisation);
        if before == Some(&list) {
            return Ok(Code::Ok.into());
        }
        if list.made_at() > time + AHEAD_MAX || list.ends_at() < time {
            return Err(Code::OldList);
        }
        if let Some(before) = before {
            // What it leaves out stays revoked.
            let numbered = before.number.is_none() || list.number > before.number;
            if list.made < before.made || (list.made == before.made && !numbered) {
                return Err(Code::OldList);
            }
        }
        let people = Arc::clone(&self.people);
        let issued = people.all.iter().find(|person| person.identity.organisation == *organisation);
        let issuer = issued.map(|person| hex::encode(person.identity.issuer)).unwrap_or_default();
        self.revoked.extend(list.serials.iter().map(|serial| (issuer.clone(), hex::encode(serial))));
        self.lists.newest.insert(organisation.clone(), list);
        self.forget_the_revoked(time);
        Ok(Code::Ok.into())
    }
}
