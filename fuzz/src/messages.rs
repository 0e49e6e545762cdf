//! Every message of the proto files.

use ledger_api::v1;
use prost::Message;

/// Is a message that can be read the same when it was written and is read again?
pub type Round = fn(&[u8]) -> bool;

/// Names and readers of the messages; a test of the repository compares the names with the proto files.
pub const ALL: &[(&str, Round)] = &[
    ("Attested", round::<v1::Attested>),
    ("Block", round::<v1::Block>),
    ("BlockEntries", round::<v1::BlockEntries>),
    ("BlockEntry", round::<v1::BlockEntry>),
    ("BlocksRequest", round::<v1::BlocksRequest>),
    ("CertificateStatus", round::<v1::CertificateStatus>),
    ("ChainRequest", round::<v1::ChainRequest>),
    ("ChainResponse", round::<v1::ChainResponse>),
    ("Delivery", round::<v1::Delivery>),
    ("Denial", round::<v1::Denial>),
    ("DenialsRequest", round::<v1::DenialsRequest>),
    ("DenialsResponse", round::<v1::DenialsResponse>),
    ("DigestRequest", round::<v1::DigestRequest>),
    ("DigestResponse", round::<v1::DigestResponse>),
    ("EnrolRequest", round::<v1::EnrolRequest>),
    ("EnrolResponse", round::<v1::EnrolResponse>),
    ("EventRecord", round::<v1::EventRecord>),
    ("GenesisRequest", round::<v1::GenesisRequest>),
    ("GenesisResponse", round::<v1::GenesisResponse>),
    ("GetBlockRequest", round::<v1::GetBlockRequest>),
    ("GetTransactionRequest", round::<v1::GetTransactionRequest>),
    ("GovernanceChange", round::<v1::GovernanceChange>),
    ("GovernanceRequest", round::<v1::GovernanceRequest>),
    ("GovernanceStep", round::<v1::GovernanceStep>),
    ("JoinOrganisationRequest", round::<v1::JoinOrganisationRequest>),
    ("JoinOrganisationResponse", round::<v1::JoinOrganisationResponse>),
    ("NetworkRequest", round::<v1::NetworkRequest>),
    ("NetworkResponse", round::<v1::NetworkResponse>),
    ("OfferCaRequest", round::<v1::OfferCaRequest>),
    ("OfferCaResponse", round::<v1::OfferCaResponse>),
    ("Organisation", round::<v1::Organisation>),
    ("PeerClosed", round::<v1::PeerClosed>),
    ("PeerFrame", round::<v1::PeerFrame>),
    ("PeerStatus", round::<v1::PeerStatus>),
    ("ProveRequest", round::<v1::ProveRequest>),
    ("ProveResponse", round::<v1::ProveResponse>),
    ("QueryRequest", round::<v1::QueryRequest>),
    ("QueryResponse", round::<v1::QueryResponse>),
    ("Receipt", round::<v1::Receipt>),
    ("RenewRequest", round::<v1::RenewRequest>),
    ("SealCaRequest", round::<v1::SealCaRequest>),
    ("SealCaResponse", round::<v1::SealCaResponse>),
    ("SnapshotChunk", round::<v1::SnapshotChunk>),
    ("SnapshotChunksRequest", round::<v1::SnapshotChunksRequest>),
    ("SnapshotRequest", round::<v1::SnapshotRequest>),
    ("SnapshotResponse", round::<v1::SnapshotResponse>),
    ("StatusRequest", round::<v1::StatusRequest>),
    ("StatusResponse", round::<v1::StatusResponse>),
    ("SubmitRequest", round::<v1::SubmitRequest>),
    ("SubmitResponse", round::<v1::SubmitResponse>),
    ("SubscribeRequest", round::<v1::SubscribeRequest>),
    ("TakeCaRequest", round::<v1::TakeCaRequest>),
    ("TakeCaResponse", round::<v1::TakeCaResponse>),
    ("Transaction", round::<v1::Transaction>),
    ("TransactionBody", round::<v1::TransactionBody>),
    ("TransactionRecord", round::<v1::TransactionRecord>),
    ("TransferLeadershipRequest", round::<v1::TransferLeadershipRequest>),
    ("TransferLeadershipResponse", round::<v1::TransferLeadershipResponse>),
    ("Unit", round::<v1::Unit>),
    ("Units", round::<v1::Units>),
    ("Verdict", round::<v1::Verdict>),
    ("Write", round::<v1::Write>),
    ("WritesRequest", round::<v1::WritesRequest>),
    ("WritesResponse", round::<v1::WritesResponse>),
];

fn round<M: Message + Default + PartialEq>(bytes: &[u8]) -> bool {
    M::decode(bytes).is_err() || M::decode(bytes).is_ok_and(|read| M::decode(&*read.encode_to_vec()) == Ok(read))
}
