//! The certificates in events: whose they are, and which of them end.

use bytes::Bytes;
use ledger::msp::{IssuedCertificate, RecordedList, RevocationRecord};
use ledger_base::hash::Hash;
use ledger_storage::audit::{Holder, Row};
use ledger_storage::result::Event;

/// The certificate with this issuer (SHA-256 of its distinguished name) and serial number, as rows name it.
pub(super) fn named(issuer: &Hash, serial: &[u8]) -> Bytes {
    [&issuer.0[..], serial].concat().into()
}

/// The holder of the certificate that a CA has issued.
pub(super) fn certified(event: &Event) -> Option<Holder> {
    let issued: IssuedCertificate = serde_json::from_slice(&event.payload).ok()?;
    let certificate = named(&issued.issuer, &hex::decode(&issued.serial).ok()?);
    Some(Holder { certificate, name: event.subject.clone() })
}

/// The certificate that was revoked.
pub(super) fn revoked(event: &Event) -> Option<Bytes> {
    let record: RevocationRecord = serde_json::from_slice(&event.payload).ok()?;
    Some(named(&record.issuer, &hex::decode(&record.serial).ok()?))
}

/// A row for each certificate that a list revokes and that was not revoked before, like the row of the list.
pub(super) fn listed(event: &Event, list: &Row) -> Vec<Row> {
    let Ok(recorded) = serde_json::from_slice::<RecordedList>(&event.payload) else { return Vec::new() };
    let row = |serial: String| {
        let certificate = named(&recorded.list.issuer, &hex::decode(&serial).ok()?);
        Some(Row {
            decision: "revoked".into(),
            who: String::new(),
            by: list.who.clone(),
            subject: serial,
            detail: format!("in a revocation list of {}", recorded.list.subject),
            certificate,
            ..list.clone()
        })
    };
    recorded.serials.into_iter().filter_map(row).collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_list_has_a_row_for_each_certificate_that_it_revokes() {
        let payload = serde_json::json!({
            "organisation": "Org3", "issuer": Hash([7; 32]), "key_fingerprint": Hash([6; 32]), "subject": "ica.org3", "this_update": 1, "listed": 3,
            "fingerprint": Hash([8; 32]), "height": 9, "time": 10, "by": "Org3/Chief", "serials": ["0a01", "0b"],
        });
        let event = Event {
            chaincode: "msp".into(),
            name: "revocation_list".into(),
            subject: "ica.org3".into(),
            payload: serde_json::to_vec(&payload).unwrap().into(),
        };
        let list = Row { decision: "revocation_list".into(), who: "Org3/Chief".into(), ..Row::default() };
        let rows = listed(&event, &list);
        let told: Vec<_> = rows.iter().map(|row| (row.decision.as_str(), row.who.as_str(), row.by.as_str())).collect();
        assert_eq!(told, [("revoked", "", "Org3/Chief"); 2]);
        let subjects: Vec<_> = rows.iter().map(|row| row.subject.as_str()).collect();
        assert_eq!(subjects, ["0a01", "0b"]);
        let certificates: Vec<_> = rows.iter().map(|row| row.certificate.clone()).collect();
        assert_eq!(certificates, [named(&Hash([7; 32]), &[10, 1]), named(&Hash([7; 32]), &[11])]);
    }
}
