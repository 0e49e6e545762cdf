//! Proposals of functions of this chaincode.

use super::NAME;
use super::store::json;
use crate::chaincode::Call;
use ledger_base::rejection::Rejection;
use serde::Serialize;

/// The call of a function of this chaincode with this argument.
pub(super) fn own_call(function: &str, argument: &impl Serialize) -> Result<Call, Rejection> {
    Ok(Call { chaincode: NAME.to_owned(), function: function.to_owned(), args: vec![json(argument)?] })
}
