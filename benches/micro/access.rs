//! Access control: what a decision costs with few and with many policies, 1000 robots, and as many people who drive them.

use bytes::Bytes;
use criterion::{BenchmarkId, Criterion};
use ledger::msp::QUOTAS_MAX;
use ledger::{Chaincode, Context, Environment, Meter, Registry, Rules};
use ledger_abac::{AccessControl, Grant};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_identity::key::PublicKey;
use ledger_identity::{Identity, Role};
use ledger_storage::state::{MemoryState, Overlay, SledStore, State, StateRead, Store, WriteSet};
use std::hint::black_box;
use std::sync::Arc;
use tempfile::TempDir;

use crate::founding::{bench_directory, twist};

/// Policies of the network, those of all owners together.
const POLICIES: [usize; 4] = [10, 100, 1000, 10_000];
/// Robots of the network; the last of each owner is free.
const ROBOTS: usize = 1000;
/// Organisations that own them.
pub(crate) const OWNERS: usize = 4;
/// Rules of one policy text.
const RULES_PER_TEXT: usize = 50;
/// Robots of one call of `setup`.
const ROBOTS_PER_SETUP: usize = 50;
/// Block time, microseconds since the UNIX epoch.
pub(crate) const NOW: u64 = 1_900_000_000_000_000;

/// Stands in for the chaincode that knows the members.
struct Members;

impl Chaincode for Members {
    fn name(&self) -> &'static str {
        "msp"
    }

    fn invoke(&self, _: &mut Context<'_>, function: &str, _: &[Bytes]) -> Result<Bytes, Rejection> {
        if function == "quotas" {
            return Ok(serde_json::to_vec(&QUOTAS_MAX).unwrap().into());
        }
        let owners = (0..OWNERS).map(owner_name);
        Ok(serde_json::to_vec(&owners.chain(["Users".to_owned()]).collect::<Vec<_>>()).unwrap().into())
    }
}

/// Robots, each held by another user, and policies about them.
pub(crate) struct Fleet {
    pub(crate) abac: Arc<AccessControl>,
    registry: Registry,
    /// Where the fleet is made.
    made: Arc<MemoryState>,
    /// The same as a node has it: in its store on disk.
    state: Arc<State>,
    directory: TempDir,
    meter: Meter,
    /// Each with the service that they hold and its epoch.
    pub(crate) holders: Vec<(Identity, String, u64)>,
}

pub(crate) fn owner_name(owner: usize) -> String {
    format!("Owner{owner}")
}

pub(crate) fn robot_name(number: usize) -> String {
    format!("Robot{number:04}")
}

pub(crate) fn user_name(number: usize) -> String {
    format!("User{number:04}")
}

/// `serial` makes it another certificate.
pub(crate) fn identity(organisation: &str, name: &str, role: Role, serial: u64) -> Identity {
    // Any key: nothing here verifies signatures. Algorithm Ed25519, then the base point of its curve.
    let mut spki = hex::decode("302a300506032b657003210058").unwrap();
    spki.extend([0x66; 31]);
    Identity {
        organisation: organisation.to_owned(),
        name: name.to_owned(),
        role,
        attributes: [("driver".to_owned(), "true".to_owned())].into(),
        issuer: Hash::of(&[organisation.as_bytes()]).0,
        serial: serial.to_be_bytes().to_vec(),
        fingerprint: Hash::of(&[name.as_bytes(), &serial.to_be_bytes()]).0,
        public_key: PublicKey::from_spki(&spki).unwrap(),
        valid_from: 0,
        not_before: 0,
        not_after: u64::MAX,
    }
}

impl Fleet {
    fn new(policies: usize) -> Self {
        let mut fleet = Self::made(policies);
        fleet.store();
        fleet
    }

    /// The fleet before it is stored.
    pub(crate) fn made(policies: usize) -> Self {
        let abac = Arc::new(AccessControl::new().unwrap());
        let mut registry = Registry::new();
        registry.install(abac.clone()).unwrap();
        registry.install(Arc::new(Members)).unwrap();
        let directory = tempfile::tempdir_in(bench_directory()).unwrap();
        let state = Arc::new(State::open(Box::<MemoryState>::default()).unwrap());
        let mut fleet = Self {
            abac,
            registry,
            made: Arc::default(),
            state,
            directory,
            meter: Meter::of_query(),
            holders: Vec::new(),
        };
        for owner in 0..OWNERS {
            let admin = identity(&owner_name(owner), "admin", Role::Admin, 0);
            fleet.put_policies(&admin, owner, policies / OWNERS);
            let robots: Vec<_> = (owner..ROBOTS).step_by(OWNERS).map(robot).collect();
            for some in robots.chunks(ROBOTS_PER_SETUP) {
                fleet.call(&admin, "setup", some.to_vec());
            }
        }
        for number in 0..ROBOTS - OWNERS {
            let user = identity("Users", &user_name(number), Role::Member, 0);
            let granted = fleet.call(&user, "acquire", vec![robot_name(number).into(), "600000".into()]);
            let grant: Grant = serde_json::from_slice(&granted).unwrap();
            fleet.holders.push((user, grant.service, grant.epoch));
        }
        fleet
    }

    /// Puts the fleet into a store on disk.
    pub(crate) fn store(&mut self) {
        let store = SledStore::open(self.directory.path()).unwrap();
        let pairs = StateRead::range(&*self.made, b"", None, usize::MAX).unwrap();
        let pairs: WriteSet = pairs.into_iter().map(|(key, value)| (key, Some(value))).collect();
        store.write(&pairs, (b"\0bench", b"")).unwrap();
        self.state = Arc::new(State::open(Box::new(store)).unwrap());
    }

    /// A rule for everybody, and `count` about single robots and people.
    fn put_policies(&self, admin: &Identity, owner: usize, count: usize) {
        let general = "permit (principal in Organisation::\"Users\", action, resource) when \
                       { principal.hasTag(resource.requiredAttribute) };";
        let rule = |number: usize| {
            let (user, robot) = (user_name(number), robot_name((owner + number * OWNERS) % ROBOTS));
            format!("permit (principal == User::\"Users/{user}\", action, resource == Service::\"{robot}/cmd_vel\");\n")
        };
        let rules: Vec<_> = std::iter::once(general.to_owned()).chain((1..count).map(rule)).collect();
        let texts = rules.chunks(RULES_PER_TEXT).enumerate();
        let policies: Vec<_> = texts
            .map(|(number, text)| serde_json::json!({ "id": format!("p{number:02}"), "text": text.concat() }))
            .collect();
        let set = serde_json::json!({ "policies": policies, "means_it": true }).to_string();
        self.call(admin, "policy", ["apply".to_owned(), set].map(Bytes::from).into());
    }

    pub(crate) fn environment<'a>(&'a self, who: &'a Identity) -> Environment<'a> {
        Environment {
            registry: &self.registry,
            submitter: Some(who),
            network: Hash::ZERO,
            rules: Rules::NEWEST,
            height: 1,
            time: NOW,
            transaction: Hash::ZERO,
            executed: &|_, _| false,
            meter: &self.meter,
        }
    }

    pub(crate) fn overlay(&self) -> Overlay {
        Overlay::new(self.state.clone())
    }

    pub(crate) fn invoke(&self, overlay: &mut Overlay, who: &Identity, function: &str, args: &[Bytes]) -> Bytes {
        Registry::invoke(self.environment(who), overlay, &mut Vec::new(), "abac", function, args).unwrap()
    }

    /// A call whose writes count.
    pub(crate) fn call(&self, who: &Identity, function: &str, args: Vec<Bytes>) -> Bytes {
        let mut overlay = Overlay::new(self.made.clone());
        let answer = self.invoke(&mut overlay, who, function, &args);
        self.made.apply(&overlay.finish().unwrap());
        answer
    }
}

fn robot(number: usize) -> Bytes {
    let name = robot_name(number);
    Bytes::from(format!(
        r#"{{"name":"{name}","attribute_required":"driver","trusted":["Org1","Org2"],"services":[{{"topic":"/cmd_vel","type":"geometry_msgs/msg/Twist","mode":"exclusive"}}]}}"#
    ))
}

/// The decision on the publish path, each time about another robot and its holder; and the one of policies that nobody
/// remembers, as somebody's first `acquire` needs two of them.
pub(crate) fn authorize(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("authorize");
    for policies in POLICIES {
        let fleet = Fleet::new(policies);
        let (mut overlay, mut events, mut turn) = (fleet.overlay(), Vec::new(), 0);
        group.bench_function(BenchmarkId::new("publish", policies), |bencher| {
            bencher.iter(|| {
                // A prime: consecutive decisions are about robots whose records lie far apart.
                turn = (turn + 379) % fleet.holders.len();
                let (who, service, epoch) = &fleet.holders[turn];
                let ctx = Context::new(fleet.environment(who), "abac", &mut overlay, &mut events);
                fleet.abac.may_publish(&ctx, black_box(service), *epoch).unwrap();
            });
        });
        let (mut overlay, mut serial) = (fleet.overlay(), 0);
        group.bench_function(BenchmarkId::new("policies_unremembered", policies), |bencher| {
            bencher.iter_batched(
                || {
                    serial += 1;
                    identity("Users", &user_name(7), Role::Member, serial)
                },
                |who| {
                    let args = [robot_name(ROBOTS - 1).into(), Bytes::from_static(b"subscribe")];
                    let answer = fleet.invoke(&mut overlay, &who, "authorize", &args);
                    assert!(answer.starts_with(br#"{"allowed":true"#));
                },
                criterion::BatchSize::SmallInput,
            );
        });
    }
    group.finish();
}

/// One call of `set` with one Twist: everything that execution does for a command but signature and block.
pub(crate) fn chaincode_call(criterion: &mut Criterion) {
    let fleet = Fleet::new(POLICIES[0]);
    let (mut overlay, mut seq) = (fleet.overlay(), 0_u64);
    criterion.bench_function("chaincode_call", |bencher| {
        bencher.iter(|| {
            seq += 1;
            let (who, service, epoch) = &fleet.holders[(seq % 1000) as usize % fleet.holders.len()];
            let args = [service.clone().into(), epoch.to_string().into(), seq.to_string().into(), twist()];
            fleet.invoke(&mut overlay, who, "set", &args)
        });
    });
}
