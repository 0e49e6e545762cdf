//! Revocation lists (docs/fabric.md, "Revocation lists"). The CAs say what they have signed.

use super::{Model, Person, Verdict, only_admins};
use crate::clock::SECOND;
use crate::lists::{Lists, Signed};
use ledger_base::rejection::Code;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
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
    ended: Vec<String>,
}

impl Kept {
    pub(super) fn new(signed: &Lists) -> Self {
        Self { signed: Arc::new(signed.clone()), newest: BTreeMap::new() }
    }
}

impl Model {
    pub(super) fn record_list(&mut self, who: &Person, argument: &str, time: u64) -> Verdict {
        let Record { list, ended } = serde_json::from_str(argument).map_err(|_| Code::BadArgument)?;
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
            let ended = self.ended(organisation, &ended, time)?;
            let numbered = before.number.is_none() || list.number > before.number;
            let complete = before.serials.is_subset(&list.serials.union(&ended).cloned().collect());
            if list.made < before.made || !numbered || !complete {
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

    /// The serial numbers of certificates that came along to show that they have ended.
    fn ended(&self, organisation: &str, shown: &[String], time: u64) -> Result<BTreeSet<Vec<u8>>, Code> {
        let everybody = || self.people.former.iter().chain(&self.people.all);
        let serial = |text: &String| {
            let shown = everybody().find(|person| hex::encode(&person.certificate) == *text);
            let identity = &shown.ok_or(Code::CertificateMalformed)?.identity;
            let proves = identity.organisation == organisation && identity.not_after < time;
            if proves { Ok(identity.serial.clone()) } else { Err(Code::OldList) }
        };
        shown.iter().map(serial).collect()
    }
}
