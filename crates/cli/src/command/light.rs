//! `light`: how a robot stands, proved by voters and not by a node.

use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::{ABAC, Session};
use crate::strictness::{beginning, strictness};
use crate::time;
use ledger_api::{Call, Certified, read_checkpoint};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Declaration, Grant, Stopped};
use ledger_light::{Checkpoint, Governance};
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;
use std::time::Duration;

/// How long the declaration may take to be executed.
const TTL: Duration = Duration::from_secs(30);

/// Show the holders and the stop of a robot, verified without trust in the node that answers.
///
/// The query is executed as a transaction. Its result is shown only if enough voters have signed it: a majority from at
/// least two organisations, and more if certificates are strict. The command derives the voters from the genesis, which
/// the context pins by its hash. `strict` shows from which block certificates have been strict.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ledgerctl light Turtlebot4\n  ledgerctl light Turtlebot4 --checkpoint fleet.checkpoint"
)]
pub(crate) struct Light {
    /// The robot
    robot: String,
    /// Start at this checkpoint if the file exists, and update it with what was proved; otherwise start at the genesis
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
}

#[derive(Serialize)]
struct Shown {
    robot: String,
    organisation: String,
    /// The stop that is in force, as the signed declaration has it; none if the robot is not stopped.
    stopped: Option<Stopped>,
    services: Vec<Service>,
    network: Hash,
    height: u64,
    time: u64,
    block: Hash,
    signed_by: Vec<String>,
    voters: usize,
    /// Height of the block that made certificates strict; none if they are not.
    strict_since: Option<u64>,
    began_at: u64,
    #[serde(skip)]
    now: u64,
}

#[derive(Serialize)]
struct Service {
    service: String,
    mode: String,
    epoch: u64,
    grants: Vec<Grant>,
}

impl Light {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let known = self.known(&session.context().network)?;
        let call = Call {
            chaincode: ABAC.to_owned(),
            function: "declare".to_owned(),
            args: vec![self.robot.clone().into()],
            ttl: TTL,
        };
        let certified = session.client.invoke_certified(known.as_ref(), call).await?;
        if let Some(path) = &self.checkpoint {
            ledger_base::durable::replace(path, &certified.checkpoint.to_bytes(), ledger_base::durable::PUBLIC_MODE)?;
        }
        output.show(&Shown::new(&certified, known.map_or(0, |known| known.height()), session.client.now())?)
    }

    /// Where to begin.
    fn known(&self, network: &Hash) -> Result<Option<Governance>, Rejection> {
        let existing = self.checkpoint.as_deref().filter(|path| path.exists());
        Ok(existing.map(|path| read_checkpoint(network, path)).transpose()?.map(|checkpoint| checkpoint.governance))
    }
}

impl Shown {
    fn new(certified: &Certified, began_at: u64, now: u64) -> Result<Self, Rejection> {
        let declared: Declaration = serde_json::from_slice(&certified.response).map_err(|error| {
            Rejection::new(Code::Malformed, "the answer about the robot cannot be read")
                .found(error.to_string())
                .wanted("JSON that this version understands")
                .next("install the release of ledgerctl that the nodes run")
        })?;
        let Checkpoint { governance, proof } = &certified.checkpoint;
        let (statement, voters) = (proof.certificate.statement, governance.voters()?);
        let signers = proof.certificate.signatures.iter().filter_map(|signature| voters.nodes.get(&signature.node));
        let Declaration { robot, grants, .. } = declared;
        let services = robot.services.into_iter().map(|service| Service {
            grants: grants.iter().filter(|grant| grant.service == service.service).cloned().collect(),
            mode: service.mode.to_string(),
            epoch: service.epoch,
            service: service.service,
        });
        Ok(Self {
            robot: robot.name,
            organisation: robot.organisation,
            stopped: robot.stopped,
            services: services.collect(),
            network: statement.network,
            height: statement.height,
            time: statement.time,
            block: statement.block,
            signed_by: signers.map(|voter| format!("{}/{}", voter.organisation, voter.name)).collect(),
            voters: voters.voters.len(),
            strict_since: voters.rule.strict_since,
            began_at,
            now,
        })
    }
}

/// By whom, when and why a robot was stopped.
fn stop_text(stop: &Stopped, now: u64) -> String {
    let why = if stop.reason.is_empty() { String::new() } else { format!(": {}", stop.reason) };
    format!("yes, by {} {}{why}", stop.by, time::relative(stop.since, now))
}

impl Facts for Shown {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("robot", format!("{} of {}", self.robot, self.organisation));
        table.pair("stopped", self.stopped.as_ref().map_or_else(|| "no".to_owned(), |stop| stop_text(stop, self.now)));
        for Service { service, mode, epoch, grants } in &self.services {
            let held = grants.iter().map(|grant| format!("{} until {}", grant.holder, time::moment(grant.expires)));
            let held: Vec<_> = held.collect();
            let held = if held.is_empty() { "no holder".to_owned() } else { format!("held by {}", held.join(", ")) };
            table.pair(service, format!("{mode}, epoch {epoch}, {held}"));
        }
        table.pair("certified", format!("block {}, {}", self.height, time::relative(self.time, self.now)));
        table.pair(
            "signed by",
            format!("{} ({} of {} voters)", self.signed_by.join(", "), self.signed_by.len(), self.voters),
        );
        table.pair("strict", strictness(self.strict_since, self.began_at));
        table.pair("verified from", format!("{} of network {}", beginning(self.began_at), self.network));
        table.write(out, 0)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn shown(stopped: Option<Stopped>) -> Shown {
        Shown {
            robot: "Turtlebot4".to_owned(),
            organisation: "Org2".to_owned(),
            stopped,
            services: Vec::new(),
            network: Hash::ZERO,
            height: 7,
            time: 1_000_000,
            block: Hash::ZERO,
            signed_by: vec!["Org1/node1".to_owned()],
            voters: 1,
            strict_since: None,
            began_at: 0,
            now: 11_000_000,
        }
    }

    #[test]
    fn a_stopped_robot_is_shown_with_who_stopped_it_when_and_why() {
        let text = |facts: &Shown| {
            let mut out = Vec::new();
            facts.text(&mut out).unwrap();
            String::from_utf8(out).unwrap()
        };
        let stop = |reason: &str| Stopped { by: "Org2/admin".into(), reason: reason.into(), since: 1_000_000 };
        let stopped = shown(Some(stop("smoke")));
        assert!(text(&stopped).contains("stopped        yes, by Org2/admin 10 s ago: smoke\n"), "{}", text(&stopped));
        let silent = shown(Some(stop("")));
        assert!(text(&silent).contains("yes, by Org2/admin 10 s ago\n"), "{}", text(&silent));
        let moving = shown(None);
        assert!(text(&moving).contains("stopped        no\n"), "{}", text(&moving));
        let json = |facts: &Shown| serde_json::to_value(facts).unwrap().get("stopped").cloned().unwrap();
        assert_eq!(json(&stopped), serde_json::json!({"by": "Org2/admin", "reason": "smoke", "since": 1_000_000}));
        assert!(json(&moving).is_null());
    }
}
