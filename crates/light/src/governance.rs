//! Governance: the organisations, nodes, voters and revocations of a height, followed from a pinned beginning.
//!
//! All control state of the chaincode `msp` is *governing*. Each block that writes some is a [`Change`], and the governing
//! chain in the ground of each certified block covers all changes. So a reader who holds the changes since its pinned
//! beginning, and one certificate, knows that it holds all of them, and that none is made up.
//!
//! A certificate counts if the voters that the reader believes are enough in it, and the voters after the changes are, too.
//! So a reader can go over many changes at once while enough of the earlier voters still vote, and needs the certificates
//! of blocks between only where they do not.

use crate::certificate::Certificate;
use crate::codec::{Reader, put};
use crate::control::{self, Write};
use crate::proof::{Ground, Proof};
use crate::statement::Statement;
use crate::voters::{CertificateRule, Voter, Voters};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::msp::{Msp, Msps};
use ledger_identity::units::Units;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};

const DOMAIN: &[u8] = b"ledgerd governing writes v1\0";
/// Longest key of a write.
const KEY_BYTES_MAX: usize = 4096;
/// Longest value of a write.
const VALUE_BYTES_MAX: usize = 1024 * 1024;
/// Longest encoding of the governing writes of one block: those of a network that begins with all it has.
pub const CHANGE_BYTES_MAX: usize = 16 * 1024 * 1024;

const BARRED: &[u8] = b"msp\0barred/";
const CERTIFICATE_RULE: &[u8] = b"msp\0certificates";
const MEMBERS: &[u8] = b"msp\0members";
const NODES: &[u8] = b"msp\0node/";
const ORGANISATIONS: &[u8] = b"msp\0organisation/";
const REVOKED: &[u8] = b"msp\0revoked/";
const RECOVERIES: &[u8] = b"msp\0recovery/";

/// The governing writes of a block, with their values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// Height of the block.
    pub height: u64,
    /// In ascending order of keys; no value if the key was deleted.
    pub writes: Vec<(Bytes, Option<Bytes>)>,
}

impl Change {
    /// The bytes of its writes. The height stands beside them.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = DOMAIN.to_vec();
        bytes.extend_from_slice(&(self.writes.len() as u32).to_be_bytes());
        for (key, value) in &self.writes {
            put(&mut bytes, key);
            bytes.push(u8::from(value.is_some()));
            value.iter().for_each(|value| put(&mut bytes, value));
        }
        bytes.into()
    }

    /// Reads the writes of the block at that height.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(height: u64, bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("governing writes", CHANGE_BYTES_MAX, DOMAIN, bytes)?;
        let mut writes = Vec::new();
        for _ in 0..reader.u32()? {
            let key = reader.part_owned(KEY_BYTES_MAX)?;
            let value = match reader.byte()? {
                0 => None,
                1 => Some(reader.part_owned(VALUE_BYTES_MAX)?),
                _ => return Err(reader.malformed("another mark", "0 for a deleted key, 1 for a value")),
            };
            writes.push((key, value));
        }
        reader.end()?;
        Ok(Self { height, writes })
    }

    /// The governing chain after it.
    ///
    /// # Errors
    /// [`Code::Malformed`] if its keys are not in order.
    pub fn extend(&self, chain: Hash) -> Result<Hash, Rejection> {
        let hash = |value: &Option<Bytes>| value.as_ref().map(|value| Hash::of(&[value]));
        let writes: Vec<_> = self.writes.iter().map(|(key, value)| Write { key, value: hash(value) }).collect();
        control::extend(chain, self.height, &writes)
    }
}

/// The governance of a network after a block, as far as a reader has followed it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Governance {
    network: Hash,
    height: u64,
    time: u64,
    chain: Hash,
    state: BTreeMap<Bytes, Bytes>,
}

/// The nodes whose signatures count, and their organisations.
struct View {
    voters: Voters,
    msps: Msps,
}

#[derive(Deserialize)]
struct Members {
    voters: BTreeSet<u64>,
    outgoing: BTreeSet<u64>,
}

#[derive(Deserialize)]
struct Node {
    id: u64,
    name: String,
    organisation: String,
}

/// A name whose certificates were revoked.
#[derive(Deserialize)]
struct Barred {
    organisation: String,
    name: String,
    time: u64,
}

#[derive(Deserialize)]
struct Organisation {
    name: String,
    roots: Vec<String>,
    #[serde(default)]
    intermediates: Vec<String>,
    #[serde(default)]
    units: Option<Units>,
}

impl Governance {
    /// The beginning of a network: the governing writes of its genesis, which the name of the network covers. The caller
    /// has made them from the genesis. `time` is that of the genesis, microseconds since the UNIX epoch.
    ///
    /// # Errors
    /// [`Code::Malformed`] if the keys are not in order.
    pub fn founded(network: Hash, time: u64, genesis: &Change) -> Result<Self, Rejection> {
        let nothing = Self { network, height: 0, time, chain: Hash::ZERO, state: BTreeMap::new() };
        let founded = nothing.after(genesis)?;
        Ok(Self { height: 0, ..founded })
    }

    /// The network.
    pub fn network(&self) -> Hash {
        self.network
    }

    /// The certified block up to which it is known; 0 is the genesis.
    pub fn height(&self) -> u64 {
        self.height
    }

    /// Block time of that block, microseconds since the UNIX epoch.
    pub fn time(&self) -> u64 {
        self.time
    }

    /// The governing chain after that block.
    pub fn chain(&self) -> Hash {
        self.chain
    }

    /// The authorities of the organisations.
    ///
    /// # Errors
    /// [`Code::Malformed`] if a record cannot be read.
    pub fn msps(&self) -> Result<Msps, Rejection> {
        let mut msps = Msps::new();
        for (key, value) in self.under(ORGANISATIONS) {
            let Organisation { name, roots, intermediates, units } = parse(key, value)?;
            let msp = Msp::new(&name, &certificates(key, &roots)?, &certificates(key, &intermediates)?)?;
            msps.insert(msp.with_units(units)?)?;
        }
        Ok(msps)
    }

    /// Has this identity's certificate been revoked, by itself or with its name?
    pub fn is_revoked(&self, identity: &Identity) -> bool {
        let barred = || {
            let value = self.state.get(&[BARRED, identity.id().as_bytes()].concat()[..])?;
            Some(serde_json::from_slice::<Barred>(value).map_or(u64::MAX, |barred| barred.time))
        };
        self.state.contains_key(&[REVOKED, &identity.revocation_key()].concat()[..])
            || barred().is_some_and(|time| identity.valid_from <= time)
    }

    /// Names whose certificates were revoked, each as `ORGANISATION/NAME` with the time up to which they begin, microseconds
    /// since the UNIX epoch.
    ///
    /// # Errors
    /// [`Code::Malformed`] if a record cannot be read.
    pub fn barred(&self) -> Result<BTreeMap<String, u64>, Rejection> {
        let read = |(key, value): (&[u8], &[u8])| {
            let Barred { organisation, name, time } = parse(key, value)?;
            Ok(([&*organisation, "/", &*name].concat(), time))
        };
        self.under(BARRED).map(read).collect()
    }

    /// Keys of the revoked certificates ([`Identity::revocation_key`]).
    pub fn revocations(&self) -> impl Iterator<Item = &[u8]> {
        self.under(REVOKED).filter_map(|(key, _)| key.strip_prefix(REVOKED))
    }

    /// The voters of the next block.
    ///
    /// # Errors
    /// [`Code::Malformed`] if a record cannot be read.
    pub fn voters(&self) -> Result<Voters, Rejection> {
        let members = self.state.get(MEMBERS).ok_or_else(|| unreadable(MEMBERS, "no members"))?;
        let Members { voters, outgoing } = parse(MEMBERS, members)?;
        let mut nodes = BTreeMap::new();
        for (key, value) in self.under(NODES) {
            let Node { id, name, organisation } = parse(key, value)?;
            nodes.insert(id, Voter { organisation, name });
        }
        let (rule, recoveries) = (self.certificate_rule()?, self.under(RECOVERIES).count() as u64);
        Ok(Voters { nodes, voters, outgoing, rule, recoveries })
    }

    /// How many signatures make a certificate of the next block.
    ///
    /// # Errors
    /// [`Code::Malformed`] if the record cannot be read.
    pub fn certificate_rule(&self) -> Result<CertificateRule, Rejection> {
        let rule = self.state.get(CERTIFICATE_RULE).map(|rule| parse(CERTIFICATE_RULE, rule));
        Ok(rule.transpose()?.unwrap_or_default())
    }

    /// Goes on to the block of a proof, over the changes up to it; later ones are left alone.
    ///
    /// # Errors
    /// [`Code::Untrusted`] if the changes are not all, or not those of the network, or too few voters have signed;
    /// [`Code::WrongNetwork`]; [`Code::Malformed`]. Nothing of what was shown is to be believed then.
    pub fn follow(&self, changes: &[Change], proof: &Proof) -> Result<Self, Rejection> {
        let certificate = &proof.certificate;
        let (height, time) = (certificate.statement.height, certificate.statement.time);
        if height < self.height {
            return Err(Rejection::new(Code::Untrusted, "a certificate is older than what is known")
                .found(format!("block {height}"))
                .wanted(format!("block {} or later", self.height))
                .next("ask another node"));
        }
        let mut before = self.clone();
        for change in changes.iter().filter(|change| change.height > self.height && change.height < height) {
            before = before.after(change)?;
        }
        let last = changes.iter().find(|change| change.height == height && height > self.height);
        let after = match last {
            Some(change) => before.after(change)?,
            None => before.clone(),
        };
        let ground = proof.ground()?;
        if ground.governing != after.chain {
            return Err(Rejection::new(Code::Untrusted, "changes of the network were left out or made up")
                .found(format!("governing chain {} at block {height}", after.chain))
                .wanted(format!("the certified one, {}", ground.governing))
                .next("ask another node"));
        }
        self.check(certificate)?;
        if before.chain != self.chain {
            before.check(certificate)?;
        }
        Ok(Self { height, time, ..after })
    }

    /// Have enough of the voters that are known here signed it?
    ///
    /// # Errors
    /// As [`Certificate::verify`].
    pub fn check(&self, certificate: &Certificate) -> Result<(), Rejection> {
        let View { voters, msps } = self.view()?;
        certificate.verify(&self.network, &voters, |der, time| {
            let identity = msps.verify(der, &[], time)?;
            if self.is_revoked(&identity) {
                return Err(Rejection::new(Code::Revoked, "a statement is signed with a revoked certificate")
                    .found(identity.id())
                    .wanted("a certificate that is not revoked"));
            }
            Ok(identity)
        })
    }

    /// The governance by which the block at a height was executed. A proof must have shown before that the changes are all
    /// ([`Governance::follow`]).
    ///
    /// # Errors
    /// [`Code::Malformed`] if keys are not in order.
    pub fn before(&self, height: u64, changes: &[Change]) -> Result<Self, Rejection> {
        let mut earlier = changes.iter().filter(|change| change.height > self.height && change.height < height);
        earlier.try_fold(self.clone(), |before, change| before.after(change))
    }

    /// The governance after the block at a height, by these changes of the reader's own chain, which the reader has executed.
    ///
    /// # Errors
    /// [`Code::Malformed`] if keys are not in order.
    pub fn as_of(&self, height: u64, changes: &[Change]) -> Result<Self, Rejection> {
        let after = self.before(height.saturating_add(1), changes)?;
        Ok(Self { height: height.max(self.height), ..after })
    }

    /// Is it a strict certificate, by the voters that are known here?
    ///
    /// # Errors
    /// [`Code::Untrusted`] if certificates are not strict here; as [`Certificate::verify`].
    pub fn check_strict(&self, certificate: &Certificate) -> Result<(), Rejection> {
        if self.certificate_rule()?.strict_since.is_none() {
            return Err(Rejection::new(Code::Untrusted, "certificates are not strict as of this block")
                .found(format!("a certificate of block {}", certificate.statement.height))
                .wanted("a strict certificate: one organisation that lies can complete two others"));
        }
        self.check(certificate)
    }

    /// Is it a strict certificate of a branch that begins here? That is by the voters that are known here, and by all voters after
    /// the changes of the branch, up to those as of the block before the certified one.
    ///
    /// # Errors
    /// As [`Governance::check_strict`].
    pub fn check_branch(&self, changes: &[Change], certificate: &Certificate) -> Result<(), Rejection> {
        let height = certificate.statement.height;
        let mut since = self.clone();
        since.check_strict(certificate)?;
        for change in changes.iter().filter(|change| change.height > self.height && change.height < height) {
            let before = since.voters()?;
            since = since.after(change)?;
            if since.voters()? != before {
                since.check_strict(certificate)?;
            }
        }
        since.check_strict(certificate)
    }

    /// Its values, as if one block had written them all.
    pub(crate) fn all(&self) -> Change {
        let writes = self.state.iter().map(|(key, value)| (key.clone(), Some(value.clone()))).collect();
        Change { height: self.height, writes }
    }

    /// With these values at the block of a proof, whose paths were checked.
    pub(crate) fn of(values: Change, (statement, ground): (&Statement, Ground)) -> Self {
        let state = values.writes.into_iter().filter_map(|(key, value)| Some((key, value?))).collect();
        let Statement { network, height, time, .. } = *statement;
        Self { network, height, time, chain: ground.governing, state }
    }

    fn after(&self, change: &Change) -> Result<Self, Rejection> {
        let mut after = self.clone();
        after.chain = change.extend(self.chain)?;
        for (key, value) in &change.writes {
            match value {
                Some(value) => after.state.insert(key.clone(), value.clone()),
                None => after.state.remove(key),
            };
        }
        Ok(after)
    }

    fn view(&self) -> Result<View, Rejection> {
        Ok(View { voters: self.voters()?, msps: self.msps()? })
    }

    fn under<'a>(&'a self, prefix: &'static [u8]) -> impl Iterator<Item = (&'a [u8], &'a [u8])> {
        let from = self.state.range(Bytes::from_static(prefix)..);
        from.take_while(move |(key, _)| key.starts_with(prefix)).map(|(key, value)| (&key[..], &value[..]))
    }
}

fn parse<T: DeserializeOwned>(key: &[u8], value: &[u8]) -> Result<T, Rejection> {
    serde_json::from_slice(value).map_err(|error| unreadable(key, &error.to_string()))
}

fn certificates(key: &[u8], hexadecimal: &[String]) -> Result<Vec<Vec<u8>>, Rejection> {
    let decoded = hexadecimal.iter().map(hex::decode).collect::<Result<_, _>>();
    decoded.map_err(|error| unreadable(key, &error.to_string()))
}

fn unreadable(key: &[u8], found: &str) -> Rejection {
    let key = String::from_utf8_lossy(key).replace('\0', "/");
    Rejection::new(Code::Malformed, format!("the record {key} of the network cannot be read"))
        .found(found)
        .wanted("a record that this release knows")
        .next("install the release that the nodes of the network run, or ask another node")
}
