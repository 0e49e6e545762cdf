//! The place from which a service with limited subscribers is read.

use crate::answer;
use crate::command::grant;
use crate::failure::Failure;
use crate::output::Output;
use crate::session::{ABAC, Session};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Grant, ServiceState, readers};
use serde::Deserialize;
use std::time::Duration;
use tokio::time::sleep;

/// The answer of `authorize`, as far as it matters here.
#[derive(Deserialize)]
struct Authorization {
    /// The name of the code of the refusal.
    name: String,
}

/// A place that this command has taken; none if it needs none, or its user has one.
pub(crate) struct Place<'s> {
    session: &'s Session,
    taken: Option<Grant>,
}

impl<'s> Place<'s> {
    /// Takes a place, if the service limits its subscribers. Waits for one where the service has a line.
    pub(crate) async fn take(session: &'s Session, service: &ServiceState, output: &Output) -> Result<Self, Failure> {
        let args = [service.service.as_str(), "subscribe"].map(|arg| Bytes::copy_from_slice(arg.as_bytes()));
        let may: Authorization = answer::parse(&session.ask(ABAC, "authorize", args.to_vec()).await?, "a right")?;
        let taken = if service.sharing.subscribers.is_some() && may.name == Code::NotHolder.name() {
            Some(grant::acquire(session, readers(&service.service), output).await?)
        } else {
            None
        };
        Ok(Self { session, taken })
    }

    /// Renews the place until it is lost; for ever if there is none.
    pub(crate) async fn keep(&self) -> Rejection {
        let Some(Grant { service, lease_ms, .. }) = &self.taken else { return std::future::pending().await };
        loop {
            sleep(Duration::from_millis(lease_ms / 3)).await;
            let renewed = self.session.call(ABAC, "renew", vec![Bytes::from(service.clone())]).await;
            match renewed.map(|done| answer::parse::<Grant>(&done.response, "a grant")) {
                Err(refused) if refused.code.is_final() => return refused,
                _ => {}
            }
        }
    }

    /// Gives the place back. If that fails, it ends with its lease.
    pub(crate) async fn give_back(&self) {
        if let Some(Grant { service, .. }) = &self.taken {
            let _ended = self.session.call(ABAC, "release", vec![Bytes::from(service.clone())]).await;
        }
    }
}
