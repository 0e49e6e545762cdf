//! Revocation lists of other CAs, and the organisations that have such a CA.

use crate::world::{Ca, DAY, Network, SECOND, User, code, is_executed, json, waiting};
use bytes::Bytes;
use ledger::Page;
use ledger::msp::{KnownList, ListRecord, Organisation, RecordedList, RevocationRecord, Stale};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::key::KeyKind;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use testkit::{List, Random, extension};

/// The words of Fabric.
fn fabric() -> Value {
    json!([
        {"unit": "client", "role": "member"}, {"unit": "admin", "role": "admin"},
        {"unit": "peer", "role": "node"}, {"unit": "orderer", "role": "node"}
    ])
}

pub(crate) fn serial(user: &User) -> Vec<u8> {
    Certificate::parse(&user.certificate).unwrap().serial
}

/// A network of two, and an organisation whose CA is another software.
pub(crate) struct Story {
    pub(crate) network: Network,
    pub(crate) ca: Ca,
    pub(crate) admin: User,
    pub(crate) salma: User,
}

impl Story {
    pub(crate) fn new() -> Self {
        let ca = Ca::with_key("fabric-ca", KeyKind::P256);
        let (admin, salma) = (ca.user("Boss", "admin", KeyKind::P384), ca.user("Salma", "client", KeyKind::P256));
        let mut network = Network::new(2, 2);
        let add = add("Org3", &ca, &[], &[]);
        waiting(network.admin(1, "add_organisation", &[&add]));
        assert!(is_executed(network.admin(2, "add_organisation", &[&add])));
        Self { network, ca, admin, salma }
    }

    pub(crate) fn now(&self) -> u64 {
        self.network.time / SECOND
    }

    /// A list of today.
    pub(crate) fn list(&self, serials: &[Vec<u8>]) -> List {
        List {
            this_update: self.now(),
            next_update: Some(self.now() + 7 * 86_400),
            serials: serials.to_vec(),
            ..List::default()
        }
    }

    pub(crate) fn record(&mut self, list: &List) -> Result<Bytes, Rejection> {
        let der = list.signed(&self.ca);
        self.record_bytes(&der)
    }

    fn record_bytes(&mut self, list: &[u8]) -> Result<Bytes, Rejection> {
        let argument = json!({ "list": hex::encode(list) }).to_string();
        self.network.call(&self.admin, "record_revocation_list", &[&argument])
    }

    /// May Salma act?
    pub(crate) fn salma_is(&mut self) -> Code {
        let answer = self.network.call(&self.salma, "withdraw", &["00000000"]);
        match code(&answer) {
            Code::NotAdmin => Code::Ok,
            refused => refused,
        }
    }
}

pub(crate) fn add(name: &str, ca: &Ca, intermediates: &[&Ca], lists: &[Bytes]) -> String {
    let intermediates: Vec<_> = intermediates.iter().map(|ca| hex::encode(ca.root())).collect();
    let lists: Vec<_> = lists.iter().map(hex::encode).collect();
    json!({
        "name": name, "roots": [hex::encode(ca.root())], "intermediates": intermediates, "units": fabric(), "lists": lists
    })
    .to_string()
}

#[test]
fn an_organisation_with_another_ca_comes_in_by_approval_and_its_people_have_the_roles_of_its_words() {
    let mut story = Story::new();
    assert_eq!(story.salma_is(), Code::Ok);
    let shown: Organisation = story.network.query("organisation", &["Org3"]);
    assert_eq!(shown.units.unwrap().iter().count(), 4);
    // Ours do not have these words, and theirs not ours.
    let ours = story.network.cas[0].user("Peter", "client", KeyKind::Ed25519);
    assert_eq!(code(&story.network.call(&ours, "withdraw", &["00000000"])), Code::NotAdmin);
    let theirs = story.ca.user("Eve", "member", KeyKind::P256);
    assert_eq!(code(&story.network.call(&theirs, "withdraw", &["00000000"])), Code::CertificateMalformed);
    let again = add("Org3", &Ca::new("other"), &[], &[]);
    assert_eq!(code(&story.network.admin(1, "add_organisation", &[&again])), Code::AlreadyExists);
    for (name, ca) in [("0rg3", &Ca::new("other")), ("Org4", &story.ca)] {
        assert_ne!(code(&story.network.admin(1, "add_organisation", &[&add(name, ca, &[], &[])])), Code::Ok, "{name}");
    }
}

#[test]
fn an_organisation_comes_in_with_the_lists_of_its_authorities() {
    let mut story = Story::new();
    let (root, below) = (Ca::above("root", 1), Ca::with_key("unused", KeyKind::P256));
    let middle = root.below("middle");
    let nadia = middle.user("Nadia", "client", KeyKind::P256);
    let by_middle = List { serials: vec![serial(&nadia)], ..story.list(&[]) }.signed(&middle);
    let by_nobody = story.list(&[]).signed(&below);
    let refused = story.network.admin(1, "add_organisation", &[&add("Org4", &root, &[&middle], &[by_nobody])]);
    assert_eq!(code(&refused), Code::Untrusted, "what cannot come in is not proposed");
    let good = add("Org4", &root, &[&middle], &[by_middle]);
    for admin in [1, 2] {
        story.network.admin(admin, "add_organisation", &[&good]).unwrap();
    }
    // Two of three agree: that is enough.
    assert_eq!(code(&story.network.call(&nadia, "withdraw", &["00000000"])), Code::Revoked, "from the first block on");
    let omar = middle.user("Omar", "client", KeyKind::P256);
    assert_eq!(
        code(&story.network.call(&omar, "withdraw", &["00000000"])),
        Code::NotAdmin,
        "by way of the intermediate"
    );
}

#[test]
fn a_list_revokes_in_its_block_and_says_whom() {
    let mut story = Story::new();
    let wanted = [serial(&story.salma), vec![9]];
    let list = story.list(&wanted).signed(&story.ca);
    let argument = json!({"list": hex::encode(&list)}).to_string();
    let first = story.network.sign(&story.admin, "record_revocation_list", &[&argument]);
    let behind = story.network.sign(&story.salma, "withdraw", &["00000000"]);
    let answers = story.network.block(&[&first, &behind]);
    let recorded: RecordedList = json(answers[0].clone());
    assert_eq!(recorded.list.listed, 2);
    let named: BTreeSet<_> = recorded.serials.iter().map(|serial| hex::decode(serial).unwrap()).collect();
    assert_eq!(named, wanted.clone().into());
    assert_eq!(code(&answers[1]), Code::Revoked, "in the same block");
    assert_eq!(story.network.event_names(), ["revocation_list"]);
    let revoked: Page<RevocationRecord> = story.network.query("revocations", &["{}"]);
    assert!(revoked.items.iter().all(|record| record.organisation == "Org3" && record.by == "Org3/Boss"));
    assert_eq!(revoked.items.len(), 2);
    let again: RecordedList = json(story.record_bytes(&list));
    assert!(again.serials.is_empty() && again.list == recorded.list, "the same list once more changes nothing");
}

#[test]
fn only_an_admin_of_the_authority_brings_a_list_that_the_authority_signed() {
    let mut story = Story::new();
    let list = hex::encode(story.list(&[vec![1]]).signed(&story.ca));
    let argument = json!({ "list": list }).to_string();
    assert_eq!(code(&story.network.call(&story.salma, "record_revocation_list", &[&argument])), Code::NotAdmin);
    assert_eq!(code(&story.network.admin(1, "record_revocation_list", &[&argument])), Code::Untrusted);
    let twin = Ca::with_key("fabric-ca", KeyKind::P256);
    let forged = story.list(&[vec![1]]).signed(&twin);
    assert_eq!(code(&story.record_bytes(&forged)), Code::Untrusted);
    let garbage = story.record_bytes(b"garbage");
    assert_eq!(code(&garbage), Code::CertificateMalformed);
    let ours = &story.network.cas[0];
    let of_ours = story.list(&[vec![1]]).signed(ours);
    assert_eq!(code(&story.record_bytes(&of_ours)), Code::Untrusted, "nobody revokes what others stand for");
    let argument = json!({"list": hex::encode(of_ours)}).to_string();
    assert_eq!(
        code(&story.network.admin(1, "record_revocation_list", &[&argument])),
        Code::Ok,
        "ours may have lists, too"
    );
}

#[test]
fn a_part_of_a_list_never_passes_for_the_whole() {
    let mut story = Story::new();
    // A list of changes, and one that nobody knows.
    for oid in [[0x55, 0x1d, 0x1b], [0x55, 0x1d, 0x7f]] {
        let odd = List { extensions: vec![extension(&oid, true, &[0x30, 0x00])], ..story.list(&[]) };
        assert_eq!(code(&story.record(&odd)), Code::CertificateMalformed, "{oid:02x?}");
        let harmless =
            List { extensions: vec![extension(&[0x55, 0x1d, 0x7f], false, &[0x05, 0x00])], ..story.list(&[]) };
        assert_eq!(code(&story.record(&harmless)), Code::Ok);
    }
}

#[test]
fn a_list_is_of_today() {
    let mut story = Story::new();
    let now = story.now();
    let future = List { this_update: now + 600, next_update: Some(now + 86_400), ..List::default() };
    assert_eq!(code(&story.record(&future)), Code::OldList);
    let past = List { this_update: now - 600, next_update: Some(now - 60), ..List::default() };
    assert_eq!(code(&story.record(&past)), Code::OldList);
    assert_eq!(
        code(&story.record(&List { this_update: now + 60, ..List::default() })),
        Code::Ok,
        "clocks differ a little"
    );
}

#[test]
fn who_is_left_out_of_a_list_stays_revoked_and_the_answer_says_so_until_the_certificate_ends() {
    let mut story = Story::new();
    let short = |params: &mut rcgen::CertificateParams| params.not_after = rcgen::date_time_ymd(2030, 1, 3);
    let seen = story.ca.user_as(["Nadia", "client"], KeyKind::P256, short);
    let (held, stolen) =
        (story.ca.user("Omar", "client", KeyKind::P256), story.ca.user("Lena", "client", KeyKind::P256));
    story.network.call(&seen, "withdraw", &["00000000"]).unwrap_err();
    let first = story.list(&[serial(&seen), serial(&held), serial(&story.salma)]);
    assert!(json::<RecordedList>(story.record(&first)).left_out.is_empty());
    // One person is held no longer, and a key was stolen: one list says both.
    story.network.time += 60 * SECOND;
    let second = story.list(&[serial(&seen), serial(&story.salma), serial(&stolen)]);
    let recorded: RecordedList = json(story.record(&second));
    assert_eq!(
        (recorded.serials, recorded.left_out),
        (vec![hex::encode(serial(&stolen))], vec![hex::encode(serial(&held))])
    );
    for revoked in [&stolen, &held] {
        assert_eq!(code(&story.network.call(revoked, "withdraw", &["00000000"])), Code::Revoked);
    }
    story.network.time += 3 * DAY;
    let without_ended = story.list(&[serial(&story.salma), serial(&stolen)]);
    let recorded: RecordedList = json(story.record(&without_ended));
    assert!(recorded.left_out.is_empty(), "the ledger knows that this one has ended");
    story.network.time += 60 * SECOND;
    let nobody = story.list(&[]);
    assert_eq!(json::<RecordedList>(story.record(&nobody)).left_out.len(), 2);
    assert_eq!(story.salma_is(), Code::Revoked);
}

#[test]
fn a_list_that_has_ended_is_a_warning_or_refuses_the_people_and_never_the_way_back() {
    let mut story = Story::new();
    let node = story.ca.user("peer0", "peer", KeyKind::P256);
    let list = story.list(&[]);
    story.record(&list).unwrap();
    let stale = |story: &Story| story.network.query::<Vec<KnownList>>("revocation_lists", &[])[0].stale;
    assert_eq!(stale(&story), Stale::Warn);
    story.network.time += 8 * DAY;
    assert_eq!(story.salma_is(), Code::Ok, "a warning refuses nobody");
    assert_eq!(code(&story.network.call(&story.salma, "set_stale_lists", &[r#"{"stale":"refuse"}"#])), Code::NotAdmin);
    story.network.call(&story.admin, "set_stale_lists", &[r#"{"stale":"refuse"}"#]).unwrap();
    assert_eq!(stale(&story), Stale::Refuse);
    assert_eq!(story.salma_is(), Code::ListStale);
    assert_eq!(code(&story.network.call(&story.admin, "set_stale_lists", &[r#"{"stale":"warn"}"#])), Code::ListStale);
    assert_eq!(code(&story.network.ask(&story.salma, "nodes", &[])), Code::ListStale);
    assert_eq!(code(&story.network.ask(&story.admin, "nodes", &[])), Code::Ok, "an admin sees what is wrong");
    assert_eq!(code(&story.network.call(&node, "withdraw", &["00000000"])), Code::NotAdmin, "nodes go on");
    assert_eq!(code(&story.network.admin(1, "set_stale_lists", &[r#"{"stale":"warn"}"#])), Code::Ok, "others do, too");
    assert!(story.network.open_again().is_ok());
    let list = story.list(&[]);
    story.record(&list).unwrap();
    assert_eq!(story.salma_is(), Code::Ok);
}

#[test]
fn an_intermediate_that_its_root_revokes_vouches_for_nobody() {
    let mut story = Story::new();
    let root = Ca::above("root", 1);
    let (middle, other) = (root.below("middle"), root.below("other"));
    let add = add("Org4", &root, &[&middle, &other], &[]);
    for admin in [1, 2] {
        story.network.admin(admin, "add_organisation", &[&add]).unwrap();
    }
    let (boss, nadia) = (other.user("Boss", "admin", KeyKind::P256), middle.user("Nadia", "client", KeyKind::P256));
    assert_eq!(code(&story.network.call(&nadia, "withdraw", &["00000000"])), Code::NotAdmin);
    let connected = story.network.ledger.msps().verify(&nadia.certificate, &[], story.network.time).unwrap();
    story.network.ledger.check_revoked(&connected).unwrap();
    let revoked = Certificate::parse(&middle.root()).unwrap().serial;
    let argument = json!({"list": hex::encode(story.list(&[revoked]).signed(&root))}).to_string();
    story.network.call(&boss, "record_revocation_list", &[&argument]).unwrap();
    assert_eq!(story.network.event_names(), ["organisation_updated", "revocation_list"]);
    assert_eq!(code(&story.network.call(&nadia, "withdraw", &["00000000"])), Code::Untrusted);
    let refused = story.network.ledger.check_revoked(&connected).unwrap_err();
    assert!(refused.code == Code::Untrusted && refused.found.contains("a CA that Org4 removed"), "{refused}");
    assert_eq!(code(&story.network.ask(&boss, "nodes", &[])), Code::Ok);
    assert_eq!(code(&story.network.call(&boss, "approve", &["00000000"])), Code::NotFound);
}

#[test]
fn a_member_may_sign_with_p384() {
    let mut network = Network::new(2, 2);
    let modern = network.cas[0].user("Salma", "member", KeyKind::P384);
    assert_eq!(code(&network.call(&modern, "withdraw", &["00000000"])), Code::NotAdmin);
}

/// A small model of the lists, written apart from the ledger.
#[derive(Default)]
struct Model {
    newest: Option<List>,
    revoked: BTreeSet<u8>,
}

impl Model {
    fn takes(&self, list: &List, now: u64) -> bool {
        let is_now = list.this_update <= now + 300 && list.next_update.is_none_or(|end| end >= now);
        let Some(newest) = &self.newest else { return is_now };
        let grows = newest.number.is_none_or(|before| list.number.is_some_and(|number| number > before));
        let goes_on = list.this_update > newest.this_update || (list.this_update == newest.this_update && grows);
        is_now && goes_on
    }
}

/// Lists in random order: only those that a small model takes are taken, and nothing comes back.
#[test]
fn lists_go_forward_only() {
    for seed in 0..12 {
        let mut random = Random::new(seed, "lists");
        let mut story = Story::new();
        let mut model = Model::default();
        // Serial numbers 1 to 6; those of the first three have certificates that end on some day.
        let people: Vec<User> = (1..=3_u8)
            .map(|number| {
                story.ca.user_as([&format!("P{number}"), "client"], KeyKind::P256, |params| {
                    params.serial_number = Some(rcgen::SerialNumber::from_slice(&[number]));
                    params.not_after = rcgen::date_time_ymd(2030, 1, 2 + number);
                })
            })
            .collect();
        for person in &people {
            story.network.call(person, "withdraw", &["00000000"]).unwrap_err();
        }
        let (mut taken, mut refused) = (0, 0);
        for _ in 0..60 {
            story.network.time += random.below(12) * 3_600 * SECOND;
            let now = story.now() + 1;
            let mut serials: BTreeSet<u8> =
                model.newest.iter().flat_map(|list| list.serials.iter().map(|serial| serial[0])).collect();
            for number in 1..=6 {
                match random.below(8) {
                    0 => drop(serials.insert(number)),
                    1 => drop(serials.remove(&number)),
                    _ => {}
                }
            }
            let before = model.newest.clone().unwrap_or_default();
            let list = List {
                this_update: match random.below(6) {
                    0 => before.this_update.max(1).saturating_sub(random.below(3)),
                    1 => now + random.below(600),
                    _ => now,
                },
                next_update: (random.below(4) > 0)
                    .then(|| (now + 86_400 * 30).saturating_sub(random.below(2) * 86_400 * 31)),
                number: match random.below(5) {
                    0 => None,
                    1 => before.number,
                    _ => Some(before.number.unwrap_or(0).saturating_add(1).min(127)),
                },
                serials: serials.iter().map(|number| vec![*number]).collect(),
                extensions: Vec::new(),
            };
            // A list whose next update lies before it is no list at all.
            let sound = list.next_update.is_none_or(|next| next >= list.this_update);
            let wanted = sound && model.takes(&list, now);
            let answer = story.record(&list);
            assert_eq!(answer.is_ok(), wanted, "seed {seed}: {list:?} after {:?}: {answer:?}", model.newest);
            if wanted {
                model.revoked.extend(&serials);
                model.newest = Some(list);
                taken += 1;
            } else {
                refused += 1;
            }
            for (number, person) in (1..).zip(&people) {
                let end = Certificate::parse(&person.certificate).unwrap().not_after;
                if story.network.time + SECOND < end {
                    let answer = code(&story.network.call(person, "withdraw", &["00000000"]));
                    let wanted = if model.revoked.contains(&number) { Code::Revoked } else { Code::NotAdmin };
                    assert_eq!(answer, wanted, "seed {seed}: serial {number}");
                }
            }
            let listed: Vec<KnownList> = story.network.query("revocation_lists", &[]);
            let shown = listed.first().map(|known| known.list.clone());
            assert_eq!(
                shown.map(|ListRecord { listed, .. }| listed),
                model.newest.as_ref().map(|list| list.serials.len() as u64)
            );
        }
        assert!(taken > 3 && refused > 3, "seed {seed}: {taken} taken, {refused} refused");
    }
}
