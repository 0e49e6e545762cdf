//! The nodes of a network that still answer. Only a node that shows its certificate counts: nobody else can hold a recovery up.

use crate::ordering::directory::Member;
use crate::trust::credentials::NodeCredentials;
use futures::future::join_all;
use ledger::Ledger;
use ledger_api::tls::ServerTrust;
use ledger_api::{Client, Credentials, Options};
use ledger_base::rejection::Rejection;
use std::time::Duration;

/// How long a node may take to answer.
const ANSWER_TIME_MAX: Duration = Duration::from_secs(5);

/// A node that answered.
pub(super) struct Answer {
    /// Its number.
    pub(super) id: u64,
    /// The end of its log.
    pub(super) last: u64,
}

/// Asks all members but the own one.
///
/// # Errors
/// If this node's certificate is of no use.
pub(super) async fn survey(
    papers: &NodeCredentials,
    ledger: &Ledger,
    me: &Member,
    members: &[Member],
) -> Result<Vec<Answer>, Rejection> {
    let trust = ServerTrust::Roots(ledger.msps());
    let credentials = Credentials::new(ledger.network(), papers.identity.clone(), trust)?;
    let options = Options { deadline: ANSWER_TIME_MAX, connect: ANSWER_TIME_MAX, ..Options::default() };
    let asked = members.iter().filter(|member| member.id != me.id).map(|member| {
        let credentials = credentials.clone();
        async move {
            let answer = async {
                let client = Client::connect_with(vec![member.address.clone()], credentials, options).await?;
                client.status().await
            };
            let status = tokio::time::timeout(ANSWER_TIME_MAX, answer).await.ok()?.ok()?;
            Some(Answer { id: status.node_id, last: status.last_index.max(status.height) })
        }
    });
    Ok(join_all(asked).await.into_iter().flatten().filter(|answer| answer.id != me.id).collect())
}
