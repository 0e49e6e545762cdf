//! The ledger: transactions, blocks, and what executing them means.
//!
//! Nothing here knows a network, an async runtime or a clock: time and randomness are arguments, and files are behind
//! [`ledger_storage`]. So the whole of it runs in a simulator as it runs in a node.
//!
//! | module | what is there |
//! |---|---|
//! | [`transaction`] | a signed call: its bytes, its id, its limits |
//! | [`block`], [`members`] | what a committed entry of the log means: transactions, or a change of the voters |
//! | [`Ledger`] | the chain as far as it is executed: admission, applying blocks, queries, storing |
//! | [`Chaincode`] | a program that every node executes; [`Context`] is all that it may know |
//! | [`msp`] | the chaincode `msp`: organisations, identities, nodes, proposals, attestations |
//! | [`network`], [`Rules`] | the genesis; the numbers of the rules by which blocks are executed |
//! | [`evidence`] | one file that proves a transaction to somebody without a network |
//! | [`branch`], [`headers`] | headers of another branch up to a block that voters have certified; bytes of headers |
//! | [`writes`] | what recent blocks wrote, to find where two nodes differ |
//! | `verify` | checking a data directory offline (feature `verify`, which links sled) |
//!
//! A chaincode of one's own:
//!
//! ```
//! use bytes::Bytes;
//! use ledger::{Chaincode, Context};
//! use ledger_base::rejection::{Code, Rejection};
//!
//! /// Counts.
//! struct Counter;
//!
//! impl Chaincode for Counter {
//!     fn name(&self) -> &'static str { "counter" }
//!
//!     fn invoke(&self, ctx: &mut Context<'_>, function: &str, _args: &[Bytes]) -> Result<Bytes, Rejection> {
//!         let who = ctx.submitter()?.id();
//!         match function {
//!             "add" => {
//!                 let count = ctx.get(who.as_bytes()).map_or(0, |v| v.len());
//!                 ctx.put(who.as_bytes(), vec![b'|'; count + 1]);
//!                 Ok(Bytes::from((count + 1).to_string()))
//!             }
//!             _ => Err(Rejection::unknown_function("counter", function, &["add"])),
//!         }
//!     }
//! }
//! ```

pub mod block;
pub mod branch;
mod call_ref;
mod chain;
mod chaincode;
pub mod evidence;
mod execution;
mod facts;
mod foretold;
mod founding;
pub mod headers;
mod identities;
mod large;
pub mod members;
pub mod msp;
pub mod network;
mod page;
mod rules;
pub mod transaction;
mod verified;
#[cfg(feature = "verify")]
pub mod verify;
mod window;
pub mod writes;

pub use call_ref::CallRef;
pub use chain::{Admission, BlockHashes, Ground, Ledger, Outcome, Refusal, Step, TransactionRecord};
pub use chaincode::{
    ADMINS_PER_ORGANISATION_MAX, ApprovedBy, BLOCK_BUDGET, CALL_BUDGET, Call, Chaincode, Context, Environment,
    Foretold, Meter, NotAQuorum, QUERY_BUDGET, Quorum, Registry, Revocation, ServiceBudget, Usage,
};
pub use page::{PAGE_BYTES, PAGE_MAX, Page, Paging};
pub use rules::{Activation, Rules};
