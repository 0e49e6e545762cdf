//! Test certificates and repeatable randomness, for the tests of all crates. No product is built from it.
//!
//! ```
//! use ledger_identity::key::KeyKind;
//! use testkit::{Ca, Random};
//!
//! let salma = Ca::new("org1-ca").user("Salma", "member", KeyKind::Ed25519);
//! assert!(!salma.certificate.is_empty());
//! assert_eq!(Random::new(7, "network").number(), Random::new(7, "network").number());
//! ```

mod authority;
mod list;
mod random;

pub use authority::{Ca, User, key};
pub use list::{List, extension};
pub use random::Random;
pub use rcgen;
