//! The ledger's answers about services and callers, as the bridge reads them.

use ledger_base::rejection::{Code, Rejection};
use ledger_contract::ServiceState;
use ledger_gate::{ABAC, service::Service};
use serde::Deserialize;

use super::gateway::{Gateway, ask};

/// The rights of the caller now, as `abac authorize` answers.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Authorization {
    pub(crate) epoch: u64,
    pub(crate) next_seq: u64,
    /// The name of the code, e.g. `MISSING_ATTRIBUTE`.
    #[serde(default)]
    name: String,
    /// Why not, in words.
    #[serde(default)]
    pub(crate) reason: String,
}

impl Authorization {
    /// The code, if this version knows it.
    pub(crate) fn code(&self) -> Option<Code> {
        Code::ALL.iter().copied().find(|code| code.name() == self.name)
    }
}

/// The identity of the caller, as `abac GetSubmittingClientIdentity` answers.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Caller {
    pub(crate) id: String,
}

/// Asks the ledger for a service.
pub(crate) async fn ask_service(gateway: &dyn Gateway, height: u64, id: &str) -> Result<(Service, u64), Rejection> {
    let (state, height): (ServiceState, u64) = ask(gateway, height, ABAC, "service", &[id]).await?;
    Ok((Service::try_from(state)?, height))
}
