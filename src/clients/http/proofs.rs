//! Proofs: bytes that a light client checks (docs/format.md), in hexadecimal digits.

use super::parameters::{self, Parameters, Part};
use super::rejections::{Rejected, answer};
use super::{Api, access::call, lines};
use crate::process::caller::Caller;
use axum::extract::{Extension, State};
use axum::http::Uri;
use axum::response::Response;
use ledger_api::v1;
use ledger_api::v1::gateway_server::Gateway;
use serde::Serialize;
use serde_json::json;
use std::sync::Arc;

pub(super) async fn block(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    height: Part,
    uri: Uri,
) -> Result<Response, Rejected> {
    let verdicts = Parameters::read(&uri, &["verdict"])?.numbers("verdict")?;
    let request = v1::ProveRequest { height: parameters::height(height)?, verdicts };
    let told = api.gateway.prove(call(caller, request)).await?.into_inner();
    answer(&json!({ "proof": hex::encode(told.proof) }))
}

pub(super) async fn transaction(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    id: Part,
    uri: Uri,
) -> Result<Response, Rejected> {
    Parameters::read(&uri, &[])?;
    let request = v1::ProveTransactionRequest { id: parameters::id(id)?.0.to_vec().into() };
    let told = api.gateway.prove_transaction(call(caller, request)).await?.into_inner();
    answer(&json!({ "link": hex::encode(told.link) }))
}

/// A step of the way to the newest block.
#[derive(Serialize)]
struct Step {
    #[serde(skip_serializing_if = "String::is_empty")]
    genesis: String,
    changes: Vec<Change>,
    proof: String,
}

#[derive(Serialize)]
struct Change {
    height: u64,
    writes: String,
}

impl From<v1::GovernanceStep> for Step {
    fn from(step: v1::GovernanceStep) -> Self {
        let change =
            |change: v1::GovernanceChange| Change { height: change.height, writes: hex::encode(change.writes) };
        Self {
            genesis: hex::encode(step.genesis),
            changes: step.changes.into_iter().map(change).collect(),
            proof: hex::encode(step.proof),
        }
    }
}

pub(super) async fn governance(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    uri: Uri,
) -> Result<Response, Rejected> {
    let after = Parameters::read(&uri, &["after"])?.number("after")?;
    let steps = api.gateway.governance(call(caller, v1::GovernanceRequest { after })).await?.into_inner();
    Ok(lines::answer(steps, Step::from))
}
