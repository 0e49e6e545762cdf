//! A network on disk that no node runs yet: one robot owner, one operator, as many nodes as a bench wants.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use bytes::Bytes;
use ledger_api::Context;
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use ledgerd::ca::CertificateAuthority;
use ledgerd::setup::{NetworkPlan, PlannedNode, PlannedOrganisation, found, issue};
use rustls_pki_types::CertificateDer;
use std::collections::BTreeMap;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};
use tempfile::TempDir;

/// Which nodes a network has.
#[derive(Clone, Copy)]
pub(crate) struct Shape {
    /// As it is called in results.
    pub(crate) name: &'static str,
    /// Nodes that order.
    pub(crate) voters: usize,
    /// Nodes that only follow; they are of the robots' owner.
    pub(crate) learners: usize,
}

/// One node.
pub(crate) const ONE_VOTER: Shape = Shape { name: "one_voter", voters: 1, learners: 0 };

/// The paper's network: one organisation orders, the other follows.
pub(crate) const PAPER: Shape = Shape { name: "voter_and_learner", voters: 1, learners: 1 };
/// A cluster that survives the loss of a node.
pub(crate) const THREE_VOTERS: Shape = Shape { name: "three_voters", voters: 3, learners: 0 };
/// Such a cluster, and the robots' owner, who follows.
pub(crate) const THREE_VOTERS_AND_LEARNER: Shape = Shape { name: "three_voters_and_learner", voters: 3, learners: 1 };

/// Members beside Salma and Farhad.
const DRIVERS: usize = 8;

pub(crate) const OPERATORS: &str = "Org1";
pub(crate) const OWNERS: &str = "Org2";

/// A founded network. Its directory goes with it.
pub(crate) struct Founding {
    /// The admin of the organisation that owns the robots; connects to the first node.
    pub(crate) owner: Context,
    /// The admin of the organisation that orders; connects to the first node.
    pub(crate) operator: Context,
    /// Salma, whom policies let acquire every robot here; connects to the first node.
    pub(crate) salma: Context,
    /// Farhad, of her organisation, whom no policy lets acquire a robot; connects to the first node.
    pub(crate) farhad: Context,
    /// Members of her organisation whom policies let acquire robots that require `Fleet`; connect to the first node.
    pub(crate) drivers: Vec<Context>,
    /// Data directory and address of each node, the voters first.
    pub(crate) nodes: Vec<(PathBuf, String)>,
    /// The CA of her organisation.
    authority: PathBuf,
    /// Where all of it lies.
    _directory: TempDir,
}

/// `target/bench`: results, and the data of nodes while a bench runs. On the disk of the build, never in memory.
pub(crate) fn bench_directory() -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("bench");
    std::fs::create_dir_all(&directory).unwrap();
    directory
}

/// The machine's clock, microseconds since the UNIX epoch.
pub(crate) fn clock() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros().try_into().unwrap()
}

impl Founding {
    pub(crate) fn new(shape: Shape) -> Self {
        Self::with(shape, 0)
    }

    /// As [`Founding::new`], with so many more organisations, which have no nodes.
    pub(crate) fn with(shape: Shape, more_organisations: usize) -> Self {
        let directory = tempfile::Builder::new().prefix(shape.name).tempdir_in(bench_directory()).unwrap();
        // All ports are held until all are known, so that they differ.
        let ports: Vec<_> =
            (0..shape.voters + shape.learners).map(|_| TcpListener::bind("127.0.0.1:0").unwrap()).collect();
        let nodes: Vec<_> = (1..)
            .zip(&ports)
            .map(|(number, port)| {
                (directory.path().join(format!("node{number}")), port.local_addr().unwrap().to_string())
            })
            .collect();
        drop(ports);
        let planned = nodes.iter().enumerate().map(|(index, (data, address))| PlannedNode {
            name: format!("node{}", index + 1),
            organisation: if index < shape.voters { OPERATORS } else { OWNERS }.into(),
            data: data.clone(),
            address: address.clone(),
            voter: index < shape.voters,
        });
        let more = (3..3 + more_organisations).map(|number| format!("Org{number}"));
        let organisations = [OPERATORS, OWNERS]
            .map(str::to_owned)
            .into_iter()
            .chain(more)
            .map(|name| PlannedOrganisation { name, key: KeyKind::Ed25519 });
        let plan = NetworkPlan {
            snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
            label: "bench".into(),
            organisations: organisations.collect(),
            nodes: planned.collect(),
        };
        let founded = found(&plan, clock()).unwrap();
        let entry = nodes[0].1.as_str();
        let identity = |organisation: &str, who: (&str, Role), attributes| {
            let of = |authority: &&ledgerd::setup::FoundedAuthority| authority.organisation == organisation;
            let ca = &founded.authorities.iter().find(of).unwrap().directory;
            let data = ca.ancestors().nth(2).unwrap();
            issue(data, organisation, who, attributes, entry, clock()).unwrap()
        };
        let drives = ["Turtlebot4", "Husky"].map(|robot| (robot.to_owned(), "true".to_owned()));
        Self {
            owner: identity(OWNERS, ("Admin", Role::Admin), BTreeMap::new()),
            operator: identity(OPERATORS, ("Admin", Role::Admin), BTreeMap::new()),
            salma: identity(OPERATORS, ("Salma", Role::Member), BTreeMap::from(drives)),
            drivers: (0..DRIVERS)
                .map(|number| {
                    let fleet = BTreeMap::from([("Fleet".to_owned(), "true".to_owned())]);
                    identity(OPERATORS, (&format!("Driver{number}"), Role::Member), fleet)
                })
                .collect(),
            farhad: identity(OPERATORS, ("Farhad", Role::Member), BTreeMap::new()),
            authority: founded.authorities[0].directory.clone(),
            nodes,
            _directory: directory,
        }
    }

    /// So many members of Salma's organisation who carry these attributes; they connect to the first node. Before it is
    /// started: it owns the CA then.
    pub(crate) fn members(&self, count: usize, attributes: &[&str]) -> Vec<Context> {
        let mut authority = CertificateAuthority::open(&self.authority).unwrap();
        let mut issue = |number| {
            let name = format!("Member{number}");
            let attributes = attributes.iter().map(|name| ((*name).to_owned(), "true".to_owned())).collect();
            let issued = authority.issue(&name, Role::Member, attributes, KeyKind::Ed25519, clock()).unwrap();
            let chain = std::iter::once(issued.certificate).chain(issued.chain).map(CertificateDer::from);
            Context { name, chain: chain.collect(), key: Arc::new(issued.key), ..self.salma.clone() }
        };
        (0..count).map(&mut issue).collect()
    }
}

/// Arguments of `abac setup`: robots with one exclusive `/cmd_vel` each.
pub(crate) fn robots() -> Vec<Bytes> {
    ["Turtlebot4", "Husky"].map(|name| robot(name, name)).into()
}

/// A robot that who has the attribute may drive, with one exclusive `/cmd_vel`.
pub(crate) fn robot(name: &str, attribute: &str) -> Bytes {
    let service = r#"{"topic":"/cmd_vel","type":"geometry_msgs/msg/Twist","mode":"exclusive"}"#;
    format!(
        r#"{{"name":"{name}","attribute_required":"{attribute}","trusted":["Org1","Org2"],"services":[{service}]}}"#
    )
    .into()
}

/// A `geometry_msgs/msg/Twist` in CDR: header and six doubles, 52 bytes.
pub(crate) fn twist() -> Bytes {
    let values = [0.5_f64, 0.0, 0.0, 0.0, 0.0, 0.25];
    [0, 1, 0, 0].into_iter().chain(values.into_iter().flat_map(f64::to_le_bytes)).collect::<Vec<_>>().into()
}
