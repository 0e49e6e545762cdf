//! The certified part of another branch: headers, and a certificate of the last one.
//!
//! Two chains of one network have the same blocks up to some height. A node asks others for this part when they have another
//! block than it has, and keeps it while it is contradicted. It proves nothing about who has signed: the reader checks the
//! certificate by the voters that it knows ([`Governance::check_strict`](ledger_light::Governance::check_strict)).

use crate::block::Header;
use crate::headers::{HEADERS_BYTES_MAX, HEADERS_MAX, read_headers, write_headers};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::Certificate;
use ledger_light::certificate::CERTIFICATE_BYTES_MAX;
use ledger_light::codec::{Reader, put};

const DOMAIN: &[u8] = b"ledgerd branch v1\0";
/// Longest encoding.
pub const BRANCH_BYTES_MAX: usize = DOMAIN.len() + HEADERS_BYTES_MAX + 4 + CERTIFICATE_BYTES_MAX;

/// Headers of a branch up to a certified block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CertifiedBranch {
    /// Each follows the one before; the last one is that of the certified block. Empty where they are not needed, because the
    /// reader has a block at the height of the certificate itself.
    headers: Vec<Header>,
    certificate: Certificate,
}

impl CertifiedBranch {
    /// The certificate of a block, without headers.
    pub fn of(certificate: Certificate) -> Self {
        Self { headers: Vec::new(), certificate }
    }

    /// Headers up to the certified block.
    ///
    /// # Errors
    /// [`Code::Malformed`] if they are none, too many, or do not lead to the certified block.
    pub fn new(headers: Vec<Header>, certificate: Certificate) -> Result<Self, Rejection> {
        let statement = &certificate.statement;
        let follows = |(one, next): (&Header, &Header)| {
            next.previous == one.hash() && next.height == one.height.saturating_add(1)
        };
        let is_chain = headers.iter().zip(headers.iter().skip(1)).all(follows);
        let leads = headers.last().is_some_and(|last| {
            (last.height, last.time, last.hash()) == (statement.height, statement.time, statement.block)
        });
        if is_chain && leads && headers.len() <= HEADERS_MAX {
            return Ok(Self { headers, certificate });
        }
        Err(Rejection::new(Code::Malformed, "headers do not lead to the certified block")
            .found(format!("{} headers, and a certificate of block {}", headers.len(), statement.height))
            .wanted(format!("1 to {HEADERS_MAX} headers, each of which follows the one before, up to that block")))
    }

    /// The lowest height of which it names the block.
    pub fn height(&self) -> u64 {
        self.headers.first().map_or(self.certificate.statement.height, |first| first.height)
    }

    /// The block of the branch at [`CertifiedBranch::height`].
    pub fn block(&self) -> Hash {
        self.headers.first().map_or(self.certificate.statement.block, Header::hash)
    }

    /// The certificate of its last block.
    pub fn certificate(&self) -> &Certificate {
        &self.certificate
    }

    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = DOMAIN.to_vec();
        write_headers(&mut bytes, &self.headers);
        put(&mut bytes, &self.certificate.to_bytes());
        bytes.into()
    }

    /// Reads its bytes. No signature is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("the certified part of a branch", BRANCH_BYTES_MAX, DOMAIN, bytes)?;
        let headers = read_headers(&mut reader)?;
        let certificate = Certificate::from_bytes(reader.part(CERTIFICATE_BYTES_MAX)?)?;
        reader.end()?;
        if headers.is_empty() { Ok(Self::of(certificate)) } else { Self::new(headers, certificate) }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use ledger_light::Statement;

    fn header(height: u64, previous: Hash) -> Header {
        Header { height, term: 3, time: 100 + height, previous, root: Hash([height as u8; 32]) }
    }

    fn certificate(last: &Header) -> Certificate {
        let (height, time, block) = (last.height, last.time, last.hash());
        let statement = Statement { network: Hash::ZERO, recoveries: 0, height, time, block, results: Hash::ZERO };
        Certificate { statement, signatures: Vec::new() }
    }

    #[test]
    fn headers_that_do_not_lead_to_the_certified_block_are_refused() {
        let first = header(7, Hash([1; 32]));
        let last = header(8, first.hash());
        let (headers, certificate) = (vec![first.clone(), last.clone()], certificate(&last));
        let branch = CertifiedBranch::new(headers.clone(), certificate.clone()).unwrap();
        assert_eq!((branch.height(), branch.block()), (7, first.hash()));
        assert_eq!(CertifiedBranch::from_bytes(&branch.to_bytes()), Ok(branch.clone()));
        let alone = CertifiedBranch::of(certificate.clone());
        assert_eq!((alone.height(), alone.block()), (8, last.hash()));
        assert_eq!(CertifiedBranch::from_bytes(&alone.to_bytes()), Ok(alone));

        let mut torn = headers.clone();
        torn[1].previous = Hash::ZERO;
        for wrong in [torn, vec![first], headers.into_iter().rev().collect(), Vec::new()] {
            assert_eq!(CertifiedBranch::new(wrong, certificate.clone()).unwrap_err().code, Code::Malformed);
        }
        let mut bytes = branch.to_bytes().to_vec();
        bytes[DOMAIN.len() + 8] ^= 1;
        assert_eq!(CertifiedBranch::from_bytes(&bytes).unwrap_err().code, Code::Malformed);
        let mut bytes = CertifiedBranch::of(certificate).to_bytes().to_vec();
        bytes[DOMAIN.len() + 8] ^= 1;
        assert_eq!(CertifiedBranch::from_bytes(&bytes).unwrap_err().code, Code::Malformed);
    }
}
