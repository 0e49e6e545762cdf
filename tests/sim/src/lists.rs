//! The revocation lists that the CAs of simulated organisations sign. Their keys are fixed, so a list has the same bytes in every
//! run. Each list that was ever signed is written down, for the oracle: it need not read what the product reads.

use crate::clock::SECOND;
use crate::people::{People, ca_key};
use bytes::Bytes;
use ledger::msp::RecordList;
use ledger::transaction::Body;
use ledger_identity::certificate::Certificate;
use ledger_identity::revocation_list::RevocationList;
use std::collections::{BTreeMap, BTreeSet};
use testkit::List;

/// The content of a list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signed {
    /// The organisation whose CA has signed it.
    pub organisation: String,
    /// When it was made, seconds since the UNIX epoch.
    pub made: u64,
    /// When the next one comes, seconds since the UNIX epoch.
    pub until: u64,
    /// Its number, where the CA counts its lists.
    pub number: Option<u8>,
    /// The serial numbers that it revokes.
    pub serials: BTreeSet<Vec<u8>>,
}

/// Every list that was signed, by its bytes.
#[derive(Clone, Debug, Default)]
pub struct Lists {
    signed: BTreeMap<Bytes, Signed>,
    /// Of each organisation, in the order in which its CA made them.
    made: BTreeMap<String, Vec<Bytes>>,
}

impl Signed {
    /// When it was made, microseconds.
    pub fn made_at(&self) -> u64 {
        self.made * SECOND
    }

    /// The last microsecond before the next one should have come.
    pub fn ends_at(&self) -> u64 {
        self.until * SECOND + SECOND - 1
    }

    fn der(&self, people: &People) -> Bytes {
        let organisation = people.organisations.iter().find(|known| known.name == self.organisation).unwrap();
        let issuer = Certificate::parse(&organisation.roots[0]).unwrap().subject_name;
        let list = List {
            this_update: self.made,
            next_update: Some(self.until),
            number: self.number,
            serials: self.serials.iter().cloned().collect(),
            ..List::default()
        };
        list.signed_as(issuer.der(), &ca_key(&self.organisation))
    }
}

impl Lists {
    /// The CA signs a list; answers with its bytes.
    pub fn sign(&mut self, people: &People, list: Signed) -> Bytes {
        let der = list.der(people);
        self.made.entry(list.organisation.clone()).or_default().push(der.clone());
        self.signed.insert(der.clone(), list);
        der
    }

    /// The content of a list, if a CA has signed these bytes.
    pub fn find(&self, der: &[u8]) -> Option<&Signed> {
        self.signed.get(der)
    }

    /// Those that the CA of an organisation has made, in that order.
    pub fn of(&self, organisation: &str) -> &[Bytes] {
        self.made.get(organisation).map_or(&[], Vec::as_slice)
    }
}

/// The certificates that a call revokes by a list: issuer and serial in hexadecimal. None for any other call.
pub fn listed(body: &Body) -> Vec<(String, String)> {
    let argument = body.args.first().filter(|_| body.function == "record_revocation_list");
    let record = argument.and_then(|argument| serde_json::from_slice::<RecordList>(argument).ok());
    let der = record.and_then(|record| hex::decode(record.list).ok());
    let Some(list) = der.and_then(|der| RevocationList::parse(&der).ok()) else { return Vec::new() };
    let issuer = hex::encode(list.issuer_name.hash().0);
    list.serials.iter().map(|serial| (issuer.clone(), hex::encode(serial))).collect()
}
