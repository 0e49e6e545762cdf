//! The answers about sets of policies: the number of the set that is in force, and who agrees to one that is proposed.

use crate::oracle::model::{Agreed, Judged, Model};
use ledger_base::rejection::Code;
use ledger_storage::result::TransactionResult;
use serde::Deserialize;
use std::collections::BTreeSet;

/// The fields that are read of a change of policies.
#[derive(Deserialize)]
struct Changed {
    version: u64,
}

/// The fields that are read of a proposed set.
#[derive(Deserialize)]
struct Proposed {
    id: String,
    approved: Vec<Approval>,
    needs: Vec<Need>,
}

#[derive(Deserialize)]
struct Approval {
    who: String,
}

#[derive(Deserialize)]
struct Need {
    missing: u64,
}

/// Compares an answer with the model, which learns the name of a new proposal.
pub(super) fn check(model: &mut Model, judged: &Judged, result: &TransactionResult) -> Result<(), String> {
    if judged.code != Code::Ok {
        return Ok(());
    }
    if let Some(version) = judged.version {
        let found: Changed = serde_json::from_slice(&result.response).map_err(|fault| fault.to_string())?;
        if found.version != version {
            return Err(format!("set {} is in force, the model says {version}", found.version));
        }
    }
    let Some(agreed) = &judged.agreed else { return Ok(()) };
    let Proposed { id, approved, needs } =
        serde_json::from_slice(&result.response).map_err(|fault| fault.to_string())?;
    let by: BTreeSet<String> = approved.iter().map(|approval| approval.who.clone()).collect();
    let is_once = by.len() == approved.len();
    let found = Agreed { by, missing: needs.iter().map(|need| need.missing).sum() };
    if found != *agreed || !is_once {
        return Err(format!("{found:?} to proposal {id}, the model says {agreed:?}"));
    }
    if model.is_unnamed() && !model.named(&id) {
        return Err(format!("two proposals are named {id}"));
    }
    Ok(())
}
