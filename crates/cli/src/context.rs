//! Which context we act as: `--context`, else `LEDGERCTL_CONTEXT`, else the one of `context use`.

use crate::cli::Global;
use ledger::certificate::Certificate;
use ledger::identity::Identity;
use ledger::{Code, Rejection};
use ledger_api::Context;
use std::path::{Path, PathBuf};

/// Names the context to act as, where `--context` does not.
const VARIABLE: &str = "LEDGERCTL_CONTEXT";

/// The directory that holds the contexts.
pub(crate) fn home() -> Result<PathBuf, Rejection> {
    Context::home()
}

/// The context to act as.
pub(crate) fn selected(global: &Global) -> Result<Context, Rejection> {
    let home = home()?;
    match name_in_use(global, &home)? {
        Some(name) => Context::load(&home, &name),
        None => {
            let known = Context::list(&home)?;
            let refusal = Rejection::new(Code::NoContext, "no context is selected");
            Err(if known.is_empty() {
                refusal
                    .found(format!("no context in {}", home.display()))
                    .wanted("a context, made by `ledgerctl enroll`")
                    .next("ask an admin of your organisation to run `ledgerctl identity register YOUR-NAME`")
            } else {
                refusal
                    .found(format!("contexts {}", known.join(", ")))
                    .wanted("--context NAME, LEDGERCTL_CONTEXT=NAME, or a context in use")
                    .next(format!("ledgerctl context use {}", known.first().map_or("NAME", String::as_str)))
            })
        }
    }
}

/// Its name, if any is selected.
pub(crate) fn name_in_use(global: &Global, home: &Path) -> Result<Option<String>, Rejection> {
    if let Some(name) = &global.context {
        return Ok(Some(name.clone()));
    }
    match std::env::var(VARIABLE) {
        Ok(name) if !name.is_empty() => Ok(Some(name)),
        _ => Context::selected(home),
    }
}

/// Selects the context if none is selected yet; was it?
pub(crate) fn select_if_none(home: &Path, name: &str) -> Result<bool, Rejection> {
    match Context::selected(home)? {
        Some(selected) => Ok(selected == name),
        None => Context::select(home, name).map(|()| true),
    }
}

/// Who the context's certificate says we are, whether it is still valid or not.
pub(crate) fn identity(context: &Context) -> Result<Identity, Rejection> {
    verified(context, context.certificate())
}

/// Whose certificate this is, by the organisations that the context knows, at the beginning of its validity.
pub(crate) fn verified(context: &Context, der: &[u8]) -> Result<Identity, Rejection> {
    let at = Certificate::parse(der)?.not_before;
    Ok(context.msps.verify(der, context.chain(), at)?)
}

/// Deletes a context with its key.
pub(crate) fn delete(home: &Path, name: &str) -> Result<(), Rejection> {
    Context::delete(home, name)
}
