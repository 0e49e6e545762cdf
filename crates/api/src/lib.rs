//! The contract of a node: generated types of `proto/`, TLS, and the Rust client.
//!
//! - [`v1`]: the messages and services of `proto/ledgerd/v1`, which is where they are documented.
//! - [`tls`]: who may connect to whom.
//! - [`Context`]: who this machine is on which network, on disk. [`Enrolment`] makes one.
//! - [`token`]: how a new node gets to know the network.
//! - [`Renewal`]: the next certificate, before the present one runs out.
//! - [`Client`]: signs, submits, queries and subscribes, through whichever node answers.
//! - [`passphrase()`]: of a secret copy, from a file, the environment or the terminal.
//! - [`report`]: a refusal as people read it.
//! - [`facts`]: answers as JSON; [`json`] lays such text out.
//!
//! It knows no chaincode: what functions there are and what their arguments mean is the caller's business.
//!
//! ```no_run
//! # async fn example() -> Result<(), ledger_base::rejection::Rejection> {
//! use ledger_api::{Client, Context};
//! let context = Context::load(&ledger_api::home()?, None)?;
//! let client = Client::connect(&context).await?;
//! let grant = client.invoke("abac", "acquire", vec!["Turtlebot4".into()]).await?;
//! println!("executed at height {}", grant.height);
//! # Ok(())
//! # }
//! ```

mod certification;
mod client;
mod clock;
mod connect;
pub mod context;
mod enrol;
pub mod facts;
pub mod json;
pub mod pages;
mod passphrase;
mod renew;
mod report;
pub mod tls;
pub mod token;

pub use client::{
    Answer, Call, Certified, Client, Committed, EventStream, IN_FLIGHT_BYTES_MAX, IN_FLIGHT_MAX, Leadership, Options,
    Pending, Registered, SECRET_LIFE, Subscription, read_checkpoint,
};
pub use clock::wait_by_clock;
pub use connect::{Credentials, found_network};
pub use context::{Context, home, renewal_due};
pub use enrol::Enrolment;
pub use passphrase::{passphrase, secret};
pub use renew::{Renewal, Renewed};
pub use report::{ERROR_DOMAIN, accepted, from_status, report, to_status};

/// Types generated from `proto/ledgerd/v1`.
#[expect(
    missing_docs,
    unused_qualifications,
    clippy::allow_attributes,
    clippy::allow_attributes_without_reason,
    reason = "generated"
)]
pub mod v1 {
    tonic::include_proto!("ledgerd.v1");
}

/// The proto files as an encoded `google.protobuf.FileDescriptorSet`, for server reflection.
pub const FILE_DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
