//! Which context we act as: `--context`, else `LEDGERCTL_CONTEXT`, else the one of `context use`.

use crate::global::Global;
pub(crate) use ledger_api::home;
use ledger_api::{Context, found_network};
use ledger_base::rejection::Rejection;
use ledger_identity::Identity;
use ledger_identity::certificate::Certificate;
use std::path::{Path, PathBuf};

/// Names the context to act as, where `--context` does not.
pub(crate) const VARIABLE: &str = "LEDGERCTL_CONTEXT";

/// The context to act as.
pub(crate) fn selected(global: &Global) -> Result<Context, Rejection> {
    Context::load(&home()?, chosen(global).as_deref())
}

/// The name of the context to act as, if any is chosen or selected.
pub(crate) fn name_in_use(global: &Global, home: &Path) -> Result<Option<String>, Rejection> {
    chosen(global).map_or_else(|| Context::current(home), |name| Ok(Some(name)))
}

fn chosen(global: &Global) -> Option<String> {
    global.context.clone().or_else(|| std::env::var(VARIABLE).ok().filter(|name| !name.is_empty()))
}

/// Where a different network answers: names the contexts of that network, if there are any.
pub(crate) fn fitting(refused: Rejection) -> Rejection {
    let (Some(network), Ok(home)) = (found_network(&refused), home()) else { return refused };
    let mut names = Context::list(&home).unwrap_or_default();
    names.retain(|name| Context::load(&home, Some(name)).is_ok_and(|context| context.network == network));
    if names.is_empty() {
        return refused;
    }
    let names: Vec<_> = names.iter().map(|name| format!("--context {name}")).collect();
    refused.next(format!("use a context of that network: {}", names.join(" or ")))
}

/// Where a context is stored.
pub(crate) fn directory(home: &Path, name: &str) -> PathBuf {
    home.join("contexts").join(name)
}

/// Our identity by the context's certificate, whether it is still valid or not.
pub(crate) fn identity(context: &Context) -> Result<Identity, Rejection> {
    verified(context, context.chain.first().map(AsRef::as_ref).unwrap_or_default())
}

/// The owner of this certificate, by the organisations that the context knows, at the beginning of its validity.
pub(crate) fn verified(context: &Context, der: &[u8]) -> Result<Identity, Rejection> {
    let at = Certificate::parse(der)?.not_before;
    Ok(context.msps.verify(der, context.chain.get(1..).unwrap_or_default(), at)?)
}
