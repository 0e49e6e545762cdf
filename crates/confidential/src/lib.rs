//! Messages of confidential services: encrypted by their publisher, read by those whom the service's policies permit.
//!
//! A publisher makes a [`ContentKey`] for the readers of the moment. It wraps the key for each of their [`ReadingKey`]s with HPKE
//! (RFC 9180: X25519, HKDF-SHA256, ChaCha20-Poly1305) and shares that in a transaction. Its messages are then
//! [`Envelope`](ledger_contract::Envelope)s: ChaCha20-Poly1305 under the content key. A reader keeps what was shared in a
//! [`Keyring`]. The ledger decides who the readers are, and when a content key has to be replaced: see `crates/abac`.
//!
//! Nothing here does IO. docs/format.md has the bytes.
//!
//! ```
//! use ledger_confidential::{Keyring, ReadingKey, Sealer};
//! use ledger_contract::{Reader, Readers};
//! use ledger_base::hash::Hash;
//!
//! let (network, service, publisher) = (Hash::ZERO, "Turtlebot4/cmd_vel", "Org1/Salma");
//! let own = ReadingKey::generate();
//! let reader = Reader { reader: "Org2/Turtlebot4".into(), key: own.public_hex(), serial: String::new(), may_read: true };
//! let readers = Readers { service: service.into(), readers: vec![reader], keys: vec![] };
//!
//! let (share, fresh) = Sealer::share(&network, publisher, &readers)?;
//! let sealer: Sealer = fresh.shared_at(7); // the height at which the transaction with `share` was committed
//! let sealed = sealer.seal(3, 1000, b"\0\x01\0\0forward")?;
//!
//! let mut keyring = Keyring::new(network, "Org2/Turtlebot4".into(), own);
//! keyring.learn(service, publisher, 7, &share);
//! assert_eq!(keyring.open(service, publisher, 3, 1000, &sealed).unwrap(), &b"\0\x01\0\0forward"[..]);
//! # Ok::<(), ledger_base::rejection::Rejection>(())
//! ```

mod content;
mod keyring;
mod reading;
mod repeatable;
mod sealer;

pub use content::{ContentKey, Place};
pub use hpke::rand_core;
pub use keyring::{Keyring, Unreadable};
pub use reading::{ReadingKey, Wrap};
pub use sealer::{Fresh, Sealer};

/// Appends parts with their lengths in front, so that none can be taken for another.
fn parts(into: &mut Vec<u8>, parts: &[&[u8]]) {
    for part in parts {
        into.extend_from_slice(&(part.len() as u64).to_be_bytes());
        into.extend_from_slice(part);
    }
}
