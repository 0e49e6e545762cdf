//! Keys, certificates and identities: who somebody is, by which organisation's word.
//!
//! It knows X.509 and signatures, and no file, chain or chaincode. Time is an argument. A caller parses a
//! [certificate](certificate::Certificate), or lets the organisations of a network verify it ([`msp::Msps::verify`]); only
//! that makes an [`Identity`].
//!
//! | module | what is there |
//! |---|---|
//! | [`key`] | keys of the kinds Ed25519, P-256 and P-384: making, reading, signing, verifying |
//! | [`certificate`] | reading a certificate within limits, and its attributes |
//! | [`distinguished_name`] | names of X.509, compared as RFC 5280 says |
//! | [`msp`] | the organisations of a network, and the path from a certificate to one of their roots |
//! | [`revocation_list`] | reading a revocation list within limits |
//! | [`units`] | the units that name roles, where an organisation has words of its own |
//! | the root | [`Identity`], [`Role`], names, the form of attributes, and [`IdentityError`] |
//!
//! ```
//! use ledger_identity::key::{KeyKind, PublicKey, SigningKey};
//!
//! let key = SigningKey::generate(KeyKind::P256, &ring::rand::SystemRandom::new())?;
//! let public = PublicKey::from_spki(&key.public_key().to_spki())?;
//! let signature = key.sign(b"drive");
//! assert!(public.verify(b"drive", &signature).is_ok());
//! assert!(public.verify(b"stop", &signature).is_err());
//! # Ok::<(), ledger_identity::key::KeyError>(())
//! ```

mod attribute;
pub mod certificate;
mod der;
pub mod distinguished_name;
mod identity;
pub mod key;
pub mod msp;
mod name;
mod name_constraints;
pub mod revocation_list;
mod signature;
pub mod units;

pub use attribute::{ATTRIBUTE_FORM, NotAnAttribute, read_attribute, shown_attribute};
pub use identity::{Identity, IdentityError, NAME_BYTES_MAX, NEW_NAME_BYTES_MAX, Role, check_name, check_new_name};
pub use name::{check_readable, looks};
