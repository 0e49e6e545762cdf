//! The rows: what they say, how they are named, and where they stand.

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use prost::Message;
use std::collections::BTreeSet;

/// Commands and refusals of so much block time are one row, microseconds.
pub const FOLDED_US: u64 = 60_000_000;

/// Commands under a grant, or in open mode.
const USED: &str = "used";
/// The policies that permit commands without a grant, from now on.
const PERMITTED: &str = "permitted";
/// Calls that a block holds and that were refused.
const REFUSED: &str = "refused";
/// The end of a certificate.
const REVOKED: &str = "revoked";

const NAMES: u8 = b'x';
pub(super) const PLACE_BYTES: usize = 20;

/// A decision about control.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct Row {
    /// Block time, microseconds.
    #[prost(uint64, tag = "1")]
    pub time: u64,
    /// Height of the block.
    #[prost(uint64, tag = "2")]
    pub height: u64,
    /// The name of the event, `used` for commands, or `refused`.
    #[prost(string, tag = "3")]
    pub decision: String,
    /// The identity that it is about, e.g. `Org1/Salma`; empty if nobody.
    #[prost(string, tag = "4")]
    pub who: String,
    /// The author, if that is somebody else.
    #[prost(string, tag = "5")]
    pub by: String,
    /// The robot; empty if it is about none.
    #[prost(string, tag = "6")]
    pub robot: String,
    /// The service, or what else it is about.
    #[prost(string, tag = "7")]
    pub subject: String,
    /// Number of the code of a refusal.
    #[prost(uint32, tag = "8")]
    pub code: u32,
    /// How many commands or refusals the row stands for; 1 otherwise.
    #[prost(uint64, tag = "9")]
    pub count: u64,
    /// Time of the first one; of refusals before ordering by the clock of the node that tells it.
    #[prost(uint64, tag = "10")]
    pub first: u64,
    /// Time of the last one.
    #[prost(uint64, tag = "11")]
    pub last: u64,
    /// Height of the last one.
    #[prost(uint64, tag = "12")]
    pub last_height: u64,
    /// The epoch of a grant, or of commands.
    #[prost(uint64, tag = "13")]
    pub epoch: u64,
    /// Number of the set of policies that decided; 0 if it is not known or has none.
    #[prost(uint64, tag = "14")]
    pub policy_version: u64,
    /// In words: a reason, what changed, why it was refused.
    #[prost(string, tag = "15")]
    pub detail: String,
    /// The value that was found, of a refusal.
    #[prost(string, tag = "16")]
    pub found: String,
    /// Id of the transaction, or of one of several; empty if there is none.
    #[prost(bytes = "bytes", tag = "17")]
    pub transaction: Bytes,
    /// Other identities that it concerns.
    #[prost(string, repeated, tag = "18")]
    pub others: Vec<String>,
    /// Organisations that it concerns beside those of the identities.
    #[prost(string, repeated, tag = "19")]
    pub organisations: Vec<String>,
    /// The node whose word it is: it refused before ordering. Empty if the chain itself shows it.
    #[prost(string, tag = "20")]
    pub told_by: String,
    /// Ids of the policies that decided, of the set with that number.
    #[prost(string, repeated, tag = "21")]
    pub policies: Vec<String>,
    /// The action that policies permitted or refused, e.g. `acquire`: of grants, of commands without one, and of refusals. Empty
    /// if it is not known.
    #[prost(string, tag = "22")]
    pub action: String,
    /// The certificate that was revoked: SHA-256 of its issuer's distinguished name, and behind it the serial number.
    #[prost(bytes = "bytes", tag = "23")]
    pub certificate: Bytes,
}

impl Row {
    /// A row about commands.
    pub fn is_use(&self) -> bool {
        self.decision == USED
    }

    /// A row about commands without a grant: it is made without its policies, which an earlier row tells.
    pub(super) fn is_use_without_grant(&self) -> bool {
        self.is_use() && self.epoch == 0
    }

    /// A row that tells which policies permit commands without a grant.
    pub(super) fn tells_permission(&self) -> bool {
        self.decision == PERMITTED
    }

    /// A row about refusals.
    pub fn is_refusal(&self) -> bool {
        self.decision == REFUSED
    }

    /// A row about a certificate that was revoked by its number: it is made without a name, which the index may know.
    pub(super) fn revokes_somebody(&self) -> bool {
        self.decision == REVOKED && self.who.is_empty() && !self.certificate.is_empty()
    }

    /// The identities that it concerns.
    pub fn identities(&self) -> impl Iterator<Item = &str> {
        let all = [&self.who, &self.by].into_iter().chain(&self.others).map(String::as_str);
        all.filter(|identity| !identity.is_empty())
    }

    /// The organisations that it concerns.
    pub fn organisations(&self) -> impl Iterator<Item = &str> {
        let of = self.identities().filter_map(|identity| Some(identity.split_once('/')?.0));
        of.chain(self.organisations.iter().map(String::as_str))
    }

    /// Rows of one minute with the same name are one row. None if the row stays alone.
    pub(super) fn folds_as(&self) -> Option<String> {
        let Self { decision, who, subject, epoch, code, action, told_by, policy_version, .. } = self;
        let policies = self.policies.join(",");
        let decided = if self.is_use() { format!("{policy_version}\0{policies}") } else { String::new() };
        let folds = (self.is_use() || self.is_refusal()) && told_by.is_empty();
        folds.then(|| format!("{decision}\0{who}\0{subject}\0{epoch}\0{code}\0{action}\0{decided}"))
    }

    /// The same row before anything is folded into it.
    pub(super) fn nothing_yet(&self) -> Self {
        Self { count: 0, ..self.clone() }
    }

    pub(super) fn fold(&mut self, more: &Self) {
        self.count = self.count.saturating_add(more.count);
        self.last = self.last.max(more.last);
        self.last_height = self.last_height.max(more.last_height);
        self.detail.clone_from(&more.detail);
        self.found.clone_from(&more.found);
    }

    pub(super) fn to_bytes(&self) -> Bytes {
        self.encode_to_vec().into()
    }

    pub(super) fn read(bytes: &[u8]) -> Result<Self, Rejection> {
        Self::decode(bytes).map_err(|error| {
            Rejection::new(Code::Corrupt, format!("a row of the audit cannot be read: {error}"))
                .next("stop the node and delete its directory audit/; it is rebuilt from the blocks")
        })
    }
}

/// Where a row stands: in order of time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Place {
    pub(super) time: u64,
    pub(super) height: u64,
    pub(super) number: u32,
}

impl Place {
    /// Before everything of that time.
    pub(super) fn at(time: u64) -> Self {
        Self { time, ..Self::default() }
    }

    pub(super) fn to_bytes(self) -> [u8; PLACE_BYTES] {
        let mut bytes = [0; PLACE_BYTES];
        let parts =
            self.time.to_be_bytes().into_iter().chain(self.height.to_be_bytes()).chain(self.number.to_be_bytes());
        bytes.iter_mut().zip(parts).for_each(|(byte, part)| *byte = part);
        bytes
    }

    /// The place at the end of a key; all zero of one that is too short.
    pub(super) fn of_key(key: &[u8]) -> Self {
        let bytes: [u8; PLACE_BYTES] = key.last_chunk().copied().unwrap_or_default();
        let number = |from: usize, to: usize| {
            bytes.iter().take(to).skip(from).fold(0u64, |number, byte| number << 8 | u64::from(*byte))
        };
        Self { time: number(0, 8), height: number(8, 16), number: number(16, 20) as u32 }
    }
}

/// The names by which rows are found.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    Robot = b'r' as isize,
    User = b'u' as isize,
    Organisation = b'o' as isize,
    Code = b'c' as isize,
}

pub(super) fn length(name: &str) -> [u8; 2] {
    u16::try_from(name.len()).unwrap_or(u16::MAX).to_be_bytes()
}

/// The beginning of the keys of a name.
pub(super) fn name_prefix(kind: Kind, name: &str) -> Vec<u8> {
    let mut key = vec![NAMES, kind as u8];
    key.extend_from_slice(&length(name));
    key.extend_from_slice(name.as_bytes());
    key
}

/// The keys by which a row is found.
pub(super) fn by_name<'a>(row: &'a Row, place: &'a Place) -> impl Iterator<Item = Bytes> + 'a {
    let code = if row.code > 0 { row.code.to_string() } else { String::new() };
    let mut names: BTreeSet<Vec<u8>> = BTreeSet::new();
    let mut name = |kind, name: &str| {
        if !name.is_empty() {
            names.insert(name_prefix(kind, name));
        }
    };
    name(Kind::Robot, &row.robot);
    name(Kind::Code, &code);
    row.identities().for_each(|identity| name(Kind::User, identity));
    row.organisations().for_each(|organisation| name(Kind::Organisation, organisation));
    names.into_iter().map(|mut key| {
        key.extend_from_slice(&place.to_bytes());
        Bytes::from(key)
    })
}
