//! Test certificates, repeatable randomness and other software, for the tests of all crates. No product is built from it.
//!
//! | module | what is there |
//! |---|---|
//! | [`own_network`] | a network namespace for a test |
//! | [`peer`], [`python`], [`rclpy`] | processes with the DDS of others |
//!
//! ```
//! use ledger_identity::key::KeyKind;
//! use testkit::{Ca, Random};
//!
//! let salma = Ca::new("org1-ca").user("Salma", "member", KeyKind::Ed25519);
//! assert!(!salma.certificate.is_empty());
//! assert_eq!(Random::new(7, "network").number(), Random::new(7, "network").number());
//! ```

#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test whose surroundings are not there has failed; it prints what it found"
)]

mod authority;
mod list;
pub mod own_network;
pub mod peer;
mod program;
pub mod python;
mod random;
pub mod rclpy;

pub use authority::{Ca, User, key};
pub use list::{List, extension};
pub use program::{profile, program, scratch};
pub use random::Random;
pub use rcgen;
