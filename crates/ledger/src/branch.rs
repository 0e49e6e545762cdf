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
use ledger_storage::entry::Entry;
use ledger_storage::state::Tip;

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
        Err(Rejection::new(Code::Malformed, "the headers do not lead to the certified block")
            .found(format!("{} headers, and a certificate of block {}", headers.len(), statement.height))
            .wanted(format!("1 to {HEADERS_MAX} headers, each following the one before, up to that block")))
    }

    /// The lowest height of which it names the block.
    pub fn height(&self) -> u64 {
        self.headers.first().map_or(self.certificate.statement.height, |first| first.height)
    }

    /// The block of the branch at [`CertifiedBranch::height`].
    pub fn block(&self) -> Hash {
        self.headers.first().map_or(self.certificate.statement.block, Header::hash)
    }

    /// Its headers, in order; none where the reader has a block at the height of the certificate.
    pub fn headers(&self) -> &[Header] {
        &self.headers
    }

    /// The part of it from one of its headers on.
    fn beginning_at(&self, at: usize) -> Self {
        let headers = self.headers.get(at..).unwrap_or_default().to_vec();
        Self { headers, certificate: self.certificate.clone() }
    }

    /// Compares it with the log of a reader that has executed the block before its first one. Answers with the part from the first
    /// block on that the log has otherwise, and with the block that this entry would be. `log` is the entry at a height.
    ///
    /// Two chains contradict each other where both have an entry of one height and one term. The leader of a term has one log up to
    /// each of its entries (Raft §5.3, log matching). Otherwise a leader of a later term replaces the entries.
    pub fn against_log(&self, tip: &Tip, log: impl Fn(u64) -> Option<Entry>) -> Option<(Self, Hash)> {
        let (mut height, mut previous, mut time) = (tip.height, tip.hash, tip.time);
        let mut first = None;
        for (at, header) in self.headers.iter().enumerate() {
            height = height.saturating_add(1);
            if header.height != height || at == 0 && header.previous != previous {
                return None;
            }
            let own = Header::following(previous, time, &log(height)?);
            if own != *header {
                let (at, block) = *first.get_or_insert_with(|| (at, own.hash()));
                if own.term == header.term {
                    return Some((self.beginning_at(at), block));
                }
            }
            (previous, time) = (own.hash(), own.time);
        }
        None
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

    #[test]
    fn a_branch_contradicts_the_log_of_a_reader_where_one_term_has_another_entry_and_nowhere_else() {
        let entry = |height, term, data: u8| Entry {
            index: height,
            term,
            kind: ledger_storage::entry::EntryKind::Normal,
            data: Bytes::from(vec![data; 3]),
        };
        let tip = Tip { height: 6, term: 2, time: 100, hash: Hash([1; 32]), digest: Hash::ZERO };
        let first = Header::following(tip.hash, tip.time, &entry(7, 3, 1));
        let second = Header::following(first.hash(), first.time, &entry(8, 3, 2));
        let certificate = certificate(&second);
        let branch = CertifiedBranch::new(vec![first.clone(), second.clone()], certificate.clone()).unwrap();
        let against = |log: [(u64, u8); 2]| {
            let log = move |height: u64| log.get(height as usize - 7).map(|(term, data)| entry(height, *term, *data));
            branch.against_log(&tip, log)
        };
        assert_eq!(against([(3, 1), (3, 2)]), None, "the same blocks");
        let (rest, own) = against([(3, 1), (3, 9)]).unwrap();
        assert_eq!((rest.height(), rest.block()), (8, second.hash()));
        assert_eq!(own, Header::following(first.hash(), first.time, &entry(8, 3, 9)).hash());
        assert_eq!(against([(3, 9), (3, 2)]).unwrap().0, branch, "from the first one on");
        assert_eq!(against([(2, 9), (2, 2)]), None, "entries of another term are replaced");
        assert_eq!(against([(2, 9), (3, 2)]).unwrap().0, branch, "one term has one log up to each of its entries");
        assert_eq!(branch.against_log(&tip, |_| None), None, "a shorter log");
        let elsewhere = Tip { hash: Hash([2; 32]), ..tip };
        assert_eq!(branch.against_log(&elsewhere, |height| Some(entry(height, 3, 9))), None, "another block before");
        assert_eq!(CertifiedBranch::of(certificate).against_log(&tip, |height| Some(entry(height, 3, 9))), None);
    }
}
