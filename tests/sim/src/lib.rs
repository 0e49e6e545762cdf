//! A whole cluster of `ledgerd` in one thread, in virtual time: the real ledger, access control and ordering engine.
//! Its disks, clocks and network fail in every way that we could think of.
//!
//! One number, the seed, decides everything: how many nodes there are, what the clients want, what goes wrong and when.
//! So a run that breaks a promise can be repeated, byte for byte:
//!
//! ```text
//! cargo run --release --bin simulate -- --seed 4711 --trace
//! ```
//!
//! After a storm everything heals; then the cluster must converge and serve. The invariants are in [`invariant`], one
//! file each. In the end [`oracle`] replays the chain through a small model of access control, written apart from the
//! product, and looks at every client's view in real time.
//!
//! The real parts are `ledger_replica::Replica` with every decision of a node around the engine,
//! `ledger_storage::block_store::BlockStore`, and `ledger::Ledger` with the chaincodes `msp` and `abac`. The simulated
//! parts are disks ([`ledger_storage::disk::SimDisk`]), network, clocks, clients, and the threads that drive the
//! replica (`world`; compare `src/ordering/orderer/order.rs`). It is no test of sockets, TLS, gRPC, threads or sled;
//! tests/cluster does those with real processes.
//!
//! | module | what is there |
//! |---|---|
//! | [`plan`], [`coverage`] | what a seed decides; what was really done |
//! | [`world`] | the event queue, and what happens: starts, threads, gateways, chaos, the operator |
//! | [`node`], [`links`], [`clock`] | machines, network, time |
//! | [`client`], [`people`], [`policy`], [`lists`] | who wants what, who they are, and whom their CAs revoke |
//! | [`confidential`] | the service whose messages only its readers read |
//! | [`robot`] | a robot with the real gate, whose node may lie |
//! | [`invariant`], [`oracle`], [`history`] | what must hold; the judge; what clients saw |
//! | [`run`], [`trace`], [`seeds`] | one seed from beginning to end; many of them |
//! | [`twins`] | a smaller network in which organisations lie with all their nodes, also as leaders |

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "a simulation that cannot go on has found something, or is wrong itself"
)]

pub mod client;
pub mod clock;
pub mod confidential;
pub mod coverage;
pub mod history;
pub mod invariant;
pub mod links;
pub mod lists;
pub mod node;
pub mod oracle;
pub mod people;
pub mod plan;
pub mod policy;
pub mod robot;
pub mod run;
pub mod seeds;
pub mod trace;
pub mod twins;
mod withholding;
pub mod world;
