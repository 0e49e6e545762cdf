//! How a node comes back that has lost its data, and which configuration and files belong to which node.

use super::Joined;
use crate::ordering::directory::Member;
use crate::process::config::{Config, MemberOf};
use ledger_base::durable::access;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use ledger_storage::layout::GENESIS_FILE;
use std::io::ErrorKind;

/// The commands that bring a node back whose data directory is lost. `node`: `ORGANISATION/NAME`, or empty.
pub(crate) fn way_back(config: &Config, node: &str) -> String {
    let (who, name) = node.split_once('/').map_or(("its organisation", "NAME"), |(who, name)| (who, name));
    format!(
        "an admin of {who} runs ledgerctl network invite --node {name}, then here: ledgerd join TOKEN --config {}",
        shell::path(&config.file)
    )
}

/// Why a node cannot start from a directory without a genesis. Founding a network would be wrong for one that has lost its
/// disk: it would come back alone.
pub(crate) fn nothing_here(config: &Config, error: &std::io::Error) -> Rejection {
    let data = config.data.display();
    if let Some(denied) = denied(config, error) {
        return denied;
    }
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
    let file = shell::path(&config.file);
    if node.is_empty() {
        return Rejection::new(Code::BadFile, format!("there is no node in {data}"))
            .found(found)
            .wanted("the data directory of a node")
            .next(format!(
                "for a node of a network: {}; ledgerd init --organisation NAME --config {file} creates a new network",
                way_back(config, "")
            ));
    }
    let network = if network.is_empty() { String::new() } else { format!(" of network {network}") };
    Rejection::new(Code::BadFile, format!("the data of node {node} are not in {data}"))
        .found(found)
        .wanted(format!("the data directory of node {node}{network}"))
        .next(format!("mount or restore it; if it is lost, {}", way_back(config, &node)))
}

/// The rejection of a data directory of another user. Its node may run: to bring it in as a new one would take its vote.
fn denied(config: &Config, error: &std::io::Error) -> Option<Rejection> {
    let listed = std::fs::read_dir(&config.data).err();
    let is_denied = |error: &std::io::Error| error.kind() == ErrorKind::PermissionDenied;
    (is_denied(error) || listed.as_ref().is_some_and(is_denied)).then(|| {
        Rejection::new(Code::BadFile, format!("this user may not read {}", config.data.display()))
            .found(access(&config.data))
            .wanted("the user that owns the data directory")
            .next("run the command as that user: sudo -u USER ledgerd …")
    })
}

/// Advice for a file of the data directory that cannot be read: the way back of a lost directory, unless it is only another user's.
pub(crate) fn unreadable_file(config: &Config, refused: Rejection) -> Rejection {
    let opened = std::fs::File::open(config.data.join(GENESIS_FILE)).err();
    match opened.and_then(|error| denied(config, &error)) {
        Some(denied) => denied,
        None => refused.next(way_back(config, &config.member.node)),
    }
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
        .next("use a separate configuration and data directory for each node"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_data_directory_of_another_user_is_not_taken_for_a_lost_one() {
        let config = Config { data: std::env::temp_dir().join("ledgerd-no-such-directory"), ..Config::default() };
        let refused = nothing_here(&config, &ErrorKind::PermissionDenied.into());
        assert!(refused.found.contains("mode ") && refused.found.contains("this process is user "), "{refused}");
        assert!(!refused.advice().contains("network invite") && refused.advice().contains("as that user"), "{refused}");
        let lost = nothing_here(&config, &ErrorKind::NotFound.into());
        assert!(lost.advice().contains("network invite"), "{lost}");
    }
}
