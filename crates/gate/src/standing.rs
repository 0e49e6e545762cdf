//! How a robot stands: its services, who holds them, and who governs the network, as voters have signed it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Declaration, Grant, RobotAsset, RunningTask, ServiceState};
use ledger_identity::{Identity, msp::Msps};
use ledger_light::Governance;

use crate::service::Service;

/// The authorities of the organisations, and the certificates that were revoked: they decide whose signatures count.
#[derive(Clone, Debug)]
pub struct Members {
    /// The authorities.
    pub msps: Arc<Msps>,
    /// Keys of the revoked certificates ([`Identity::revocation_key`]).
    pub revoked: Arc<BTreeSet<Vec<u8>>>,
    /// Names whose certificates were revoked, up to when these begin: [`Governance::barred`].
    pub barred: Arc<BTreeMap<String, u64>>,
}

impl Members {
    /// The members that govern after a block that was followed.
    ///
    /// # Errors
    /// [`Code::Malformed`] if a record of an organisation cannot be read.
    pub fn of(governance: &Governance) -> Result<Self, Rejection> {
        let revoked = governance.revocations().map(<[u8]>::to_vec).collect();
        Ok(Self {
            msps: Arc::new(governance.msps()?),
            revoked: Arc::new(revoked),
            barred: Arc::new(governance.barred()?),
        })
    }

    /// Was this identity's certificate revoked, by itself or with its name?
    pub fn has_revoked(&self, identity: &Identity) -> bool {
        let is_barred = || self.barred.get(&identity.id()).is_some_and(|time| identity.valid_from <= *time);
        self.revoked.contains(&identity.revocation_key()) || (!self.barred.is_empty() && is_barred())
    }
}

/// How a robot stands after a block.
#[derive(Clone, Debug)]
pub struct Standing {
    /// Its services.
    pub services: Vec<ServiceState>,
    /// The grants of its services.
    pub grants: Vec<Grant>,
    /// The tasks that these grants serve; none where the bridge believes its node.
    pub tasks: Vec<RunningTask>,
    /// Is it stopped, until somebody who may resumes it?
    pub stopped: bool,
    /// The stops that the question named and that are settled, by their ids.
    pub settled: BTreeSet<Hash>,
    /// The authorities and revocations.
    pub members: Members,
    /// The block.
    pub height: u64,
    /// Block time, microseconds since the UNIX epoch.
    pub time: u64,
}

impl Standing {
    /// The standing that the answer to `abac declare ROBOT` tells. Its proof was checked, and led to who governs after its block.
    ///
    /// # Errors
    /// [`Code::Malformed`] if the answer cannot be read.
    pub fn declared(answer: &[u8], members: &Members, after: &Governance) -> Result<Self, Rejection> {
        let declared: Declaration = serde_json::from_slice(answer).map_err(|error| {
            Rejection::new(Code::Malformed, "the answer to abac declare cannot be read")
                .found(error.to_string())
                .wanted("JSON that this version understands")
                .next("use the same version for node and bridge")
        })?;
        let Declaration { robot: RobotAsset { services, stopped, .. }, grants, tasks, settled } = declared;
        let settled = settled.iter().filter_map(|id| Hash::from_hex(id)).collect();
        let stopped = stopped.is_some();
        Ok(Self {
            services,
            grants,
            tasks,
            stopped,
            settled,
            members: members.clone(),
            height: after.height(),
            time: after.time(),
        })
    }

    /// One of its services.
    ///
    /// # Errors
    /// [`Code::UnknownService`]; as [`Service::try_from`].
    pub fn service(&self, id: &str) -> Result<Service, Rejection> {
        let state = self.services.iter().find(|state| state.service == id).ok_or_else(|| {
            Rejection::new(Code::UnknownService, format!("there is no service {id}"))
                .found(format!("{} services of its robot", self.services.len()))
                .wanted("a service of a registered robot")
                .next("ask the owner: ledgerctl robot show lists the services")
        })?;
        Service::try_from(state.clone())
    }
}
