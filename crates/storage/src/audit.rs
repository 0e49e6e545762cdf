//! The index of the audit: one row for each decision about control, found by time, robot, user, organisation or code.
//!
//! It follows from blocks and their results, as the world state does: whoever has lost it makes it again. Commands and refusals that
//! blocks hold are folded, one row a minute for each who, service and epoch or code. So the index of ten million commands has
//! some thousand rows.
//!
//! | key | value |
//! |---|---|
//! | `m` | version, first and last height that it knows, block time of the last |
//! | `r` place | a [`Row`]; a place is block time, height and number of the row in its block |
//! | `x` kind, length, name, place | nothing: a row that concerns a robot, a user, an organisation or a code |
//! | `g` length, service, epoch | number of the set of policies of that grant, and their ids |
//! | `p` length, service, who | the same for commands without a grant, as it is now |
//! | `h` certificate | the name of its holder, if the node has learned it from a block |

mod question;
mod row;

pub use question::{Page, Question};
pub use row::{FOLDED_US, Row};

use crate::state::{Store, WriteSet};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use row::{Place, by_name};
use std::borrow::Cow;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The form of the rows. An index of another one is made again.
const VERSION: u64 = 2;
const META: &[u8] = b"m";
const ROWS: u8 = b'r';
const GRANTS: u8 = b'g';
const PERMISSIONS: u8 = b'p';
const HOLDERS: u8 = b'h';
/// Permissions that are remembered between two writes.
const PERMISSIONS_MAX: usize = 4096;
/// Rows that are read at once.
const ROWS_AT_ONCE: usize = 256;
/// Rows that are dropped at once.
const DROPPED_AT_ONCE: usize = 1024;

/// The index over a store of its own.
pub struct Index {
    store: Box<dyn Store>,
    state: Mutex<State>,
}

/// The extent of the index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Known {
    /// The first block that it knows.
    pub from: u64,
    /// The last one.
    pub height: u64,
    /// Its block time, microseconds.
    pub time: u64,
}

struct State {
    known: Option<Known>,
    /// The rows of this minute that may still grow.
    open: HashMap<String, Growing>,
    minute: u64,
    /// The policies that permit commands without a grant, by service and identity.
    permissions: HashMap<(String, String), Decided>,
}

/// The number of a set of policies, and the ids of those that decided.
type Decided = (u64, Vec<String>);

/// A row that may still grow.
struct Growing {
    place: Place,
    row: Row,
    /// It is not in the store as it is.
    grown: bool,
}

/// The rows of one block, in order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Block {
    /// Its height.
    pub height: u64,
    /// Its time, microseconds.
    pub time: u64,
    /// Its decisions.
    pub rows: Vec<Row>,
    /// Certificates of which it tells whose they are.
    pub holders: Vec<Holder>,
}

/// The holder of a certificate.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Holder {
    /// As [`Row::certificate`].
    pub certificate: Bytes,
    /// E.g. `Org1/Salma`.
    pub name: String,
}

impl Index {
    /// The index that a store holds.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if it cannot be read, or has another form: delete it, and make it again.
    pub fn open(store: Box<dyn Store>) -> Result<Self, Rejection> {
        let state = State::read(&*store)?;
        Ok(Self { store, state: Mutex::new(state) })
    }

    /// The blocks that it knows; none yet if it is new.
    pub fn known(&self) -> Option<Known> {
        self.state().known
    }

    /// Takes the rows of the blocks that follow, and waits for the disk. Each block comes once, in order, also one without rows.
    ///
    /// # Errors
    /// [`Code::DiskFull`], [`Code::DiskFailed`]: nothing was taken.
    pub fn add(&self, blocks: &[Block]) -> Result<(), Rejection> {
        let (Some(first), Some(last)) = (blocks.first(), blocks.last()) else { return Ok(()) };
        let mut state = self.state();
        let mut writes = WriteSet::new();
        if state.permissions.len() > PERMISSIONS_MAX {
            state.permissions.clear();
        }
        for block in blocks {
            state.take(block, &*self.store, &mut writes)?;
        }
        state.write_grown(&mut writes);
        let from = state.known.map_or(first.height, |known| known.from);
        let known = Known { from, height: last.height, time: last.time };
        if let Err(fault) = self.store.write(&writes, (META, &known.to_bytes())) {
            *state = State::read(&*self.store)?;
            return Err(fault);
        }
        state.known = Some(known);
        Ok(())
    }

    /// Forgets rows of blocks before this time, some at once; true if there may be more.
    ///
    /// # Errors
    /// As [`Index::add`].
    pub fn prune(&self, from: u64, before: u64) -> Result<bool, Rejection> {
        let mut state = self.state();
        let Some(known) = state.known.filter(|known| known.from < from) else { return Ok(false) };
        let rows = self.store.range(&[ROWS], None, DROPPED_AT_ONCE)?;
        let mut writes = WriteSet::new();
        let old =
            rows.iter().map(|(key, value)| (key, Place::of_key(key), value)).take_while(|(_, p, _)| p.time < before);
        for (key, place, value) in old {
            writes.insert(key.clone(), None);
            let row = Row::read(value)?;
            writes.extend(by_name(&row, &place).map(|key| (key, None)));
            writes.extend(grant_of(&row).map(|(key, _)| (key, None)));
        }
        let more =
            writes.contains_key(rows.last().map_or(&Bytes::new(), |(key, _)| key)) && rows.len() == DROPPED_AT_ONCE;
        let known = if more { known } else { Known { from, ..known } };
        self.store.write(&writes, (META, &known.to_bytes()))?;
        state.known = Some(known);
        Ok(more)
    }

    /// The number of the set of policies under which a grant was given, and the ids of those that permitted it.
    ///
    /// # Errors
    /// [`Code::Corrupt`], [`Code::DiskFailed`].
    pub fn policies_of(&self, service: &str, epoch: u64) -> Result<(u64, Vec<String>), Rejection> {
        decided(&*self.store, &grant_key(service, epoch))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// As the store has it.
    fn read(store: &dyn Store) -> Result<Self, Rejection> {
        let known = store.get(META)?.map(|bytes| Known::from_bytes(&bytes)).transpose()?;
        let minute = known.map_or(0, |known| known.time / FOLDED_US);
        let mut state = Self { known, minute, open: HashMap::new(), permissions: HashMap::new() };
        let mut after = place_key(ROWS, &Place::at(minute * FOLDED_US));
        loop {
            let pairs = store.range(&[ROWS], Some(&after), ROWS_AT_ONCE)?;
            let Some((last, _)) = pairs.last() else { return Ok(state) };
            after = last.to_vec();
            for (key, value) in &pairs {
                let (place, row) = (Place::of_key(key), Row::read(value)?);
                state.open.extend(row.folds_as().map(|name| (name, Growing { place, row, grown: false })));
            }
        }
    }

    fn take(&mut self, block: &Block, store: &dyn Store, writes: &mut WriteSet) -> Result<(), Rejection> {
        if block.time / FOLDED_US != self.minute {
            self.write_grown(writes);
            self.minute = block.time / FOLDED_US;
            self.open.clear();
        }
        for Holder { certificate, name } in &block.holders {
            writes.insert(holder_key(certificate), Some(Bytes::copy_from_slice(name.as_bytes())));
        }
        for (number, row) in (0u32..).zip(&block.rows) {
            let place = Place { time: block.time, height: block.height, number };
            let row = with_holder(self.with_permission(row, store)?, store, writes)?;
            match row.folds_as() {
                None => put(&place, &row, writes),
                Some(name) => {
                    let nothing = || Growing { place, row: row.nothing_yet(), grown: true };
                    let growing = self.open.entry(name).or_insert_with(nothing);
                    growing.row.fold(&row);
                    growing.grown = true;
                }
            }
        }
        Ok(())
    }

    /// The row, with the policies that permit its commands if no grant stands behind them.
    fn with_permission<'a>(&mut self, row: &'a Row, store: &dyn Store) -> Result<Cow<'a, Row>, Rejection> {
        let whose = || (row.subject.clone(), row.who.clone());
        if row.tells_permission() {
            self.permissions.insert(whose(), (row.policy_version, row.policies.clone()));
        }
        if !row.is_use_without_grant() {
            return Ok(Cow::Borrowed(row));
        }
        let (policy_version, policies) = match self.permissions.entry(whose()) {
            Entry::Occupied(known) => known.get().clone(),
            Entry::Vacant(place) => place.insert(decided(store, &permission_key(&row.subject, &row.who))?).clone(),
        };
        Ok(Cow::Owned(Row { policy_version, policies, ..row.clone() }))
    }

    fn write_grown(&mut self, writes: &mut WriteSet) {
        for growing in self.open.values_mut().filter(|growing| growing.grown) {
            put(&growing.place, &growing.row, writes);
            growing.grown = false;
        }
    }
}

/// The row, with the holder of a certificate that was revoked by its number.
fn with_holder<'a>(row: Cow<'a, Row>, store: &dyn Store, writes: &WriteSet) -> Result<Cow<'a, Row>, Rejection> {
    if !row.revokes_somebody() {
        return Ok(row);
    }
    let key = holder_key(&row.certificate);
    let known = match writes.get(&key) {
        Some(written) => written.clone(),
        None => store.get(&key)?,
    };
    let Some(name) = known else { return Ok(row) };
    Ok(Cow::Owned(Row { who: String::from_utf8_lossy(&name).into_owned(), ..row.into_owned() }))
}

fn put(place: &Place, row: &Row, writes: &mut WriteSet) {
    writes.insert(place_key(ROWS, place).into(), Some(row.to_bytes()));
    writes.extend(by_name(row, place).map(|key| (key, Some(Bytes::new()))));
    writes.extend(grant_of(row).map(|(key, value)| (key, Some(value))));
    if row.tells_permission() {
        writes.insert(permission_key(&row.subject, &row.who).into(), Some(policies_of(row)));
    }
}

fn grant_of(row: &Row) -> Option<(Bytes, Bytes)> {
    let is_grant = row.decision == "granted" && (row.policy_version > 0 || !row.policies.is_empty());
    is_grant.then(|| (grant_key(&row.subject, row.epoch).into(), policies_of(row)))
}

/// The policies of a row, as a row with nothing else.
fn policies_of(row: &Row) -> Bytes {
    let Row { policy_version, policies, .. } = row.clone();
    Row { policy_version, policies, ..Row::default() }.to_bytes()
}

/// The policies under a key; none if they are not known.
fn decided(store: &dyn Store, key: &[u8]) -> Result<Decided, Rejection> {
    let row = store.get(key)?.map(|value| Row::read(&value)).transpose()?.unwrap_or_default();
    Ok((row.policy_version, row.policies))
}

fn grant_key(service: &str, epoch: u64) -> Vec<u8> {
    key_of(GRANTS, service, &epoch.to_be_bytes())
}

fn permission_key(service: &str, who: &str) -> Vec<u8> {
    key_of(PERMISSIONS, service, who.as_bytes())
}

fn holder_key(certificate: &[u8]) -> Bytes {
    [&[HOLDERS][..], certificate].concat().into()
}

fn key_of(kind: u8, service: &str, rest: &[u8]) -> Vec<u8> {
    [&[kind][..], &row::length(service), service.as_bytes(), rest].concat()
}

fn place_key(kind: u8, place: &Place) -> Vec<u8> {
    let mut key = vec![kind];
    key.extend_from_slice(&place.to_bytes());
    key
}

impl Known {
    fn to_bytes(self) -> Vec<u8> {
        [VERSION, self.from, self.height, self.time].iter().flat_map(|number| number.to_be_bytes()).collect()
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let numbers: Vec<u64> = bytes.as_chunks().0.iter().map(|chunk| u64::from_be_bytes(*chunk)).collect();
        match *numbers.as_slice() {
            [VERSION, from, height, time] if bytes.len() == 32 => Ok(Self { from, height, time }),
            _ => Err(Rejection::new(Code::Corrupt, "the audit index has another format")
                .found(format!("{} bytes", bytes.len()))
                .next("delete the directory audit/ while the node is stopped; it is rebuilt from the blocks")),
        }
    }
}
