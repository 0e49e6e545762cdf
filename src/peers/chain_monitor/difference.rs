//! Where two nodes began to differ.
//!
//! The state digest covers everything since the genesis: once two nodes differ they differ for ever, so the first
//! difference is found by halving. The key is found by comparing what the block wrote, if that is recent enough to be
//! known to both.

use crate::ordering::directory::{Directory, Member};
use crate::peers::connections::Dialer;
use bytes::Bytes;
use ledger::Ledger;
use ledger::writes::Write;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::{DigestRequest, WritesRequest};
use std::collections::BTreeMap;
use std::time::Duration;
use tonic::transport::Channel;

/// How long the search may take.
const SEARCH_TIME_MAX: Duration = Duration::from_secs(5);

/// Describes the first difference between this node and one that contradicts it, as well as it can be found.
pub(super) async fn find(
    ledger: &Ledger,
    directory: &Directory,
    dialer: &Dialer,
    (name, height): (&str, u64),
) -> String {
    let members = directory.members();
    let Some(member) = members.iter().find(|member| member.full_name() == name) else {
        return format!("the digest of {name} at height {height}");
    };
    match tokio::time::timeout(SEARCH_TIME_MAX, search(ledger, dialer, member, height)).await {
        Ok(Ok(found)) => found,
        Ok(Err(reason)) => format!("the digest of {name} at height {height} ({name} was asked for more: {reason})"),
        Err(_) => format!("the digest of {name} at height {height} ({name} was asked for more, and did not answer)"),
    }
}

async fn search(ledger: &Ledger, dialer: &Dialer, member: &Member, noticed: u64) -> Result<String, String> {
    let mut peer = PeerClient::new(dialer.channel(member).await?);
    let (mut agreed, mut differing) = (0, noticed);
    while let Some(height) = halve(agreed, differing) {
        match same_digest(ledger, &mut peer, height).await? {
            // One of both has dropped the block: the difference is later than it, or cannot be found.
            None | Some(true) => agreed = height,
            Some(false) => differing = height,
        }
    }
    let name = member.full_name();
    let what = format!("the results of {name}: height {differing} is the first that differs");
    Ok(match first_key(ledger, &mut peer, differing).await? {
        Some(key) => format!("{what}, in key {key}"),
        None => format!("{what}, in verdicts or in a key that is not known any more"),
    })
}

async fn same_digest(ledger: &Ledger, peer: &mut PeerClient<Channel>, height: u64) -> Result<Option<bool>, String> {
    let Some(own) = ledger.block_hashes(height).map_err(|fault| fault.message)? else { return Ok(None) };
    let answer = peer.digest(DigestRequest { height }).await.map_err(|status| status.message().to_owned())?;
    let digest = answer.into_inner().digest;
    Ok((!digest.is_empty()).then(|| digest == own.digest.0[..]))
}

/// The first key that the block at this height wrote differently, readable.
async fn first_key(ledger: &Ledger, peer: &mut PeerClient<Channel>, height: u64) -> Result<Option<String>, String> {
    let answer = peer.writes(WritesRequest { height }).await.map_err(|status| status.message().to_owned())?;
    let (theirs, Some(own)) = (answer.into_inner(), ledger.writes(height)) else { return Ok(None) };
    if !theirs.known {
        return Ok(None);
    }
    let theirs: BTreeMap<_, _> = theirs.writes.into_iter().map(|write| (write.key, write.value_hash)).collect();
    let hash = |write: &Write| write.value.map(|hash| hash.0.to_vec().into()).unwrap_or_default();
    let own: BTreeMap<_, Bytes> = own.into_iter().map(|write| (write.key.clone(), hash(&write))).collect();
    let keys = theirs.keys().chain(own.keys()).filter(|key| theirs.get(*key) != own.get(*key));
    Ok(keys.min().map(|key| key.escape_ascii().to_string()))
}

/// The next height to compare when the digests agree at `agreed` and differ at `differing`; none when that is the first
/// difference.
fn halve(agreed: u64, differing: u64) -> Option<u64> {
    (differing > agreed + 1).then(|| agreed + (differing - agreed) / 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_finds_the_first_difference() {
        let first = 777;
        let (mut agreed, mut differing, mut questions) = (0, 10_000, 0);
        while let Some(height) = halve(agreed, differing) {
            questions += 1;
            if height >= first { differing = height } else { agreed = height }
        }
        assert_eq!(differing, first);
        assert!(questions <= 14, "{questions}");
    }
}
