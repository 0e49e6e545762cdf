//! Questions about the node, its blocks, and the past.

use super::parameters::{self, Parameters, Part};
use super::rejections::{Rejected, answer};
use super::shape::NodeFacts;
use super::{Api, access::call};
use crate::process::caller::Caller;
use axum::extract::{Extension, State};
use axum::http::Uri;
use axum::response::Response;
use ledger_api::facts::{AuditFacts, BlockFacts, DenialFacts, StatusFacts, TransactionFacts};
use ledger_api::v1;
use ledger_api::v1::gateway_server::Gateway;
use serde_json::json;
use std::sync::Arc;

/// The filters of the audit.
const AUDIT: [&str; 8] = ["robot", "user", "organisation", "code", "since", "until", "after", "limit"];

pub(super) async fn status(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    uri: Uri,
) -> Result<Response, Rejected> {
    Parameters::read(&uri, &[])?;
    let status = api.gateway.status(call(caller, v1::StatusRequest {})).await?;
    answer(&StatusFacts::from(status.into_inner()))
}

pub(super) async fn nodes(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    uri: Uri,
) -> Result<Response, Rejected> {
    Parameters::read(&uri, &[])?;
    let told = api.gateway.nodes(call(caller, v1::NodesRequest {})).await?.into_inner();
    let nodes: Vec<_> = told.nodes.into_iter().map(NodeFacts::from).collect();
    answer(&json!({ "nodes": nodes }))
}

pub(super) async fn block(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    height: Part,
    uri: Uri,
) -> Result<Response, Rejected> {
    Parameters::read(&uri, &[])?;
    let height = parameters::height(height)?;
    let block = api.gateway.get_block(call(caller, v1::GetBlockRequest { height })).await?;
    answer(&BlockFacts::from(block.into_inner()))
}

pub(super) async fn transaction(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    id: Part,
    uri: Uri,
) -> Result<Response, Rejected> {
    let certified_within_ms = Parameters::read(&uri, &["certified_within_ms"])?.number("certified_within_ms")?;
    let id = parameters::id(id)?.0.to_vec().into();
    let request = v1::GetTransactionRequest { id, certified_within_ms };
    let record = api.gateway.get_transaction(call(caller, request)).await?;
    answer(&TransactionFacts::from(record.into_inner()))
}

pub(super) async fn audit(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    uri: Uri,
) -> Result<Response, Rejected> {
    let given = Parameters::read(&uri, &AUDIT)?;
    let request = v1::AuditRequest {
        robot: given.text("robot")?,
        user: given.text("user")?,
        organisation: given.text("organisation")?,
        code: given.number("code")?,
        since: given.number("since")?,
        until: given.number("until")?,
        after: given.bytes("after")?.into(),
        limit: given.number("limit")?,
    };
    let found = api.gateway.audit(call(caller, request)).await?.into_inner();
    let rows: Vec<_> = found.rows.into_iter().map(AuditFacts::from).collect();
    let v1::AuditResponse { after, more, from_height, height, executed, .. } = found;
    answer(&json!({
        "rows": rows, "after": hex::encode(after), "more": more, "from_height": from_height, "height": height,
        "executed": executed
    }))
}

pub(super) async fn denials(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    uri: Uri,
) -> Result<Response, Rejected> {
    let limit = Parameters::read(&uri, &["limit"])?.number("limit")?;
    let found = api.gateway.denials(call(caller, v1::DenialsRequest { limit })).await?.into_inner();
    answer(&found.denials.into_iter().map(DenialFacts::from).collect::<Vec<_>>())
}
