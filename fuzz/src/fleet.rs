//! A robot in memory, whose owner puts policies.

use bytes::Bytes;
use ledger::msp::QUOTAS;
use ledger::{Chaincode, Context, Environment, Meter, Registry, Rules};
use ledger_abac::{AccessControl, Ask, PolicyDraft, PolicyText};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::PublicKey;
use ledger_identity::{Identity, Role};
use ledger_storage::state::{MemoryState, Overlay, StateRead};
use std::collections::BTreeMap;
use std::sync::Arc;

const ROBOT: &str = r#"{"name":"Husky","attribute_required":"Husky","trusted":["Org1","Org2"],
    "services":[{"topic":"/cmd_vel","type":"geometry_msgs/msg/Twist","mode":"exclusive"}]}"#;
const SERVICE: &str = "Husky/cmd_vel";
/// Block time.
const NOW: u64 = 1_795_219_200_000_000;
/// An Ed25519 key in DER; nothing here verifies a signature. Behind the head stands the base point of the curve.
const KEY_HEAD: [u8; 12] = [0x30, 0x2a, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x03, 0x21, 0x00];

/// Stands in for the chaincode of the members.
struct Members;

impl Chaincode for Members {
    fn name(&self) -> &'static str {
        "msp"
    }

    fn invoke(&self, _: &mut Context<'_>, function: &str, _: &[Bytes]) -> Result<Bytes, Rejection> {
        match function {
            "quotas" => Ok(serde_json::to_vec(&QUOTAS).expect("JSON").into()),
            "organisations" => Ok(Bytes::from_static(br#"["Org1","Org2"]"#)),
            "enrolled" => Ok(Bytes::from_static(br#"{"items":[]}"#)),
            _ => Err(Rejection::new(Code::NotFound, "there is no such thing here").next("nothing can be done")),
        }
    }
}

/// The robot, its owner and a user of another organisation.
pub struct Fleet {
    registry: Registry,
    state: Arc<MemoryState>,
    owner: Identity,
    user: Identity,
}

impl Fleet {
    /// A robot whose owner has put no policy.
    ///
    /// # Panics
    /// If the robot cannot be registered.
    pub fn new() -> Self {
        let mut registry = Registry::new();
        registry.install(Arc::new(AccessControl::new().expect("a chaincode"))).expect("its name is free");
        registry.install(Arc::new(Members)).expect("its name is free");
        let (owner, user) = (person("Org2", "admin", Role::Admin), person("Org1", "Salma", Role::Member));
        let fleet = Self { registry, state: Arc::default(), owner, user };
        let mut overlay = Overlay::new(fleet.memory());
        fleet.invoke(&fleet.owner, &mut overlay, "setup", &[ROBOT]).expect("a robot");
        fleet.state.apply(&overlay.finish().expect("it fits"));
        fleet
    }

    /// The faults that `ledgerctl policy check` reports, or its rejection; none for a policy without faults.
    ///
    /// # Panics
    /// If the report is not JSON with a list of faults.
    pub fn check(&self, text: &str) -> Option<String> {
        let report = match self.ask(&self.user, "check", &[text]) {
            Ok(report) => report,
            Err(rejection) => return Some(rejection.to_string()),
        };
        let report: serde_json::Value = serde_json::from_slice(&report).expect("JSON");
        let faults = report.get("faults").and_then(serde_json::Value::as_array).expect("faults");
        (!faults.is_empty()).then(|| format!("{faults:?}"))
    }

    /// May the user publish, by this policy alone?
    ///
    /// # Errors
    /// The refusal of the question.
    pub fn can(&self, text: &str) -> Result<Bytes, Rejection> {
        let policies = Some(vec![PolicyText { id: "given".to_owned(), text: text.to_owned() }]);
        let ask = Ask { action: "publish".to_owned(), service: SERVICE.to_owned(), policies, ..Ask::default() };
        self.ask(&self.user, "can", &[&serde_json::to_string(&ask).expect("JSON")])
    }

    /// Is it accepted on the ledger?
    ///
    /// # Errors
    /// The refusal.
    pub fn put(&self, text: &str) -> Result<Bytes, Rejection> {
        // Also if nobody may publish any more.
        let policies = Some(vec![PolicyText { id: "given".to_owned(), text: text.to_owned() }]);
        let draft = PolicyDraft { policies, means_it: true, ..PolicyDraft::default() };
        self.ask(&self.owner, "policy", &["apply", &serde_json::to_string(&draft).expect("JSON")])
    }

    fn memory(&self) -> Arc<dyn StateRead> {
        Arc::<MemoryState>::clone(&self.state)
    }

    fn ask(&self, who: &Identity, function: &str, args: &[&str]) -> Result<Bytes, Rejection> {
        self.invoke(who, &mut Overlay::new(self.memory()), function, args)
    }

    fn invoke(&self, who: &Identity, overlay: &mut Overlay, function: &str, args: &[&str]) -> Result<Bytes, Rejection> {
        let environment = Environment {
            registry: &self.registry,
            submitter: Some(who),
            network: Hash::ZERO,
            rules: Rules::NEWEST,
            height: 2,
            time: NOW,
            transaction: Hash::ZERO,
            executed: &|_, _| false,
            meter: &Meter::of_query(),
        };
        let args: Vec<_> = args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect();
        Registry::invoke(environment, overlay, &mut Vec::new(), "abac", function, &args)
    }
}

impl Default for Fleet {
    fn default() -> Self {
        Self::new()
    }
}

fn person(organisation: &str, name: &str, role: Role) -> Identity {
    let key = [&KEY_HEAD[..], &[0x58], &[0x66; 31]].concat();
    Identity {
        organisation: organisation.to_owned(),
        name: name.to_owned(),
        role,
        attributes: BTreeMap::from([("Husky".to_owned(), "true".to_owned())]),
        issuer: Hash::of(&[organisation.as_bytes()]).0,
        serial: vec![1],
        fingerprint: Hash::of(&[organisation.as_bytes(), name.as_bytes()]).0,
        public_key: PublicKey::from_spki(&key).expect("a key"),
        valid_from: 0,
        not_before: 0,
        not_after: 2 * NOW,
    }
}
