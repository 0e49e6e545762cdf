//! The network of the paper in memory: two organisations, their people, three robots, and a block at a time.

use bytes::Bytes;
use ledger::msp::{CertifiedHolder, QUOTAS, Quotas};
use ledger::{Chaincode, Context, Environment, Meter, Registry, Revocation, Rules};
use ledger_abac::{AccessControl, PolicyDraft, PolicyText};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::PublicKey;
use ledger_identity::{Identity, Role};
use ledger_storage::result::Event;
use ledger_storage::state::{MemoryState, Overlay, StateRead, WriteSet};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// Block time of the first block: 2026-11-21T00:00:00Z.
pub(crate) const START: u64 = 1_795_219_200_000_000;
pub(crate) const SECOND: u64 = 1_000_000;
pub(crate) const TURTLEBOT: &str = "Turtlebot4/cmd_vel";
pub(crate) const HUSKY: &str = "Husky/cmd_vel";
/// The id of a transaction that was executed.
pub(crate) const EXECUTED: Hash = Hash([0xee; 32]);
/// A Twist that stands still.
pub(crate) const TWIST: [u8; 52] = {
    let mut message = [0; 52];
    message[1] = 1;
    message
};

/// Stands in for the membership chaincode: knows the names of the organisations, and certificates.
/// It tells people whom CAs have certified only in tests that ask for it: most put policies that few may use.
pub(crate) struct Members(
    pub(crate) Mutex<Vec<&'static str>>,
    pub(crate) Mutex<Vec<Identity>>,
    pub(crate) Mutex<Vec<&'static str>>,
    pub(crate) Mutex<Quotas>,
);

impl Chaincode for Members {
    fn name(&self) -> &'static str {
        "msp"
    }

    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        match function {
            "holder" => self.holder(&args[0]),
            "enrolled" => Ok(serde_json::json!({"items": *self.2.lock().unwrap()}).to_string().into()),
            "identities" => self.identities(&ctx.submitter()?.organisation),
            "quotas" => Ok(serde_json::to_vec(&*self.3.lock().unwrap()).unwrap().into()),
            _ => Ok(serde_json::to_vec(&*self.0.lock().unwrap()).unwrap().into()),
        }
    }
}

impl Members {
    fn identities(&self, organisation: &str) -> Result<Bytes, Rejection> {
        let known = self.1.lock().unwrap();
        let mut names: Vec<&str> =
            known.iter().filter(|known| known.organisation == organisation).map(|known| known.name.as_str()).collect();
        names.sort_unstable();
        let items = names.iter().map(|name| serde_json::json!({"organisation": organisation, "name": name}));
        Ok(serde_json::json!({"items": items.collect::<Vec<_>>()}).to_string().into())
    }

    fn holder(&self, id: &[u8]) -> Result<Bytes, Rejection> {
        let known = self.1.lock().unwrap();
        let found = known.iter().rev().find(|known| known.id().as_bytes() == id);
        let Identity { organisation, name, role, attributes, issuer, serial, fingerprint, not_after, .. } = found
            .cloned()
            .ok_or_else(|| Rejection::new(Code::NotFound, "no identity with a valid certificate has this name"))?;
        let (issuer, serial, fingerprint) = (Hash(issuer), hex::encode(&serial), Hash(fingerprint));
        let holder = CertifiedHolder { organisation, name, role, attributes, issuer, serial, fingerprint, not_after };
        Ok(serde_json::to_vec(&holder).unwrap().into())
    }
}

/// A ledger with the chaincode installed. Every call is a block of its own, a millisecond after the one before.
pub(crate) struct Fleet {
    pub(crate) abac: Arc<AccessControl>,
    pub(crate) members: Arc<Members>,
    registry: Registry,
    pub(crate) state: Arc<MemoryState>,
    pub(crate) height: u64,
    pub(crate) time: u64,
    /// Id of the transactions; zero for queries.
    pub(crate) transaction: Hash,
    /// Everything that was ever emitted.
    pub(crate) events: Vec<Event>,
    /// The writes of each block.
    pub(crate) writes: Vec<WriteSet>,
    /// The next call comes in the block of the one before.
    pub(crate) joins: bool,
    /// Counts what the calls of the newest block use.
    pub(crate) meter: Meter,
}

pub(crate) fn identity(organisation: &str, name: &str, role: Role, attributes: &[&str], serial: u8) -> Identity {
    let attributes: BTreeMap<String, String> =
        attributes.iter().map(|key| ((*key).to_owned(), "true".to_owned())).collect();
    Identity {
        organisation: organisation.to_owned(),
        name: name.to_owned(),
        role,
        attributes,
        issuer: Hash::of(&[organisation.as_bytes()]).0,
        serial: vec![serial],
        fingerprint: Hash::of(&[organisation.as_bytes(), name.as_bytes(), &[serial]]).0,
        public_key: public_key(),
        valid_from: 0,
        not_before: 0,
        not_after: START + 365 * 86_400 * SECOND,
    }
}

/// Any key: nothing here verifies signatures. Algorithm Ed25519, then the base point of its curve.
fn public_key() -> PublicKey {
    let mut spki = hex::decode("302a300506032b6570032100").unwrap();
    spki.push(0x58);
    spki.extend([0x66; 31]);
    PublicKey::from_spki(&spki).unwrap()
}

pub(crate) fn salma() -> Identity {
    identity("Org1", "Salma", Role::Member, &["Turtlebot4", "Husky", "OptiTrack"], 1)
}

pub(crate) fn farhad() -> Identity {
    identity("Org1", "Farhad", Role::Member, &["Turtlebot4"], 2)
}

pub(crate) fn admin1() -> Identity {
    identity("Org1", "admin", Role::Admin, &[], 3)
}

pub(crate) fn owner() -> Identity {
    identity("Org2", "admin", Role::Admin, &[], 4)
}

pub(crate) fn camera() -> Identity {
    identity("Org2", "OptiTrack", Role::Robot, &[], 5)
}

/// The JSON of a robot with one command service on `/cmd_vel`.
pub(crate) fn robot(name: &str, mode: &str) -> String {
    format!(
        r#"{{"name":"{name}","trusted":["Org1","Org2"],"attribute_required":"{name}",
            "services":[{{"topic":"/cmd_vel","type":"geometry_msgs/msg/Twist","mode":"{mode}"}}]}}"#
    )
}

pub(crate) const OPTITRACK: &str = r#"{"name":"OptiTrack","attribute_required":"OptiTrack","trusted":["Org1","Org2"],"services":
    [{"topic":"/poses","type":"geometry_msgs/msg/PoseStamped","direction":"feed"}]}"#;

/// Text and bytes as arguments.
pub(crate) fn bytes(args: &[&str]) -> Vec<Bytes> {
    args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect()
}

impl Fleet {
    /// A network of Org1 and Org2 without robots.
    pub(crate) fn empty() -> Self {
        let mut fleet = Self::of(AccessControl::new().unwrap());
        fleet.forget();
        fleet
    }

    /// A network of Org1 and Org2 without robots, with this chaincode.
    pub(crate) fn with(abac: AccessControl) -> Self {
        let mut fleet = Self::of(abac);
        fleet.install();
        fleet
    }

    fn of(abac: AccessControl) -> Self {
        Self {
            abac: Arc::new(abac),
            members: Arc::new(Members(
                Mutex::new(vec!["Org1", "Org2"]),
                Mutex::new(vec![salma(), farhad(), admin1(), owner(), camera()]),
                Mutex::default(),
                Mutex::new(QUOTAS),
            )),
            registry: Registry::new(),
            state: Arc::new(MemoryState::default()),
            height: 0,
            time: START,
            transaction: Hash::ZERO,
            events: vec![],
            writes: vec![],
            joins: false,
            meter: Meter::of_query(),
        }
    }

    /// The network of the paper: Org2 registered its three robots.
    pub(crate) fn of_the_paper() -> Self {
        let mut fleet = Self::empty();
        let (turtlebot, husky) = (robot("Turtlebot4", "exclusive"), robot("Husky", "exclusive"));
        fleet.ok(&owner(), "setup", &[&turtlebot, &husky, OPTITRACK]);
        fleet
    }

    /// Replaces the chaincode by a new instance, as a restart does: its caches are cold.
    pub(crate) fn forget(&mut self) {
        self.abac = Arc::new(AccessControl::new().unwrap());
        self.install();
    }

    fn install(&mut self) {
        self.registry = Registry::new();
        self.registry.install(self.abac.clone()).unwrap();
        self.registry.install(self.members.clone()).unwrap();
    }

    /// Executes one block with one call; returns its outcome. Events of this block are the last of `events`.
    pub(crate) fn call(&mut self, who: &Identity, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        let args = &self.with_one_changed(who, function, args)?;
        self.block(|fleet, overlay, events| {
            Registry::invoke(fleet.environment(Some(who)), overlay, events, "abac", function, args)
        })
    }

    /// `policy put ID TEXT [i-mean-it]` and `policy remove ID [i-mean-it]` as `ledgerctl` does them: the set in force with one
    /// policy changed, applied with its number.
    fn with_one_changed(&self, who: &Identity, function: &str, args: &[Bytes]) -> Result<Vec<Bytes>, Rejection> {
        let text = |bytes: &Bytes| String::from_utf8(bytes.to_vec()).unwrap();
        let given = if function == "policy" { args } else { &[] };
        let given: Vec<&str> = given.iter().map(|arg| std::str::from_utf8(arg).unwrap_or_default()).collect();
        let (id, new, means_it) = match given.as_slice() {
            ["put", id, text] => (*id, Some(*text), false),
            ["put", id, text, "i-mean-it"] => (*id, Some(*text), true),
            ["remove", id] => (*id, None, false),
            ["remove", id, "i-mean-it"] => (*id, None, true),
            _ => return Ok(args.to_vec()),
        };
        let prefix = format!("abac\0policy/{}/", who.organisation);
        let pairs = self.state.range(prefix.as_bytes(), None, usize::MAX).unwrap();
        let policy =
            |(key, value): &(Bytes, Bytes)| PolicyText { id: text(key)[prefix.len()..].to_owned(), text: text(value) };
        let mut policies: Vec<PolicyText> = pairs.iter().map(policy).collect();
        let before = policies.len();
        policies.retain(|policy| policy.id != id);
        match new {
            Some(new) => policies.push(PolicyText { id: id.to_owned(), text: new.to_owned() }),
            None if policies.len() < before => {}
            None => return Err(Rejection::new(Code::NotFound, format!("{} has no policy {id:?}", who.organisation))),
        }
        let version = self.state.get(format!("abac\0version/{}", who.organisation).as_bytes()).unwrap();
        let number = version.and_then(|version| version.last_chunk::<8>().copied()).map_or(0, u64::from_be_bytes);
        let draft = PolicyDraft { policies: Some(policies), base: Some(number), means_it, ..PolicyDraft::default() };
        Ok(bytes(&["apply", &serde_json::to_string(&draft).unwrap()]))
    }

    /// A call that must succeed and whose answer is thrown away.
    #[track_caller]
    pub(crate) fn ok(&mut self, who: &Identity, function: &str, args: &[&str]) {
        self.call(who, function, &bytes(args)).unwrap();
    }

    /// A call that must succeed, with its answer.
    #[track_caller]
    pub(crate) fn get<T: DeserializeOwned>(&mut self, who: &Identity, function: &str, args: &[&str]) -> T {
        serde_json::from_slice(&self.call(who, function, &bytes(args)).unwrap()).unwrap()
    }

    /// A call that must be refused with that code.
    #[track_caller]
    pub(crate) fn refused(&mut self, who: &Identity, code: Code, function: &str, args: &[&str]) -> Rejection {
        let rejection = self.call(who, function, &bytes(args)).unwrap_err();
        assert_eq!(rejection.code, code, "{rejection}");
        rejection
    }

    /// `set` with messages that stand still.
    pub(crate) fn set(
        &mut self,
        who: &Identity,
        service: &str,
        epoch: u64,
        first_seq: u64,
        count: usize,
    ) -> Result<Bytes, Rejection> {
        let mut args = bytes(&[service, &epoch.to_string(), &first_seq.to_string()]);
        args.extend(std::iter::repeat_n(Bytes::from_static(&TWIST), count));
        self.call(who, "set", &args)
    }

    /// Publishing must be refused with that code.
    #[track_caller]
    pub(crate) fn set_refused(&mut self, who: &Identity, code: Code, service: &str, epoch: u64, seq: u64) -> Rejection {
        let rejection = self.set(who, service, epoch, seq, 1).unwrap_err();
        assert_eq!(rejection.code, code, "{rejection}");
        rejection
    }

    /// An empty block, as the leader orders when a deadline passes.
    pub(crate) fn tick(&mut self) {
        self.block(|_, _, _| Ok(Bytes::new())).unwrap();
    }

    /// A block that revokes a certificate.
    pub(crate) fn revoke(&mut self, who: &Identity) {
        let revoked = Revocation { issuer: who.issuer, serial: who.serial.clone() };
        self.block(|fleet, overlay, events| {
            fleet.hook(overlay, events, |ctx| fleet.abac.identity_revoked(ctx, &revoked));
            Ok(Bytes::new())
        })
        .unwrap();
    }

    /// A block in which an organisation loses the authority that has certified this identity.
    pub(crate) fn lose_authority(&mut self, who: &Identity) {
        self.block(|fleet, overlay, events| {
            fleet.hook(overlay, events, |ctx| fleet.abac.authority_lost(ctx, &who.issuer));
            Ok(Bytes::new())
        })
        .unwrap();
    }

    /// A block with a call that the network has approved.
    pub(crate) fn approved(&mut self, function: &str, args: &[&str]) {
        self.block(|fleet, overlay, events| {
            let mut ctx = Context::new(fleet.environment(None), "abac", overlay, events);
            fleet.abac.invoke(&mut ctx, function, &bytes(args))
        })
        .unwrap();
    }

    /// A block that removes an organisation.
    pub(crate) fn remove_organisation(&mut self, organisation: &str) {
        self.block(|fleet, overlay, events| {
            fleet.hook(overlay, events, |ctx| fleet.abac.organisation_removed(ctx, organisation));
            Ok(Bytes::new())
        })
        .unwrap();
    }

    /// How many keys of the chaincode begin so.
    pub(crate) fn keys(&self, prefix: &str) -> usize {
        self.look(None, |ctx, _| ctx.range(prefix.as_bytes(), usize::MAX).len())
    }

    /// When the leader should tick next.
    pub(crate) fn next_deadline(&self) -> Option<u64> {
        self.look(None, |ctx, abac| abac.next_deadline(ctx))
    }

    /// May that identity read this event?
    pub(crate) fn may_read(&self, who: &Identity, event: &Event) -> Result<(), Rejection> {
        self.look(Some(who), |ctx, abac| abac.may_read(ctx, event))
    }

    /// May that identity follow events of these names about these subjects?
    pub(crate) fn may_follow(&self, who: &Identity, subjects: &[&str], names: &[&str]) -> Result<(), Rejection> {
        let [subjects, names] =
            [subjects, names].map(|list| list.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>());
        self.look(Some(who), |ctx, abac| abac.may_follow(ctx, &subjects, &names))
    }

    /// Names and subjects of the events of the last block.
    pub(crate) fn told(&self, since: usize) -> Vec<(&str, &str)> {
        self.events[since..].iter().map(|event| (event.name.as_str(), event.subject.as_str())).collect()
    }

    /// The payload of the newest event of that name.
    #[track_caller]
    pub(crate) fn newest<T: DeserializeOwned>(&self, name: &str) -> T {
        let event = self.events.iter().rev().find(|event| event.name == name).expect("no such event");
        serde_json::from_slice(&event.payload).unwrap()
    }

    /// Executes on the committed state and throws the writes away, as gateways do before they order a call.
    pub(crate) fn simulate(&self, who: &Identity, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        let args = self.with_one_changed(who, function, args)?;
        let mut overlay = Overlay::new(self.state.clone());
        Registry::invoke(self.environment(Some(who)), &mut overlay, &mut vec![], "abac", function, &args)
    }

    fn look<T>(&self, who: Option<&Identity>, body: impl FnOnce(&Context<'_>, &AccessControl) -> T) -> T {
        let (mut overlay, mut events) = (Overlay::new(self.state.clone()), vec![]);
        body(&Context::new(self.environment(who), "abac", &mut overlay, &mut events), &self.abac)
    }

    pub(crate) fn environment<'a>(&'a self, submitter: Option<&'a Identity>) -> Environment<'a> {
        Environment {
            registry: &self.registry,
            submitter,
            network: Hash::ZERO,
            rules: Rules::NEWEST,
            height: self.height,
            time: self.time,
            transaction: self.transaction,
            executed: &|id, _| *id == EXECUTED,
            meter: &self.meter,
        }
    }

    /// Runs a hook as a node does: it may do no more than a node lets it.
    fn hook(&self, overlay: &mut Overlay, events: &mut Vec<Event>, body: impl FnOnce(&mut Context<'_>)) {
        Registry::hook(self.environment(None), &*self.abac, overlay, events, body).unwrap();
    }

    fn block(
        &mut self,
        body: impl FnOnce(&Self, &mut Overlay, &mut Vec<Event>) -> Result<Bytes, Rejection>,
    ) -> Result<Bytes, Rejection> {
        let begins = !std::mem::take(&mut self.joins);
        if begins {
            self.height += 1;
            self.time += 1000;
            self.meter = Meter::of_block();
        }
        let (mut overlay, mut events) = (Overlay::new(self.state.clone()), vec![]);
        if begins {
            self.hook(&mut overlay, &mut events, |ctx| self.abac.begin_block(ctx));
        }
        let outcome = body(self, &mut overlay, &mut events);
        let writes = overlay.finish().unwrap();
        self.state.apply(&writes);
        self.writes.push(writes);
        self.events.append(&mut events);
        outcome
    }
}
