//! The parts of a network for trials: its nodes with their addresses and files, and its people.

use crate::tools::setup::{NetworkPlan, PlannedNode, PlannedOrganisation};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use std::collections::BTreeMap;
use std::net::TcpListener;
use std::path::{Path, PathBuf};

/// The label of the network.
pub(super) const LABEL: &str = "lab";
/// Robots that have an identity, for bridges, and whose names are the attributes of users.
const ROBOTS: [&str; 2] = ["Turtlebot4", "Husky"];

/// A network that is to be started.
pub(super) struct Layout {
    directory: PathBuf,
    /// The names of the organisations.
    pub(super) organisations: Vec<String>,
    /// The nodes, in the order of their numbers.
    pub(super) nodes: Vec<NodeLayout>,
}

/// A node that is to be started.
#[derive(Clone)]
pub(super) struct NodeLayout {
    pub(super) name: String,
    pub(super) organisation: String,
    pub(super) is_voter: bool,
    /// `HOST:PORT` for clients and other nodes, of the monitoring endpoint, and of the console.
    pub(super) address: String,
    pub(super) admin: String,
    pub(super) console: String,
    /// The data directory and the configuration file.
    pub(super) data: PathBuf,
    pub(super) config: PathBuf,
}

/// An identity, and the name of its context.
pub(super) struct Person {
    pub(super) context: String,
    pub(super) name: String,
    pub(super) organisation: String,
    pub(super) role: Role,
    pub(super) attributes: BTreeMap<String, String>,
}

/// The name of the context of an organisation's admin.
pub(super) fn admin_context(organisation: &str) -> String {
    format!("{}-admin", organisation.to_lowercase())
}

impl Layout {
    /// A node for each voter, and one for each organisation without a voter.
    ///
    /// # Errors
    /// [`Code::Internal`] without free ports.
    pub(super) fn new(directory: &Path, organisations: u64, voters: u64) -> Result<Self, Rejection> {
        let names: Vec<String> = (1..=organisations).map(|number| format!("Org{number}")).collect();
        let mut ports = free_addresses(usize::try_from(3 * organisations.max(voters)).unwrap_or_default())?.into_iter();
        let mut nodes = Vec::new();
        for (number, organisation) in (1..=organisations.max(voters)).zip(names.iter().cycle()) {
            let (Some(address), Some(admin), Some(console)) = (ports.next(), ports.next(), ports.next()) else {
                return Err(Rejection::new(Code::Internal, "too few free ports"));
            };
            let name = format!("node{number}");
            nodes.push(NodeLayout {
                organisation: organisation.clone(),
                is_voter: number <= voters,
                address,
                admin,
                console,
                data: directory.join(&name),
                config: directory.join(format!("{name}.toml")),
                name,
            });
        }
        Ok(Self { directory: directory.to_owned(), organisations: names, nodes })
    }

    pub(super) fn directory(&self) -> &Path {
        &self.directory
    }

    /// The home of the contexts.
    pub(super) fn home(&self) -> PathBuf {
        self.directory.join("home")
    }

    /// The organisation that owns the robots: the second one as in the paper, or the only one.
    pub(super) fn owner(&self) -> &str {
        self.organisations.get(1).or_else(|| self.organisations.first()).map_or("", String::as_str)
    }

    /// The plan for founding it.
    pub(super) fn plan(&self) -> NetworkPlan {
        let organisation = |name: &String| PlannedOrganisation { name: name.clone(), key: KeyKind::Ed25519 };
        let node = |node: &NodeLayout| PlannedNode {
            name: node.name.clone(),
            organisation: node.organisation.clone(),
            data: node.data.clone(),
            address: node.address.clone(),
            voter: node.is_voter,
        };
        NetworkPlan {
            snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
            label: LABEL.to_owned(),
            organisations: self.organisations.iter().map(organisation).collect(),
            nodes: self.nodes.iter().map(node).collect(),
        }
    }

    /// The node that holds the CA key of an organisation: its first one.
    ///
    /// # Errors
    /// [`Code::Internal`] for an organisation that is not part of this network.
    pub(super) fn carrier(&self, organisation: &str) -> Result<&NodeLayout, Rejection> {
        let found = self.nodes.iter().find(|node| node.organisation == organisation);
        found.ok_or_else(|| Rejection::new(Code::Internal, format!("{organisation} has no node")))
    }

    /// The addresses of all nodes, those of an organisation first.
    pub(super) fn addresses_for(&self, organisation: &str) -> Vec<String> {
        let (own, others): (Vec<_>, Vec<_>) = self.nodes.iter().partition(|node| node.organisation == organisation);
        own.into_iter().chain(others).map(|node| node.address.clone()).collect()
    }

    /// Admins and a user of each organisation, those of the paper in the first one, and the identities of the robots.
    pub(super) fn people(&self) -> Vec<Person> {
        let person = |context: &str, name: &str, organisation: &str, role: Role, attributes: &[&str]| Person {
            context: context.to_owned(),
            name: name.to_owned(),
            organisation: organisation.to_owned(),
            role,
            attributes: attributes.iter().map(|key| ((*key).to_owned(), "true".to_owned())).collect(),
        };
        let mut people = Vec::new();
        for (number, organisation) in self.organisations.iter().enumerate() {
            people.push(person(&admin_context(organisation), "Admin", organisation, Role::Admin, &[]));
            if number == 0 {
                people.push(person("Salma", "Salma", organisation, Role::Member, &ROBOTS));
                people.push(person("Farhad", "Farhad", organisation, Role::Member, &["Turtlebot4"]));
            } else {
                let context = format!("{}-user", organisation.to_lowercase());
                people.push(person(&context, "User", organisation, Role::Member, &ROBOTS));
            }
        }
        people.extend(ROBOTS.map(|robot| person(robot, robot, self.owner(), Role::Robot, &[])));
        people
    }
}

impl NodeLayout {
    /// Its configuration file.
    pub(super) fn settings(&self) -> String {
        let data = self.data.display().to_string();
        let Self { address, admin, console, .. } = self;
        format!(
            "data = {data:?}\nlisten = {address:?}\n\n[admin]\nlisten = {admin:?}\n\n[console]\nlisten = {console:?}\n"
        )
    }
}

/// Addresses that no program uses at the moment. All are held at once, so that they differ.
fn free_addresses(count: usize) -> Result<Vec<String>, Rejection> {
    let failed = |error: std::io::Error| Rejection::new(Code::Internal, format!("no free port on 127.0.0.1: {error}"));
    let bound: Result<Vec<_>, _> = (0..count).map(|_| TcpListener::bind("127.0.0.1:0")).collect();
    bound.map_err(failed)?.iter().map(|one| Ok(one.local_addr().map_err(failed)?.to_string())).collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn dealt(organisations: u64, voters: u64) -> Vec<(String, bool)> {
        let layout = Layout::new(Path::new("/lab"), organisations, voters).unwrap();
        layout.nodes.into_iter().map(|node| (node.organisation, node.is_voter)).collect()
    }

    #[test]
    fn voters_are_dealt_in_turn_and_an_organisation_without_one_has_a_learner() {
        let of = |wanted: &[(&str, bool)]| {
            wanted.iter().map(|(name, voter)| ((*name).to_owned(), *voter)).collect::<Vec<_>>()
        };
        assert_eq!(dealt(2, 3), of(&[("Org1", true), ("Org2", true), ("Org1", true)]));
        assert_eq!(dealt(3, 1), of(&[("Org1", true), ("Org2", false), ("Org3", false)]));
        assert_eq!(dealt(1, 1), of(&[("Org1", true)]));
    }

    #[test]
    fn every_context_has_a_name_of_its_own_and_asks_its_own_organisation_first() {
        let layout = Layout::new(Path::new("/lab"), 16, 16).unwrap();
        let names: std::collections::BTreeSet<_> = layout.people().into_iter().map(|person| person.context).collect();
        assert_eq!(names.len(), layout.people().len());
        assert_eq!(layout.owner(), "Org2");
        let addresses = layout.addresses_for("Org3");
        assert_eq!((addresses.first(), addresses.len()), (Some(&layout.carrier("Org3").unwrap().address), 16));
    }
}
