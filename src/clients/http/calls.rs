//! Calls of chaincodes: queries, and transactions that the client has signed.

use super::body;
use super::parameters::Parameters;
use super::rejections::{Rejected, answer};
use super::{Api, access::call};
use crate::process::caller::Caller;
use axum::extract::{Extension, Request, State};
use axum::response::Response;
use bytes::Bytes;
use ledger_api::facts::{DecodedBytes, utc};
use ledger_api::v1;
use ledger_api::v1::gateway_server::Gateway;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::sync::Arc;

/// The form of a query.
const QUERY: &str = r#"{"chaincode":"abac","function":"robots","args":["{}"],"min_height":0,"may_be_stale":false}"#;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Query {
    chaincode: String,
    function: String,
    #[serde(default)]
    args: Vec<Argument>,
    #[serde(default)]
    min_height: u64,
    #[serde(default)]
    may_be_stale: bool,
}

/// An argument: text, or bytes in hexadecimal digits.
#[derive(Deserialize)]
#[serde(untagged, deny_unknown_fields)]
enum Argument {
    Text(String),
    Hex { hex: String },
}

impl Argument {
    fn bytes(self) -> Result<Bytes, Rejection> {
        match self {
            Self::Text(text) => Ok(text.into()),
            Self::Hex { hex: digits } => hex::decode(&digits).map(Bytes::from).map_err(|_| {
                Rejection::new(Code::BadArgument, "an argument cannot be read")
                    .found(format!("{digits:?}"))
                    .wanted("hexadecimal digits, or text without hex")
            }),
        }
    }
}

/// The answer to a query, as `ledgerctl query -o json` prints it.
#[derive(Serialize)]
struct Answered {
    height: u64,
    time: u64,
    time_utc: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    stale_for_us: Option<u64>,
    #[serde(flatten)]
    response: DecodedBytes,
}

pub(super) async fn query(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Result<Response, Rejected> {
    let (_, request) = body::before(request, |request| Parameters::read(request.uri(), &[])).await?;
    let asked: Query = body::json(request, body::BODY_BYTES_MAX, QUERY).await?;
    let Query { chaincode, function, args, min_height, may_be_stale } = asked;
    let args = args.into_iter().map(Argument::bytes).collect::<Result<_, _>>()?;
    let request = v1::QueryRequest { chaincode, function, args, min_height, may_be_stale };
    let told = api.gateway.query(call(caller, request)).await?.into_inner();
    ledger_api::accepted(told.verdict.as_ref())?;
    let stale_for_us = (told.stale_for > 0).then_some(told.stale_for);
    let (height, time) = (told.height, told.time);
    answer(&Answered { height, time, time_utc: utc(time), stale_for_us, response: DecodedBytes::read(&told.response) })
}

/// The answer to a transaction, as `ledgerctl invoke -o json` prints it.
#[derive(Serialize)]
struct Executed {
    id: String,
    height: u64,
    index: u32,
    time: u64,
    time_utc: Option<String>,
    certified: bool,
    #[serde(flatten)]
    response: DecodedBytes,
}

/// How long an answer waits for a certificate, unless the request says something else, milliseconds.
const CERTIFIED_WITHIN: u32 = 2000;

pub(super) async fn submit(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Result<Response, Rejected> {
    let read = |request: &Request| {
        let given = Parameters::read(request.uri(), &["min_height", "first_attempt", "certified_within_ms"])?;
        let within = given.text("certified_within_ms")?.is_empty().then_some(CERTIFIED_WITHIN);
        let within = within.map_or_else(|| given.number("certified_within_ms"), Ok)?;
        Ok((given.number("min_height")?, given.is_on("first_attempt")?, within))
    };
    let ((min_height, first_attempt, certified_within_ms), request) = body::before(request, read).await?;
    let transaction = body::bytes(request, body::BODY_BYTES_MAX).await?;
    let request = v1::SubmitRequest { transaction, min_height, first_attempt };
    let told = api.gateway.submit(call(caller.clone(), request)).await?.into_inner();
    let asked = v1::GetTransactionRequest { id: told.id.clone(), certified_within_ms };
    let v1::SubmitResponse { id, height, index, time, .. } = told;
    let (id, time_utc) = (hex::encode(id), utc(time));
    if let Err(rejection) = ledger_api::accepted(told.verdict.as_ref()) {
        let place = json!({ "id": id, "height": height, "index": index, "time": time, "time_utc": time_utc });
        return Err(Rejected::from(rejection).with(place));
    }
    // An answer without a record is not certified.
    let record = api.gateway.get_transaction(call(caller, asked)).await;
    let certified = record.is_ok_and(|record| record.into_inner().certified);
    answer(&Executed { id, height, index, time, time_utc, certified, response: DecodedBytes::read(&told.response) })
}
