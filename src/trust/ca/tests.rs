#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use super::place::{KEY_FILE, ROOT_FILE};
use super::*;
use ledger::msp::ENROLMENT_REPEAT_MAX;
use ledger_identity::Identity;
use ledger_identity::msp::{Msp, Msps, Usage};
use rcgen::{BasicConstraints, CertificateParams, CustomExtension, DnType, IsCa, KeyPair};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use tempfile::TempDir;

const NOW: u64 = 1_800_000_000_000_000;

struct Fixture {
    _place: TempDir,
    directory: PathBuf,
    ca: CertificateAuthority,
}

fn fixture() -> Fixture {
    of_kind(KeyKind::Ed25519)
}

fn of_kind(kind: KeyKind) -> Fixture {
    let place = TempDir::new().unwrap();
    let directory = place.path().join("ca").join("Org1");
    let ca = CertificateAuthority::create(&directory, "Org1", kind, NOW).unwrap();
    Fixture { _place: place, directory, ca }
}

fn attributes(names: &[&str]) -> BTreeMap<String, String> {
    names.iter().map(|name| ((*name).to_owned(), "true".to_owned())).collect()
}

fn request(kind: KeyKind) -> (SigningKey, Vec<u8>) {
    let key = SigningKey::generate(kind, &SystemRandom::new()).unwrap();
    let request = request::make(&key, "somebody").unwrap();
    (key, request)
}

fn verify(ca: &CertificateAuthority, usage: Usage, der: &[u8], at: u64) -> Result<Identity, Rejection> {
    let mut msps = Msps::new();
    msps.insert(Msp::new(ca.organisation(), &[ca.root()], &[] as &[&[u8]])?)?;
    Ok(msps.verify_for(usage, der, &[], at)?)
}

fn code<T: std::fmt::Debug>(result: Result<T, Rejection>) -> Code {
    result.unwrap_err().code
}

#[test]
fn what_is_registered_is_what_the_certificate_says_for_every_kind_of_key() {
    let kinds = [(KeyKind::Ed25519, KeyKind::P256), (KeyKind::P256, KeyKind::Ed25519), (KeyKind::P384, KeyKind::P384)];
    for (authority, holder) in kinds {
        let mut f = of_kind(authority);
        let secret = f.ca.register("Salma", Role::Member, attributes(&["Turtlebot4", "Husky"]), NOW).unwrap();
        let (key, csr) = request(holder);
        let der = f.ca.enrol("Salma", &secret, &csr, NOW).unwrap();

        let identity = verify(&f.ca, Usage::Client, &der, NOW).unwrap();
        assert_eq!(identity.id(), "Org1/Salma");
        assert_eq!(identity.role, Role::Member);
        assert_eq!(identity.attributes, attributes(&["Turtlebot4", "Husky"]));
        assert_eq!(identity.public_key, key.public_key());
        let kept = &f.ca.identity("Salma").unwrap().certificates[0];
        assert_eq!((&kept.serial, kept.issuer.0), (&identity.serial, identity.issuer));
        assert_eq!(kept.fingerprint.0, identity.fingerprint);
        assert_eq!(identity.serial.len(), 16);
    }
}

#[test]
fn certificates_start_five_minutes_ago_and_end_after_the_configured_days_but_not_after_the_root() {
    let mut f = fixture();
    let issued = f.ca.issue("a", Role::Member, BTreeMap::new(), KeyKind::Ed25519, NOW).unwrap();
    let read = Certificate::parse(&issued.certificate).unwrap();
    assert_eq!(read.not_before, NOW - 300_000_000);
    assert_eq!(read.not_after, NOW + 365 * DAY + 999_999);

    f.ca.set_days(2, 7);
    let issued = f.ca.issue("b", Role::Member, BTreeMap::new(), KeyKind::Ed25519, NOW).unwrap();
    assert_eq!(Certificate::parse(&issued.certificate).unwrap().not_after, NOW + 2 * DAY + 999_999);

    f.ca.set_days(100_000, 7);
    let issued = f.ca.issue("c", Role::Member, BTreeMap::new(), KeyKind::Ed25519, NOW).unwrap();
    let root = Certificate::parse(f.ca.root()).unwrap();
    assert_eq!(Certificate::parse(&issued.certificate).unwrap().not_after, root.not_after);

    let too_late = root.not_after + 1;
    assert_eq!(
        code(f.ca.issue("d", Role::Member, BTreeMap::new(), KeyKind::Ed25519, too_late)),
        Code::CertificateExpired
    );
}

#[test]
fn only_a_node_may_be_a_server() {
    let mut f = fixture();
    for (name, role, server) in
        [("n", Role::Node, true), ("m", Role::Member, false), ("a", Role::Admin, false), ("r", Role::Robot, false)]
    {
        let der = f.ca.issue(name, role, BTreeMap::new(), KeyKind::Ed25519, NOW).unwrap().certificate;
        assert_eq!(verify(&f.ca, Usage::Client, &der, NOW).unwrap().role, role);
        assert_eq!(verify(&f.ca, Usage::Server, &der, NOW).is_ok(), server, "{name}");
    }
}

#[test]
fn requested_authority_subject_and_extensions_are_ignored() {
    let mut f = fixture();
    let secret = f.ca.register("Farhad", Role::Member, BTreeMap::new(), NOW).unwrap();
    let key = KeyPair::generate().unwrap();
    let mut params = CertificateParams::new(vec!["localhost".to_owned()]).unwrap();
    params.distinguished_name.push(DnType::CommonName, "Salma");
    params.distinguished_name.push(DnType::OrganizationalUnitName, "admin");
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let forged = encode_attributes(&attributes(&["Husky"])).unwrap();
    params.custom_extensions =
        vec![CustomExtension::from_oid_content(ledger_identity::certificate::ATTRIBUTES_OID, forged)];
    let csr = params.serialize_request(&key).unwrap();

    let der = f.ca.enrol("Farhad", &secret, csr.der(), NOW).unwrap();
    let identity = verify(&f.ca, Usage::Client, &der, NOW).unwrap();
    assert_eq!((identity.name.as_str(), identity.role), ("Farhad", Role::Member));
    assert!(identity.attributes.is_empty());
    assert!(verify(&f.ca, Usage::Server, &der, NOW).is_err());
    assert!(Msp::new("Evil", &[&der], &[] as &[&[u8]]).is_err(), "it must not be an authority");
}

#[test]
fn a_bad_request_is_refused_and_leaves_the_secret_usable() {
    let mut f = fixture();
    let secret = f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    let (_, good) = request(KeyKind::Ed25519);
    let mut unsigned = good.clone();
    *unsigned.last_mut().unwrap() ^= 1;
    let trailing = [good.as_slice(), &[0]].concat();
    // As OpenSSL makes it for a key on P-521.
    let p521 = include_bytes!("../../../tests/fixtures/request-p521.der").to_vec();
    let large = vec![0x30; REQUEST_BYTES_MAX + 1];
    for bad in [&unsigned, &trailing, &p521, &large, &Vec::new()] {
        assert_eq!(code(f.ca.enrol("Salma", &secret, bad, NOW)), Code::BadArgument);
    }
    for cut in 0..good.len() {
        assert_eq!(code(f.ca.enrol("Salma", &secret, &good[..cut], NOW)), Code::BadArgument);
    }
    assert!(f.ca.enrol("Salma", &secret, &good, NOW).is_ok());
}

#[test]
fn a_secret_is_used_up_by_one_key_also_across_a_restart() {
    let mut f = fixture();
    let secret = f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    let ((key, csr), (_, other)) = (request(KeyKind::Ed25519), request(KeyKind::Ed25519));
    // Typed by hand: spaces and capitals are forgiven.
    let first = f.ca.enrol("Salma", &format!(" {} ", secret.to_uppercase()), &csr, NOW).unwrap();
    assert_eq!(code(f.ca.enrol("Salma", &secret, &other, NOW)), Code::EnrolmentRefused);
    drop(f.ca);
    let mut ca = CertificateAuthority::open(&f.directory).unwrap();
    assert_eq!(ca.identity("Salma").unwrap().certificates.len(), 1);
    assert_eq!(code(ca.enrol("Salma", &secret, &other, NOW)), Code::EnrolmentRefused);
    // The answer was lost: the same key asks again and receives the same certificate, for some minutes.
    let again = ca.enrol("Salma", &secret, &csr, NOW + ENROLMENT_REPEAT_MAX).unwrap();
    assert_eq!(again, first);
    assert_eq!(verify(&ca, Usage::Client, &again, NOW).unwrap().public_key, key.public_key());
    assert_eq!(code(ca.enrol("Salma", &secret, &csr, NOW + ENROLMENT_REPEAT_MAX + 1)), Code::EnrolmentRefused);
}

#[test]
fn a_node_whose_own_certificate_ran_out_receives_another_whether_it_was_registered_here_or_not() {
    let mut f = fixture();
    let issued = f.ca.issue("node1", Role::Node, BTreeMap::new(), KeyKind::P256, NOW).unwrap();
    let own = verify(&f.ca, Usage::Server, &issued.certificate, NOW).unwrap();
    let later = NOW + 400 * DAY;
    for name in ["node1", "node2"] {
        let (key, csr) = request(KeyKind::P256);
        let own = Identity { name: name.into(), ..own.clone() };
        let der = f.ca.revive(&own, &csr, later).unwrap();
        let identity = verify(&f.ca, Usage::Server, &der, later).unwrap();
        assert_eq!((identity.name.as_str(), identity.role, identity.public_key), (name, Role::Node, key.public_key()));
        assert!(f.ca.identity(name).unwrap().certificates.iter().any(|known| known.der == der));
    }
}

#[test]
fn unknown_names_and_wrong_used_or_expired_secrets_are_refused_with_the_same_words() {
    let mut f = fixture();
    let (_, csr) = request(KeyKind::Ed25519);
    let secret = f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    let unknown = f.ca.enrol("Nobody", &secret, &csr, NOW).unwrap_err();
    assert_eq!(unknown.code, Code::EnrolmentRefused);
    assert_eq!(f.ca.enrol("Salma", "wrong", &csr, NOW).unwrap_err(), unknown);
    assert_eq!(f.ca.enrol("Salma", &"x".repeat(1000), &csr, NOW).unwrap_err(), unknown);
    assert_eq!(f.ca.enrol("Salma", &secret, &csr, NOW + 7 * DAY + 1).unwrap_err(), unknown);
    f.ca.enrol("Salma", &secret, &csr, NOW + 7 * DAY).unwrap();
    assert_eq!(f.ca.enrol("Salma", &secret, &request(KeyKind::Ed25519).1, NOW).unwrap_err(), unknown);
}

#[test]
fn guesses_never_void_a_secret() {
    let mut f = fixture();
    let (_, csr) = request(KeyKind::Ed25519);
    let secret = f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    let before = fs::read(f.directory.join(registry::FILE)).unwrap();
    for _ in 0..100 {
        assert_eq!(code(f.ca.enrol("Salma", "wrong", &csr, NOW)), Code::EnrolmentRefused);
    }
    assert_eq!(fs::read(f.directory.join(registry::FILE)).unwrap(), before, "nor do they write to the disk");
    assert!(f.ca.enrol("Salma", &secret, &csr, NOW).is_ok());
}

#[test]
fn a_registered_name_is_not_registered_again_but_may_receive_a_new_secret_and_new_attributes() {
    let mut f = fixture();
    let (_, csr) = request(KeyKind::Ed25519);
    let first = f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    assert_eq!(code(f.ca.register("Salma", Role::Admin, BTreeMap::new(), NOW)), Code::AlreadyRegistered);
    assert_eq!(f.ca.identity("Salma").unwrap().role, Role::Member);
    let second = f.ca.reissue("Salma", Some(attributes(&["Husky"])), NOW).unwrap();
    assert_eq!(code(f.ca.enrol("Salma", &first, &csr, NOW)), Code::EnrolmentRefused);
    let der = f.ca.enrol("Salma", &second, &csr, NOW).unwrap();
    assert_eq!(verify(&f.ca, Usage::Client, &der, NOW).unwrap().attributes, attributes(&["Husky"]));
    assert_eq!(code(f.ca.reissue("Nobody", None, NOW)), Code::NotFound);
}

#[test]
fn names_and_attributes_that_no_certificate_could_hold_are_refused() {
    let mut f = fixture();
    for name in ["", "a/b", "a\nb", "Sal ma", ".a", "-a", &"x".repeat(65)] {
        assert_eq!(code(f.ca.register(name, Role::Member, BTreeMap::new(), NOW)), Code::BadArgument);
    }
    let many: BTreeMap<_, _> = (0..65).map(|i| (format!("a{i}"), "true".to_owned())).collect();
    let large = BTreeMap::from([("a".to_owned(), "x".repeat(5000))]);
    for bad in [many, large, BTreeMap::from([(String::new(), "true".to_owned())])] {
        assert_eq!(code(f.ca.register("Salma", Role::Member, bad, NOW)), Code::BadArgument);
    }
    assert_eq!(f.ca.identities().count(), 0);
}

#[test]
fn an_organisation_whose_name_leaves_the_directory_is_refused() {
    let place = TempDir::new().unwrap();
    for name in ["..", ".", ".hidden", "a/b", ""] {
        let made = CertificateAuthority::create(&place.path().join("ca"), name, KeyKind::Ed25519, NOW);
        assert_eq!(made.err().unwrap().code, Code::BadArgument);
        assert!(!place.path().join("ca").exists());
    }
}

#[test]
fn a_ca_is_never_created_over_an_existing_directory() {
    let f = fixture();
    let before = fs::read(f.directory.join(KEY_FILE)).unwrap();
    assert_eq!(
        CertificateAuthority::create(&f.directory, "Org1", KeyKind::Ed25519, NOW).err().unwrap().code,
        Code::BadFile
    );
    assert_eq!(fs::read(f.directory.join(KEY_FILE)).unwrap(), before);
}

#[test]
fn two_processes_that_change_a_ca_do_not_lose_each_others_changes() {
    let mut f = fixture();
    let mut beside = CertificateAuthority::open(&f.directory).unwrap();
    let secret = beside.admin_secret("admin", NOW).unwrap();
    f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    assert_eq!(code(beside.register("Salma", Role::Member, BTreeMap::new(), NOW)), Code::AlreadyRegistered);
    let (_, csr) = request(KeyKind::Ed25519);
    let der = f.ca.enrol("admin", &secret, &csr, NOW).unwrap();
    assert_eq!(verify(&f.ca, Usage::Client, &der, NOW).unwrap().role, Role::Admin);
    assert_eq!(CertificateAuthority::open(&f.directory).unwrap().identities().count(), 2);
}

#[test]
fn an_admins_secret_is_made_for_a_new_name_and_for_an_admin_who_is_known_and_for_nobody_else() {
    let mut f = fixture();
    f.ca.issue("admin", Role::Admin, BTreeMap::new(), KeyKind::Ed25519, NOW).unwrap();
    f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    let (_, csr) = request(KeyKind::Ed25519);
    for name in ["admin", "other"] {
        let secret = f.ca.admin_secret(name, NOW).unwrap();
        let der = f.ca.enrol(name, &secret, &csr, NOW).unwrap();
        assert_eq!(verify(&f.ca, Usage::Client, &der, NOW).unwrap().role, Role::Admin);
    }
    assert_eq!(code(f.ca.admin_secret("Salma", NOW)), Code::AlreadyRegistered);
    assert_eq!(code(f.ca.admin_secret("a b", NOW)), Code::BadArgument);
}

#[test]
fn secrets_are_readable_by_their_owner_only_and_a_key_that_others_may_read_is_refused() {
    let mut f = fixture();
    f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    let mode = |name: &str| fs::metadata(f.directory.join(name)).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(KEY_FILE), 0o600);
    assert_eq!(mode(registry::FILE), 0o600);
    assert_eq!(mode(""), 0o700);
    drop(f.ca);
    fs::set_permissions(f.directory.join(KEY_FILE), fs::Permissions::from_mode(0o640)).unwrap();
    let refused = CertificateAuthority::open(&f.directory).err().unwrap();
    assert!(refused.to_string().contains("chmod 600"), "{refused}");
}

#[test]
fn the_secret_is_not_in_the_file() {
    let mut f = fixture();
    let secret = f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    let file = fs::read_to_string(f.directory.join(registry::FILE)).unwrap();
    assert!(file.contains("Salma") && !file.contains(&secret));
}

#[test]
fn a_registry_that_is_cut_anywhere_or_gone_is_refused_and_never_empty() {
    let mut f = fixture();
    f.ca.issue("Salma", Role::Member, attributes(&["Husky"]), KeyKind::Ed25519, NOW).unwrap();
    f.ca.register("Farhad", Role::Member, BTreeMap::new(), NOW).unwrap();
    drop(f.ca);
    let path = f.directory.join(registry::FILE);
    let whole = fs::read(&path).unwrap();
    for cut in 0..whole.len() {
        fs::write(&path, &whole[..cut]).unwrap();
        let refused = CertificateAuthority::open(&f.directory).err().unwrap();
        assert_eq!(refused.code, Code::Corrupt, "cut at {cut}");
    }
    fs::remove_file(&path).unwrap();
    assert_eq!(CertificateAuthority::open(&f.directory).err().unwrap().code, Code::BadFile);
}

#[test]
fn a_torn_write_of_the_next_registry_leaves_the_old_one() {
    let mut f = fixture();
    f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    let path = f.directory.join(registry::FILE);
    let whole = fs::read(&path).unwrap();
    drop(f.ca);
    for cut in 0..whole.len() {
        fs::write(path.with_extension("json.new"), &whole[..cut]).unwrap();
        let ca = CertificateAuthority::open(&f.directory).unwrap();
        assert_eq!(ca.identities().count(), 1);
    }
    let mut ca = CertificateAuthority::open(&f.directory).unwrap();
    ca.register("Farhad", Role::Member, BTreeMap::new(), NOW).unwrap();
    drop(ca);
    assert_eq!(CertificateAuthority::open(&f.directory).unwrap().identities().count(), 2);
}

#[test]
fn when_the_disk_refuses_nothing_is_answered_and_nothing_is_forgotten() {
    let mut f = fixture();
    let secret = f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    let (_, csr) = request(KeyKind::Ed25519);
    // A directory in the way of the new file: writing it fails.
    let obstacle = f.directory.join("identities.json.new");
    fs::create_dir(&obstacle).unwrap();
    assert!(f.ca.enrol("Salma", &secret, &csr, NOW).is_err());
    assert!(f.ca.register("Farhad", Role::Member, BTreeMap::new(), NOW).is_err());
    fs::remove_dir(&obstacle).unwrap();
    assert!(f.ca.enrol("Salma", &secret, &csr, NOW).is_ok());
    assert!(f.ca.register("Farhad", Role::Member, BTreeMap::new(), NOW).is_ok());
}

#[test]
fn after_a_change_that_the_disk_did_not_confirm_the_ca_stops() {
    let mut f = fixture();
    let secret = f.ca.register("Salma", Role::Member, BTreeMap::new(), NOW).unwrap();
    let (_, csr) = request(KeyKind::Ed25519);
    // A directory in the place of the file: the rename fails.
    let path = f.directory.join(registry::FILE);
    fs::rename(&path, f.directory.join("aside")).unwrap();
    fs::create_dir(&path).unwrap();
    assert!(f.ca.change(|_| ()).is_err());
    fs::remove_dir(&path).unwrap();
    fs::rename(f.directory.join("aside"), &path).unwrap();
    assert_eq!(code(f.ca.enrol("Salma", &secret, &csr, NOW)), Code::DiskFailed);
    drop(f.ca);
    assert!(CertificateAuthority::open(&f.directory).unwrap().enrol("Salma", &secret, &csr, NOW).is_ok());
}

#[test]
fn a_root_of_another_key_is_refused() {
    let f = fixture();
    let other = of_kind(KeyKind::Ed25519);
    drop(f.ca);
    fs::copy(other.directory.join(ROOT_FILE), f.directory.join(ROOT_FILE)).unwrap();
    assert_eq!(CertificateAuthority::open(&f.directory).err().unwrap().code, Code::BadFile);
}

#[test]
fn one_name_keeps_a_limited_number_of_valid_certificates() {
    let mut f = fixture();
    f.ca.set_days(1, 7);
    f.ca.issue("Salma", Role::Member, BTreeMap::new(), KeyKind::Ed25519, NOW).unwrap();
    let salma = f.ca.registry.identities.get_mut("Salma").unwrap();
    let one = salma.certificates[0].clone();
    while salma.certificates.len() < CERTIFICATES_MAX {
        salma.add(one.clone(), NOW).unwrap();
    }
    assert_eq!(code(f.ca.issue("Salma", Role::Member, BTreeMap::new(), KeyKind::Ed25519, NOW)), Code::LimitExceeded);
    f.ca.issue("Salma", Role::Member, BTreeMap::new(), KeyKind::Ed25519, NOW + 2 * DAY).unwrap();
    assert_eq!(f.ca.identity("Salma").unwrap().certificates.len(), 1, "those that expired are forgotten");
}

#[test]
fn issuing_again_gives_a_new_certificate_of_the_same_role_only() {
    let mut f = fixture();
    f.ca.issue("Admin", Role::Admin, BTreeMap::new(), KeyKind::Ed25519, NOW).unwrap();
    let again = f.ca.issue("Admin", Role::Admin, attributes(&["Husky"]), KeyKind::Ed25519, NOW).unwrap();
    assert_eq!(verify(&f.ca, Usage::Client, &again.certificate, NOW).unwrap().attributes, attributes(&["Husky"]));
    assert_eq!(f.ca.identity("Admin").unwrap().certificates.len(), 2);
    let other = f.ca.issue("Admin", Role::Member, BTreeMap::new(), KeyKind::Ed25519, NOW);
    assert_eq!(code(other), Code::AlreadyRegistered);
}

#[test]
fn a_node_opens_every_ca_that_it_carries() {
    let place = TempDir::new().unwrap();
    assert!(CertificateAuthority::open_all(place.path()).unwrap().is_empty());
    fs::create_dir_all(place.path().join(DIRECTORY).join(".new-Org3")).unwrap();
    for organisation in ["Org1", "Org2"] {
        let directory = place.path().join(DIRECTORY).join(organisation);
        CertificateAuthority::create(&directory, organisation, KeyKind::Ed25519, NOW).unwrap();
    }
    let mut found: Vec<_> = CertificateAuthority::open_all(place.path()).unwrap();
    found.sort_by(|a, b| a.organisation().cmp(b.organisation()));
    assert_eq!(found.iter().map(CertificateAuthority::organisation).collect::<Vec<_>>(), ["Org1", "Org2"]);
}
