//! The contract of a node: generated types of `proto/`, TLS, and the Rust client.

pub mod tls;

/// Types generated from `proto/ledgerd/v1`.
#[expect(missing_docs, unused_qualifications, reason = "generated")]
pub mod v1 {
    tonic::include_proto!("ledgerd.v1");
}
