//! The proof of a lie: two different statements of one node about one height.

use crate::codec::{Reader, put};
use crate::statement::{SIGNED_BYTES_MAX, Signed};
use bytes::Bytes;
use ledger_identity::{Identity, Role};
use ledger_rejection::{Code, Rejection};

const DOMAIN: &[u8] = b"ledgerd lie v1\0";
/// Longest encoding.
pub const LIE_BYTES_MAX: usize = DOMAIN.len() + 2 * (4 + SIGNED_BYTES_MAX);

/// Two statements of one node that cannot both be honest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lie {
    /// The one that came first.
    pub first: Signed,
    /// The other one.
    pub second: Signed,
}

impl Lie {
    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = DOMAIN.to_vec();
        put(&mut bytes, &self.first.to_bytes());
        put(&mut bytes, &self.second.to_bytes());
        bytes.into()
    }

    /// Reads its bytes. No signature is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("the proof of a lie", LIE_BYTES_MAX, DOMAIN, bytes)?;
        let first = Signed::from_bytes(reader.part(SIGNED_BYTES_MAX)?)?;
        let second = Signed::from_bytes(reader.part(SIGNED_BYTES_MAX)?)?;
        reader.end()?;
        Ok(Self { first, second })
    }

    /// Does it prove that one node has lied? Both statements are about one height of one network, differ, and both
    /// signatures are by a node of the same organisation and name. Its number is not signed: the record of that node in
    /// the governing state tells. `identify` as for [`Certificate::verify`](crate::Certificate::verify).
    ///
    /// # Errors
    /// [`Code::Malformed`] if it proves nothing, [`Code::Untrusted`] if the signer is no node, [`Code::BadSignature`], or
    /// what `identify` says.
    pub fn verify(
        &self,
        mut identify: impl FnMut(&[u8], u64) -> Result<Identity, Rejection>,
    ) -> Result<Identity, Rejection> {
        let (one, other) = (&self.first.statement, &self.second.statement);
        let nothing = || {
            Rejection::new(Code::Malformed, "two statements prove no lie")
                .found(format!("heights {} and {}", one.height, other.height))
                .wanted("two different statements of one node about one height of one network")
        };
        if one == other || one.height != other.height || one.network != other.network {
            return Err(nothing());
        }
        let mut signer = |signed: &Signed| {
            let identity = identify(&signed.signature.certificate, signed.statement.time)?;
            if identity.role != Role::Node {
                return Err(Rejection::new(Code::Untrusted, "a statement is signed by somebody who is no node")
                    .found(format!("{} with role {}", identity.id(), identity.role))
                    .wanted("the certificate of a node"));
            }
            let verified = identity.public_key.verify(&signed.statement.to_bytes(), &signed.signature.signature);
            verified.map_err(|error| Rejection::told(Code::BadSignature, &error.to_string())).map(|()| identity)
        };
        let (first, second) = (signer(&self.first)?, signer(&self.second)?);
        if first.id() != second.id() || self.first.signature.node != self.second.signature.node {
            return Err(nothing());
        }
        Ok(first)
    }
}
