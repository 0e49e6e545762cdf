//! Organisations with a CA of other software: what they come in with, what their CAs do later, and their people by name.

use crate::lists::{Story, add, serial};
use crate::world::{Ca, DAY, SECOND, User, code, is_executed, json, waiting};
use bytes::Bytes;
use ledger::msp::{KnownList, RecordedList, RevokedIdentity};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::KeyKind;
use serde_json::json;
use testkit::{List, extension};

/// An issuing distribution point with these contents.
fn point(content: &[u8]) -> Vec<u8> {
    let value = [&[0x30, u8::try_from(content.len()).unwrap()], content].concat();
    extension(&[0x55, 0x1d, 0x1c], true, &value)
}

impl Story {
    /// May this person act?
    fn is(&mut self, person: &User) -> Code {
        match code(&self.network.call(person, "withdraw", &["00000000"])) {
            Code::NotAdmin => Code::Ok,
            refused => refused,
        }
    }

    fn revoke(&mut self, name: &str) -> Result<Bytes, Rejection> {
        let argument = json!({"name": name, "reason": "laptop stolen"}).to_string();
        self.network.call(&self.admin, "revoke_identity", &[&argument])
    }
}

#[test]
fn a_ca_that_is_founded_again_under_its_name_revokes_and_counts_from_one() {
    let mut story = Story::new();
    let many = List { number: Some(100), ..story.list(&[vec![7]]) };
    story.record(&many).unwrap();
    let anew = Ca::with_key("fabric-ca", KeyKind::P256);
    let roots = [&story.ca, &anew].map(|ca| hex::encode(ca.root()));
    let update = json!({ "roots": roots }).to_string();
    story.network.call(&story.admin, "update_organisation", &[&update]).unwrap();
    let nadia = anew.user("Nadia", "client", KeyKind::P256);
    assert_eq!(story.is(&nadia), Code::Ok);
    story.network.time += SECOND;
    let first = List { number: Some(1), ..story.list(&[serial(&nadia)]) }.signed(&anew);
    let argument = json!({ "list": hex::encode(first) }).to_string();
    let recorded: RecordedList = json(story.network.call(&story.admin, "record_revocation_list", &[&argument]));
    assert_eq!((recorded.serials.len(), recorded.left_out.len(), recorded.restarted), (1, 0, false));
    assert_eq!(story.is(&nadia), Code::Revoked);
    let lists: Vec<KnownList> = story.network.query("revocation_lists", &[]);
    assert_eq!(lists.len(), 1, "the newest list of the name speaks for it");
    assert_eq!(lists[0].list.number.as_deref(), Some("01"));
}

#[test]
fn a_ca_that_has_lost_its_memory_still_revokes() {
    let mut story = Story::new();
    let many = List { number: Some(100), ..story.list(&[]) };
    story.record(&many).unwrap();
    let same_time = List { number: Some(2), ..many };
    assert_eq!(code(&story.record(&same_time)), Code::OldList, "of one moment, the numbers decide");
    story.network.time += SECOND;
    let later = List { number: Some(2), ..story.list(&[serial(&story.salma)]) };
    assert!(json::<RecordedList>(story.record(&later)).restarted);
    let salma = std::mem::replace(&mut story.salma, story.ca.user("Other", "client", KeyKind::P256));
    assert_eq!(story.is(&salma), Code::Revoked);
}

#[test]
fn the_distribution_point_of_a_list_says_which_list_it_follows_and_whether_its_age_counts() {
    let mut story = Story::new();
    story.network.call(&story.admin, "set_stale_lists", &[r#"{"stale":"refuse"}"#]).unwrap();
    let whole = story.list(&[]);
    story.record(&whole).unwrap();
    let salma = serial(&story.salma);
    let place = point(&[0xa0, 0x09, 0xa0, 0x07, 0x86, 0x05, b'h', b't', b't', b'p', b':']);
    // Of CAs alone, or for some reasons: it revokes what it names, and says nothing about the age of the others.
    for content in [&[0x82, 0x01, 0xff][..], &[0x83, 0x02, 0x06, 0x40]] {
        story.network.time += SECOND;
        let part = List { next_update: None, extensions: vec![point(content)], ..story.list(&[vec![9]]) };
        let recorded: RecordedList = json(story.record(&part));
        assert!(recorded.list.partial && recorded.left_out.is_empty(), "{recorded:?}");
    }
    story.network.time += 8 * DAY;
    assert_eq!(story.salma_is(), Code::ListStale);
    for (extensions, revoked, wanted) in
        [(vec![point(&[0x81, 0x01, 0xff])], vec![], Code::Ok), (vec![place], vec![salma], Code::Revoked)]
    {
        story.network.time += SECOND;
        let list = List { extensions, ..story.list(&revoked) };
        assert!(!json::<RecordedList>(story.record(&list)).list.partial);
        assert_eq!(story.salma_is(), wanted);
    }
    for content in [&[0x84, 0x01, 0xff][..], &[0x85, 0x01, 0xff], &[0x81, 0x01, 0xff, 0x82, 0x01, 0xff], &[0x87, 0x00]]
    {
        let odd = List { extensions: vec![point(content)], ..story.list(&[]) };
        let refused = story.record(&odd).unwrap_err();
        assert!(
            refused.code == Code::CertificateMalformed && refused.found.contains("distribution point"),
            "{refused}"
        );
    }
    for number in 0..12_u8 {
        story.network.time += SECOND;
        let moved = point(&[0xa0, 0x05, 0xa0, 0x03, 0x86, 0x01, number]);
        story.record(&List { extensions: vec![moved], ..story.list(&[]) }).unwrap();
    }
    let lists: Vec<KnownList> = story.network.query("revocation_lists", &[]);
    assert_eq!(lists.iter().filter(|known| !known.list.partial).count(), 1, "{lists:?}");
}

#[test]
fn an_admin_revokes_a_person_by_name_at_once_whether_the_ledger_has_seen_the_certificate_or_not() {
    let mut story = Story::new();
    let unseen = story.ca.user("Salma", "client", KeyKind::P384);
    assert_eq!(story.salma_is(), Code::Ok);
    let argument = r#"{"name":"Salma"}"#;
    assert_eq!(code(&story.network.call(&story.salma, "revoke_identity", &[argument])), Code::NotAdmin);
    assert_eq!(code(&story.network.admin(1, "revoke_identity", &[argument])), Code::NotFound, "another organisation's");
    let revoked: RevokedIdentity = json(story.revoke("Salma"));
    let serials: Vec<_> = revoked.certificates.iter().map(|issued| issued.serial.clone()).collect();
    assert_eq!(serials, [hex::encode(serial(&story.salma))], "the one that the ledger has seen");
    assert_eq!(story.network.event_names(), ["revoked", "name_barred"]);
    assert_eq!((story.salma_is(), story.is(&unseen)), (Code::Revoked, Code::Revoked));
    assert!(story.network.open_again().is_ok());
    // A list that names neither changes nothing.
    story.network.time += SECOND;
    let list = story.list(&[]);
    story.record(&list).unwrap();
    assert_eq!((story.salma_is(), story.is(&unseen)), (Code::Revoked, Code::Revoked));
    // What the CA issues afterwards counts.
    story.network.time += 2 * DAY;
    let renewed = story.ca.user_as(["Salma", "client"], KeyKind::P256, |params| {
        params.not_before = rcgen::date_time_ymd(2030, 1, 2);
    });
    assert_eq!(story.is(&renewed), Code::Ok);
    assert_eq!(code(&story.revoke("Boss")), Code::LastOne);
    let nobody: RevokedIdentity = json(story.revoke("Slma"));
    assert!(nobody.certificates.is_empty() && nobody.barred.is_some());
}

#[test]
fn a_list_that_ends_while_a_proposal_waits_voids_nothing_and_counts_as_ended() {
    let mut story = Story::new();
    let ca = Ca::with_key("late-ca", KeyKind::P256);
    let nadia = ca.user("Nadia", "client", KeyKind::P256);
    let ended =
        List { this_update: story.now() - 60, next_update: Some(story.now() - 30), ..List::default() }.signed(&ca);
    let refused = story.network.admin(1, "add_organisation", &[&add("Org4", &ca, &[], &[ended])]);
    assert_eq!(code(&refused), Code::OldList, "what is proposed comes with lists of today");
    let day = List { next_update: Some(story.now() + 86_400), ..story.list(&[serial(&nadia)]) }.signed(&ca);
    let add = add("Org4", &ca, &[], &[day]);
    waiting(story.network.admin(1, "add_organisation", &[&add]));
    story.network.time += 2 * DAY;
    assert!(is_executed(story.network.admin(2, "add_organisation", &[&add])), "typed again with the same directory");
    assert_eq!(story.is(&nadia), Code::Revoked);
    let lists: Vec<KnownList> = story.network.query("revocation_lists", &[]);
    assert!(lists[0].list.next_update.unwrap() < story.network.time, "and everybody sees that it has ended");
}

#[test]
fn an_authority_by_which_nobody_could_sign_in_comes_in_by_no_door() {
    let mut story = Story::new();
    let (root, foreign) = (Ca::above("root", 0), Ca::new("foreign"));
    let middle = root.below("middle");
    for below in [&middle, &foreign.below("elsewhere")] {
        let refused = story.network.admin(1, "add_organisation", &[&add("Org4", &root, &[below], &[])]);
        assert_eq!(code(&refused), Code::Untrusted, "an intermediate that leads nowhere");
    }
    let update = json!({ "roots": [hex::encode(story.ca.root())], "intermediates": [hex::encode(middle.root())] });
    assert_eq!(code(&story.network.call(&story.admin, "update_organisation", &[&update.to_string()])), Code::Untrusted);
    // The other certificates end at the same time. Block time never goes back, so this comes last.
    let ended = Ca::new("old-ca");
    let (boss, add) = (
        story.network.cas[0].user_as(["Late", "admin"], KeyKind::P256, |params| {
            params.not_after = rcgen::date_time_ymd(2032, 1, 1);
        }),
        add("Org4", &ended, &[], &[]),
    );
    story.network.time += 400 * DAY;
    assert_eq!(code(&story.network.call(&boss, "add_organisation", &[&add])), Code::CertificateExpired);
}
