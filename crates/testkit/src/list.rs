//! Revocation lists, with whatever a CA could write into them.
#![expect(clippy::unwrap_used, reason = "a test that cannot make a list has failed")]

use crate::authority::Ca;
use bytes::Bytes;
use ledger_identity::certificate::Certificate;
use ledger_identity::key::{KeyKind, SigningKey};

/// The content of a revocation list.
#[derive(Clone, Debug, Default)]
pub struct List {
    /// When it was made, seconds since the UNIX epoch.
    pub this_update: u64,
    /// When the next one comes.
    pub next_update: Option<u64>,
    /// Its number.
    pub number: Option<u8>,
    /// The serial numbers of revoked certificates: contents of DER INTEGERs.
    pub serials: Vec<Vec<u8>>,
    /// More extensions in DER.
    pub extensions: Vec<Vec<u8>>,
}

impl List {
    /// The list as this CA signs it, in DER.
    pub fn signed(&self, ca: &Ca) -> Bytes {
        let issuer = Certificate::parse(&ca.root()).unwrap().subject_name;
        self.signed_as(issuer.der(), &ca.key())
    }

    /// The list with the issuer's name and the key of somebody, in DER.
    pub fn signed_as(&self, issuer: &[u8], key: &SigningKey) -> Bytes {
        let algorithm: &[u8] = match key.kind() {
            KeyKind::Ed25519 => &[0x06, 0x03, 0x2b, 0x65, 0x70],
            KeyKind::P256 => &[0x06, 0x08, 0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x02],
            KeyKind::P384 => &[0x06, 0x08, 0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x03],
        };
        let algorithm = tagged(0x30, algorithm);
        let mut parts =
            vec![tagged(0x02, &[1]), algorithm.clone(), issuer.to_vec(), generalized_time(self.this_update)];
        parts.extend(self.next_update.map(generalized_time));
        let entry =
            |serial: &Vec<u8>| tagged(0x30, &[tagged(0x02, serial), generalized_time(self.this_update)].concat());
        if !self.serials.is_empty() {
            parts.push(tagged(0x30, &self.serials.iter().flat_map(entry).collect::<Vec<_>>()));
        }
        let number = self.number.map(|number| extension(&[0x55, 0x1d, 0x14], false, &tagged(0x02, &[number])));
        let extensions: Vec<u8> = number.into_iter().chain(self.extensions.iter().cloned()).flatten().collect();
        if !extensions.is_empty() {
            parts.push(tagged(0xa0, &tagged(0x30, &extensions)));
        }
        let signed = tagged(0x30, &parts.concat());
        let signature = [&[0], &key.sign(&signed)[..]].concat();
        tagged(0x30, &[signed, algorithm, tagged(0x03, &signature)].concat()).into()
    }
}

/// An extension in DER: the content of its object identifier, and its value.
pub fn extension(oid: &[u8], critical: bool, value: &[u8]) -> Vec<u8> {
    let critical = if critical { tagged(0x01, &[0xff]) } else { Vec::new() };
    tagged(0x30, &[tagged(0x06, oid), critical, tagged(0x04, value)].concat())
}

fn tagged(tag: u8, content: &[u8]) -> Vec<u8> {
    let length = u32::try_from(content.len()).unwrap().to_be_bytes();
    let head = match length {
        [0, 0, 0, short] if short < 0x80 => vec![tag, short],
        [0, 0, 0, one] => vec![tag, 0x81, one],
        [0, 0, high, low] => vec![tag, 0x82, high, low],
        [_, top, high, low] => vec![tag, 0x83, top, high, low],
    };
    [&head, content].concat()
}

/// A GeneralizedTime of seconds since the UNIX epoch.
fn generalized_time(seconds: u64) -> Vec<u8> {
    let at = time::OffsetDateTime::from_unix_timestamp(i64::try_from(seconds).unwrap()).unwrap();
    let ((year, month, day), (hour, minute, second)) = (at.to_calendar_date(), at.to_hms());
    let month = u8::from(month);
    tagged(0x18, format!("{year:04}{month:02}{day:02}{hour:02}{minute:02}{second:02}Z").as_bytes())
}
