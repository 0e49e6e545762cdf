//! The next wish of a client.

use super::READER;
use super::contest::Terms;
use super::fleet::{SERVICES, robots};
use super::govern::{ADMINS, Draft};
use super::tasks::ROBOT;
use crate::clock::EPOCH;
use crate::confidential::{self, SERVICE};
use crate::history::Asks;
use crate::policy::Policy;
use crate::world::World;
use bytes::Bytes;
use ledger_confidential::Fresh;
use serde_json::json;

/// A small CDR message.
const MESSAGE: &[u8] = &[0, 1, 0, 0, 42, 0, 0, 0];

/// Something that a client wants.
#[derive(Clone, Debug)]
pub enum Call {
    /// To hold a service, for so many milliseconds.
    Acquire {
        /// The service.
        service: String,
        /// The lease, or the service's own.
        lease_ms: Option<u64>,
    },
    /// To hold it, or to wait in line for it.
    Contend {
        /// The service.
        service: String,
        /// The lease, or the service's own.
        lease_ms: Option<u64>,
        /// How long it waits at most.
        wait_ms: Option<u64>,
        /// A lower priority than its own.
        priority: Option<i64>,
    },
    /// That somebody else has it, who must be confirmed.
    Confirm {
        /// The service.
        service: String,
        /// The one who wants it.
        contender: &'static str,
    },
    /// To have it whatever its rule says.
    Take {
        /// The service.
        service: String,
    },
    /// To stop a robot, or all of them.
    Stop {
        /// The robot; `*` for all.
        robot: &'static str,
    },
    /// To let it be commanded again.
    Resume {
        /// The robot; `*` for all.
        robot: &'static str,
    },
    /// To change who wins where several want a service.
    Configure {
        /// The service.
        service: String,
        /// The settings.
        terms: Terms,
    },
    /// To hold several services at once, or none of them.
    AcquireAll {
        /// The services.
        services: Vec<String>,
        /// The lease, or each service's own.
        lease_ms: Option<u64>,
        /// A lower priority than its own.
        priority: Option<i64>,
    },
    /// To pass a grant on, and take it back later.
    Delegate {
        /// The service.
        service: String,
        /// The receiver.
        to: &'static str,
        /// For how long at most.
        for_ms: Option<u64>,
        /// May the receiver pass it on?
        may_delegate: bool,
    },
    /// To pass a grant on for good.
    HandOver {
        /// The service.
        service: String,
        /// The receiver.
        to: &'static str,
    },
    /// To take back a grant that was passed on.
    Recall {
        /// The service.
        service: String,
        /// Does the robot stop between?
        stop: bool,
    },
    /// That a robot goes to some points.
    Submit {
        /// The service.
        service: String,
        /// The task as JSON.
        task: String,
    },
    /// To say how many points of a task were reached.
    Progress {
        /// The task.
        id: u64,
        /// So many.
        reached: u64,
    },
    /// To say that a task cannot go on.
    Fail {
        /// The task.
        id: u64,
    },
    /// That a task ends.
    Cancel {
        /// The task.
        id: u64,
    },
    /// To carry the CA of an organisation, as a node.
    Carry {
        /// The organisation.
        organisation: &'static str,
        /// A signature of the CA's key.
        proof: String,
    },
    /// To record a certificate of an organisation's CA, as a node.
    Record {
        /// The organisation.
        organisation: &'static str,
        /// The certificate, DER in hexadecimal.
        certificate: String,
    },
    /// To keep it.
    Renew {
        /// The service.
        service: String,
    },
    /// To give it back, or take it back.
    Release {
        /// The service.
        service: String,
    },
    /// To publish a message.
    Set {
        /// The service.
        service: String,
        /// The epoch of the grant; 0 without one.
        epoch: u64,
        /// Sequence number.
        seq: u64,
    },
    /// To know something about a service.
    Read {
        /// The question.
        asks: Asks,
        /// The service.
        service: String,
        /// With everything that was acknowledged before.
        linearizable: bool,
    },
    /// To register the robots, with this mode for the arm of the Husky.
    Setup {
        /// Is the arm for everybody?
        open: bool,
    },
    /// To describe the robot with the confidential service.
    Describe(confidential::Terms),
    /// To read the confidential service, with the pair of this public half.
    Enter {
        /// In hexadecimal digits.
        key: String,
    },
    /// To read it no more.
    Leave,
    /// That somebody reads it no more.
    TakeOut {
        /// The name.
        reader: String,
    },
    /// To share a content key.
    Share {
        /// The epoch of the grant.
        epoch: u64,
        /// The key, wrapped for its readers, as JSON.
        share: String,
        /// The key.
        fresh: Box<Fresh>,
    },
    /// To publish on the confidential service.
    Seal {
        /// The epoch of the grant.
        epoch: u64,
        /// Sequence number.
        seq: u64,
        /// The envelope.
        payload: Bytes,
    },
    /// To put a policy.
    Put(Policy),
    /// To remove a policy.
    Remove(Policy),
    /// To replace the whole set of policies.
    Apply(Draft),
    /// That others agree to a set of policies.
    Propose(Draft),
    /// To agree to a proposed set.
    Approve {
        /// The proposal.
        id: String,
    },
    /// To take a proposed set back, or the own approval.
    Withdraw {
        /// The proposal.
        id: String,
    },
    /// To put a proposed set in force.
    Enact {
        /// The proposal.
        id: String,
        /// Without those whom the own rule demands?
        breaks: bool,
    },
    /// That the network demands that others agree to sets of policies.
    ProposeRule {
        /// The rule.
        quorum: &'static str,
    },
    /// To bring a revocation list.
    Publish {
        /// The list, DER in hexadecimal.
        list: String,
    },
    /// To revoke a certificate: issuer and serial in hexadecimal.
    Revoke {
        /// SHA-256 of the issuer's name.
        issuer: String,
        /// Its serial number.
        serial: String,
    },
    /// To say which rules a node speaks.
    Speak {
        /// The newest.
        newest: u32,
    },
    /// To activate rules.
    Activate {
        /// Their number.
        number: u32,
        /// Their first block.
        height: u64,
    },
    /// To come in as a node.
    Join {
        /// The address of the node.
        address: String,
    },
    /// To give a node a role: `voter`, `learner` or `removed`.
    SetRole {
        /// The node.
        id: u64,
        /// The role.
        role: &'static str,
    },
}

impl Call {
    /// Chaincode, function and arguments.
    pub fn transaction(&self) -> (&'static str, &'static str, Vec<Bytes>) {
        let text = |text: &str| Bytes::copy_from_slice(text.as_bytes());
        match self {
            Self::Acquire { service, lease_ms } => {
                let lease = lease_ms.map(|lease| text(&lease.to_string()));
                ("abac", "acquire", std::iter::once(text(service)).chain(lease).collect())
            }
            Self::Contend { service, lease_ms, wait_ms, priority } => {
                let options = json!({"lease_ms": lease_ms, "wait_ms": wait_ms, "priority": priority});
                ("abac", "acquire", vec![text(service), text(&options.to_string())])
            }
            Self::Confirm { service, contender } => ("abac", "confirm", vec![text(service), text(contender)]),
            Self::Take { service } => ("abac", "take", vec![text(service), text("it drives too near")]),
            Self::Stop { robot } => ("abac", "stop", vec![text(robot)]),
            Self::Resume { robot } => ("abac", "resume", vec![text(robot)]),
            Self::Configure { service, terms } => ("abac", "configure", vec![text(service), text(&terms.json())]),
            Self::AcquireAll { services, lease_ms, priority } => {
                let options = text(&json!({"lease_ms": lease_ms, "priority": priority}).to_string());
                let services = services.iter().map(|service| text(service));
                ("abac", "acquire_all", std::iter::once(options).chain(services).collect())
            }
            Self::Delegate { service, to, for_ms, may_delegate } => {
                let options = json!({"for_ms": for_ms, "may_delegate": may_delegate});
                ("abac", "delegate", vec![text(service), text(to), text(&options.to_string())])
            }
            Self::HandOver { service, to } => ("abac", "handover", vec![text(service), text(to)]),
            Self::Recall { service, stop } => {
                ("abac", "recall", vec![text(service), text(&json!({"stop": stop}).to_string())])
            }
            Self::Submit { service, task } => ("abac", "submit", vec![text(service), text(task)]),
            Self::Progress { id, reached } => {
                ("abac", "progress", vec![text(&id.to_string()), text(&reached.to_string())])
            }
            Self::Fail { id } => ("abac", "fail", vec![text(&id.to_string()), text("the door is locked")]),
            Self::Cancel { id } => ("abac", "cancel", vec![text(&id.to_string())]),
            Self::Carry { organisation, proof } => {
                ("msp", "carry_ca", vec![text(&json!({"organisation": organisation, "proof": proof}).to_string())])
            }
            Self::Record { organisation, certificate } => {
                let ground = json!({"local": 1});
                let record = json!({"organisation": organisation, "certificate": certificate, "ground": ground});
                ("msp", "record_certificate", vec![text(&record.to_string())])
            }
            Self::Renew { service } => ("abac", "renew", vec![text(service)]),
            Self::Release { service } => ("abac", "release", vec![text(service)]),
            Self::Set { service, epoch, seq } => {
                let head = [text(service), text(&epoch.to_string()), text(&seq.to_string())];
                ("abac", "set", head.into_iter().chain([Bytes::from_static(MESSAGE)]).collect())
            }
            Self::Read { service, .. } => ("abac", "service", vec![text(service)]),
            Self::Setup { open } => ("abac", "replace", robots(*open).iter().map(|robot| text(robot)).collect()),
            Self::Put(policy) => Self::Apply(Draft { policies: Some(vec![*policy]), ..Draft::default() }).transaction(),
            Self::Remove(_) => Self::Apply(Draft { policies: Some(Vec::new()), ..Draft::default() }).transaction(),
            Self::Apply(draft) => ("abac", "policy", vec![text("apply"), text(&draft.json())]),
            Self::Propose(draft) => ("abac", "policy", vec![text("propose"), text(&draft.json())]),
            Self::Approve { id } => ("abac", "policy", vec![text("approve"), text(id)]),
            Self::Withdraw { id } => ("abac", "policy", vec![text("withdraw"), text(id)]),
            Self::Enact { id, breaks } => {
                let breaks = breaks.then(|| text("break-glass"));
                ("abac", "policy", [text("enact"), text(id)].into_iter().chain(breaks).collect())
            }
            Self::ProposeRule { quorum } => {
                let args = [hex::encode(quorum)];
                let call = json!({"chaincode": "abac", "function": "set_policy_approvals", "args": args});
                ("msp", "propose", vec![text(&call.to_string())])
            }
            Self::Publish { list } => {
                ("msp", "record_revocation_list", vec![text(&json!({ "list": list }).to_string())])
            }
            Self::Describe(terms) => ("abac", "replace", vec![text(&terms.json())]),
            Self::Enter { key } => ("abac", "reader", vec![text(SERVICE), text(key)]),
            Self::Leave => ("abac", "reader", vec![text(SERVICE), text("none")]),
            Self::TakeOut { reader } => ("abac", "reader", vec![text(SERVICE), text("none"), text(reader)]),
            Self::Share { epoch, share, .. } => {
                ("abac", "share", vec![text(SERVICE), text(&epoch.to_string()), text(share)])
            }
            Self::Seal { epoch, seq, payload } => {
                let (epoch, seq) = (text(&epoch.to_string()), text(&seq.to_string()));
                ("abac", "set", vec![text(SERVICE), epoch, seq, payload.clone()])
            }
            Self::Speak { newest } => {
                ("msp", "speak", vec![text(&format!(r#"{{"newest":{newest},"release":"9.0.0"}}"#))])
            }
            Self::Activate { number, height } => {
                ("msp", "activate_rules", vec![text(&format!(r#"{{"number":{number},"height":{height}}}"#))])
            }
            Self::Join { address } => ("msp", "join_node", vec![text(&format!(r#"{{"address":"{address}"}}"#))]),
            Self::SetRole { id, role } => {
                ("msp", "set_node_role", vec![text(&format!(r#"{{"id":{id},"role":"{role}"}}"#))])
            }
            Self::Revoke { issuer, serial } => ("msp", "revoke", vec![text(issuer), text(serial)]),
        }
    }

    /// For the trace.
    pub fn name(&self) -> String {
        match self {
            Self::Put(policy) => format!("policy put {}", policy.id()),
            Self::Remove(policy) => format!("policy remove {}", policy.id()),
            Self::Publish { .. } => "list".to_owned(),
            Self::Share { epoch, .. } => format!("share in epoch {epoch}"),
            Self::Seal { epoch, seq, .. } => format!("seal number {seq} of epoch {epoch}"),
            other => format!("{other:?}"),
        }
    }
}

impl World {
    /// The next step of a client; nothing if it has no work.
    pub(super) fn intend(&mut self, number: usize) -> Option<Call> {
        let client = &self.clients[number];
        if let Some(call) = client.orders.first() {
            // Of the grant that it got by an earlier order.
            return Some(match call.clone() {
                Call::Set { service, .. } => {
                    let (epoch, seq) = client.grants.get(&service).copied().unwrap_or_default();
                    if epoch == 0 {
                        Call::Acquire { service, lease_ms: None }
                    } else {
                        Call::Set { service, epoch, seq }
                    }
                }
                Call::Seal { .. } => self.speak(number),
                call => call,
            });
        }
        if client.obedient {
            return None;
        }
        if client.circle.belongs {
            return self.confide(number);
        }
        let governs = ADMINS.contains(&&*client.person) && (client.ready || client.person != "Org2/admin");
        if governs && let Some(call) = self.govern(number) {
            return Some(call);
        }
        let client = &self.clients[number];
        let service = self.random.clients.pick(&SERVICES).copied().unwrap_or(SERVICES[0]).to_owned();
        match &*client.person {
            "Org2/admin" if !client.ready => Some(Call::Setup { open: true }),
            "Org2/admin" => Some(self.rule(service)),
            READER if self.random.clients.percent(90) => {
                Some(Call::Read { asks: Asks::Holders, service, linearizable: self.random.clients.percent(80) })
            }
            "Org1/admin" if self.random.clients.percent(4) => self.revocation(),
            ROBOT => self.report(),
            _ => Some(self.use_service(number, service)),
        }
    }

    fn rule(&mut self, service: String) -> Call {
        if let Some(call) = self.rule_contests() {
            return call;
        }
        let random = &mut self.random.clients;
        let until = (EPOCH + self.now) / 1000 + random.between(1_000, 20_000);
        let policies =
            [Policy::Attribute, Policy::Trusted, Policy::ForbidFarhad, Policy::ErringForbid, Policy::Until(until)];
        let policy = random.pick(&policies).copied().unwrap_or(Policy::Attribute);
        match random.below(20) {
            // Mostly the permitting ones, so that most of the time something is permitted.
            0 => Call::Put(policy),
            1..=2 => Call::Put(if random.percent(50) { Policy::Attribute } else { Policy::Trusted }),
            3..=6 => Call::Remove(policy),
            7..=8 => Call::Remove(Policy::ErringForbid),
            9 => Call::Setup { open: random.percent(50) },
            10..=12 => Call::Release { service },
            13..=14 => Call::Acquire { service, lease_ms: None },
            _ => Call::Read { asks: Asks::Holders, service, linearizable: random.percent(50) },
        }
    }

    /// Revokes one of the certificates that is not anybody's last.
    fn revocation(&mut self) -> Option<Call> {
        let revocable: Vec<_> = self
            .people
            .persons()
            .iter()
            .filter(|person| {
                person.identity.organisation == "Org1" && person.identity.name != "admin" && person.nth == 0
            })
            .collect();
        let person = self.random.clients.pick(&revocable)?;
        let (issuer, serial) = (hex::encode(person.identity.issuer), hex::encode(&person.identity.serial));
        Some(Call::Revoke { issuer, serial })
    }

    fn use_service(&mut self, number: usize, service: String) -> Call {
        if let Some(call) = self.contend(number) {
            return call;
        }
        let grant = self.clients[number].grants.get(&service).copied();
        let random = &mut self.random.clients;
        match (random.below(100), grant) {
            (0..=14, _) => Call::Read { asks: Asks::Holders, service, linearizable: random.percent(50) },
            (15..=30, _) | (_, None) if service != "Husky/arm" || random.percent(50) => {
                let lease_ms = random.percent(30).then(|| random.between(50, 25_000));
                Call::Acquire { service, lease_ms }
            }
            (31..=40, _) => Call::Renew { service },
            (41..=48, _) => Call::Release { service },
            (49..=53, Some((epoch, seq))) => Call::Set { service, epoch: epoch.saturating_sub(1), seq },
            (54..=56, Some((epoch, seq))) => Call::Set { service, epoch, seq: seq.saturating_sub(1) },
            (_, Some((epoch, seq))) => Call::Set { service, epoch, seq },
            (_, None) => Call::Set { service, epoch: 0, seq: random.below(1000) },
        }
    }
}
