//! The content of the state: robots and their services, grants with the keys that find them, the last message of a
//! service. The lowest layer: it knows no rule, no policy and no call.

pub(crate) mod cancelled;
pub(crate) mod grant;
pub(crate) mod last;
pub(crate) mod line;
pub(crate) mod parsed;
pub(crate) mod pending;
pub(crate) mod policy_set;
pub(crate) mod principal;
pub(crate) mod proposed;
pub(crate) mod reader;
pub(crate) mod robot;
pub(crate) mod service;
pub(crate) mod side_door;
pub(crate) mod stopped;
pub(crate) mod store;
pub(crate) mod target;
pub(crate) mod task;
pub(crate) mod used;

use self::grant::Holding;
use self::parsed::Parsed;
use self::target::{Offered, Target};
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_identity::Identity;
use std::sync::Arc;

/// Records that were parsed before. They save time and never change an answer.
#[derive(Default)]
pub(crate) struct Records {
    robots: Parsed<Offered>,
    grants: Parsed<Holding>,
}

impl Records {
    /// The service of an id, as [`target::resolve`] finds it.
    ///
    /// # Errors
    /// As [`target::resolve`].
    pub(crate) fn target(&self, ctx: &Context<'_>, id: &str) -> Result<Arc<Target>, Rejection> {
        let (robot, topic) = target::split(id);
        let offered = self.robots.read(ctx, &store::robot_key(robot), Offered::parse)?;
        match offered.as_ref().and_then(|offered| offered.find(topic)) {
            Some(target) => Ok(Arc::clone(target)),
            // It says what is wrong.
            None => target::resolve(ctx, id).map(Arc::new),
        }
    }

    /// The live grant that was acquired with this very certificate.
    ///
    /// # Errors
    /// [`ledger_base::rejection::Code::Corrupt`] if the state cannot be read.
    pub(crate) fn held(
        &self,
        ctx: &Context<'_>,
        service: &str,
        submitter: &Identity,
    ) -> Result<Option<Arc<Holding>>, Rejection> {
        let held = self.grants.read(ctx, &store::grant_key(service, &submitter.id()), store::parse)?;
        let entitles = |held: &Arc<Holding>| {
            held.is_live(ctx.block_time()) && held.principal.fingerprint.0 == submitter.fingerprint
        };
        Ok(held.filter(entitles))
    }
}
