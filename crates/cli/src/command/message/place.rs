//! The place from which a service with limited subscribers is read.

use crate::answer;
use crate::command::grant::{self, Kept};
use crate::failure::Failure;
use crate::output::Output;
use crate::session::{ABAC, Session};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{ServiceState, readers};
use serde::Deserialize;

/// The answer of `authorize`, as far as it matters here.
#[derive(Deserialize)]
struct Authorization {
    /// The name of the code of the refusal.
    name: String,
}

/// A place that this command has taken; none if it needs none, or its user has one.
pub(crate) struct Place<'s> {
    taken: Option<Kept<'s>>,
}

impl<'s> Place<'s> {
    /// Takes a place, if the service limits its subscribers. Waits for one where the service has a line.
    pub(crate) async fn take(session: &'s Session, service: &ServiceState, output: &Output) -> Result<Self, Failure> {
        let args = [service.service.as_str(), "subscribe"].map(|arg| Bytes::copy_from_slice(arg.as_bytes()));
        let may: Authorization = answer::parse(&session.ask(ABAC, "authorize", args.to_vec()).await?, "a right")?;
        let taken = if service.sharing.subscribers.is_some() && may.name == Code::NotHolder.name() {
            let grant = grant::acquire(session, readers(&service.service), output).await?;
            Some(Kept::of(session, vec![grant]))
        } else {
            None
        };
        Ok(Self { taken })
    }

    /// Renews the place until it is lost; for ever if there is none.
    pub(crate) async fn keep(&self) -> Rejection {
        let Some(place) = &self.taken else { return std::future::pending().await };
        loop {
            // Without an answer it is not known to be lost.
            let refused = place.renewals(|_| ()).await;
            if refused.code.is_final() {
                return refused;
            }
        }
    }

    /// Gives the place back. If that fails, it ends with its lease.
    pub(crate) async fn give_back(&self) {
        if let Some(place) = &self.taken {
            let _ended = place.release().await;
        }
    }
}
