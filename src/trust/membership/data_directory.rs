//! How a node comes back that has lost its data, and which configuration and files belong to which node.

use super::Joined;
use crate::ordering::directory::Member;
use crate::process::config::{Config, MemberOf};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::io::ErrorKind;

/// The commands that bring a node back whose data directory is lost. `node`: `ORGANISATION/NAME`, or empty.
pub(crate) fn way_back(config: &Config, node: &str) -> String {
    let (who, name) = node.split_once('/').map_or(("its organisation", "NAME"), |(who, name)| (who, name));
    format!(
        "an admin of {who} types ledgerctl network invite --node {name}, then here: ledgerd join TOKEN --config {}",
        config.file.display()
    )
}

/// Why a node cannot start from a directory without a genesis. Founding a network would be wrong for one that has lost its
/// disk: it would come back alone.
pub(crate) fn nothing_here(config: &Config, error: &std::io::Error) -> Rejection {
    let data = config.data.display();
    let found = match error.kind() {
        ErrorKind::NotFound => match std::fs::read_dir(&config.data) {
            Err(error) => error.to_string(),
            Ok(mut entries) => match entries.next() {
                None => "an empty directory".to_owned(),
                Some(_) => "a directory without genesis.json".to_owned(),
            },
        },
        _ => error.to_string(),
    };
    let MemberOf { network, node, .. } = &config.member;
    let joined = Joined::load(&config.data).ok().flatten();
    let node = match joined {
        Some(joined) if node.is_empty() => format!("{}/{}", joined.organisation, joined.name),
        _ => node.clone(),
    };
    let file = config.file.display();
    if node.is_empty() {
        return Rejection::new(Code::BadFile, format!("there is no node in {data}"))
            .found(found)
            .wanted("the data directory of a node")
            .next(format!(
                "for a node of a network: {}; ledgerd init --organisation NAME --config {file} founds a new network",
                way_back(config, "")
            ));
    }
    let network = if network.is_empty() { String::new() } else { format!(" of network {network}") };
    Rejection::new(Code::BadFile, format!("the data of node {node} are not in {data}"))
        .found(found)
        .wanted(format!("the data directory of node {node}{network}"))
        .next(format!("mount or restore it; if it is lost, {}", way_back(config, &node)))
}

/// Refuses a data directory that is not of the node which the configuration names.
///
/// # Errors
/// [`Code::BadConfiguration`] with both.
pub(crate) fn check_member(config: &Config, network: Hash, me: &Member) -> Result<(), Rejection> {
    let MemberOf { network: wanted_network, node: wanted, .. } = &config.member;
    let (found, found_network) = (me.full_name(), network.to_string());
    let same = |wanted: &str, found: &str| wanted.is_empty() || wanted == found;
    if same(wanted, &found) && same(wanted_network, &found_network) {
        return Ok(());
    }
    let (data, file) = (config.data.display(), config.file.display());
    Err(Rejection::new(Code::BadConfiguration, format!("{data} is the data directory of another node"))
        .found(format!("node {found} of network {found_network}"))
        .wanted(format!("node {wanted} of network {wanted_network}, as [member] of {file} says"))
        .next("give each node its own configuration and data directory"))
}
