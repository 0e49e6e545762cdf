#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use super::*;
use ledger_api::Context;
use ledger_identity::key::SigningKey;
use ledger_identity::msp::{Msp, Msps, Usage};
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;

const NOW: u64 = 1_800_000_000_000_000;

fn node(place: &Path, name: &str, organisation: &str, voter: bool) -> PlannedNode {
    PlannedNode {
        name: name.into(),
        organisation: organisation.into(),
        data: place.join("deep").join(name),
        address: format!("{name}:7450"),
        voter,
    }
}

fn plan(place: &Path) -> NetworkPlan {
    NetworkPlan {
        snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
        label: "fleet".into(),
        organisations: vec![
            PlannedOrganisation { name: "Org1".into(), key: KeyKind::Ed25519 },
            PlannedOrganisation { name: "Org2".into(), key: KeyKind::P256 },
        ],
        nodes: vec![
            node(place, "node1", "Org1", true),
            node(place, "node2", "Org2", false),
            node(place, "node3", "Org2", false),
        ],
    }
}

fn msps(genesis: &Genesis) -> Msps {
    let mut msps = Msps::new();
    for organisation in &genesis.organisations {
        msps.insert(Msp::new(&organisation.name, &organisation.roots, &organisation.intermediates).unwrap()).unwrap();
    }
    msps
}

#[test]
fn every_node_has_the_same_genesis_and_a_certificate_that_verifies_against_it() {
    let place = TempDir::new().unwrap();
    let plan = plan(place.path());
    let founded = found(&plan, NOW).unwrap();
    let msps = msps(&founded.genesis);
    for (planned, id) in plan.nodes.iter().zip(1..) {
        let document = fs::read(planned.data.join(GENESIS_FILE)).unwrap();
        let (genesis, network) = Genesis::from_bytes(&document).unwrap();
        assert_eq!((&genesis, network), (&founded.genesis, founded.network));
        assert_eq!(genesis.node(&planned.organisation, &planned.name).unwrap().id, id);

        let chain: Vec<_> = CertificateDer::pem_file_iter(planned.data.join(CERTIFICATE_FILE))
            .unwrap()
            .collect::<Result<_, _>>()
            .unwrap();
        let identity = msps.verify_for(Usage::Server, &chain[0], &chain[1..], NOW).unwrap();
        assert_eq!((identity.role, &identity.name), (Role::Node, &planned.name));
        assert_eq!(identity.organisation, planned.organisation);
        let key = fs::read_to_string(planned.data.join(KEY_FILE)).unwrap();
        assert_eq!(SigningKey::from_pkcs8_pem(&key).unwrap().public_key(), identity.public_key);
        let authority = founded.authorities.iter().find(|ca| ca.organisation == planned.organisation).unwrap();
        assert_eq!(Hash::of(&[&chain[1]]), authority.fingerprint, "the root comes along");
    }
}

#[test]
fn the_ca_of_an_organisation_is_on_its_first_node_and_ready_to_use() {
    let place = TempDir::new().unwrap();
    let plan = plan(place.path());
    let founded = found(&plan, NOW).unwrap();
    for (authority, node) in founded.authorities.iter().zip([0, 1]) {
        assert!(authority.directory.starts_with(&plan.nodes[node].data));
        let mut ca = CertificateAuthority::open(&authority.directory).unwrap();
        assert_eq!(ca.fingerprint(), authority.fingerprint);
        let admin = ca.issue("Admin", Role::Admin, BTreeMap::new(), KeyKind::Ed25519, NOW).unwrap();
        let identity = msps(&founded.genesis).verify(&admin.certificate, &[], NOW).unwrap();
        assert_eq!(identity.id(), format!("{}/Admin", authority.organisation));
    }
    assert!(!plan.nodes[2].data.join(ca::DIRECTORY).exists());
}

#[test]
fn one_node_carries_the_ca_of_an_organisation_that_runs_none() {
    let place = TempDir::new().unwrap();
    let mut plan = plan(place.path());
    plan.nodes.truncate(1);
    let founded = found(&plan, NOW).unwrap();
    for authority in founded.authorities {
        assert!(authority.directory.starts_with(&plan.nodes[0].data));
        assert!(CertificateAuthority::open(&authority.directory).is_ok());
    }
}

#[test]
fn an_issued_context_is_complete_and_can_be_issued_again() {
    let place = TempDir::new().unwrap();
    let plan = plan(place.path());
    let founded = found(&plan, NOW).unwrap();
    for _ in 0..2 {
        let data = &plan.nodes[1].data;
        let context = issue(data, "Org2", ("Admin", Role::Admin), BTreeMap::new(), "here:1", NOW).unwrap();
        let identity = context.msps.verify(&context.chain[0], &context.chain[1..], NOW).unwrap();
        assert_eq!((identity.id().as_str(), identity.role), ("Org2/Admin", Role::Admin));
        assert_eq!(identity.public_key, context.key.public_key());
        assert_eq!((context.network, context.label.as_str()), (founded.network, "fleet"));
        assert_eq!(context.nodes, ["here:1"]);
        assert_eq!(context.ca_fingerprint("Org2"), Some(founded.authorities[1].fingerprint));
        context.save(&place.path().join("home")).unwrap();
        Context::load(&place.path().join("home"), Some("Admin")).unwrap();
    }
    let elsewhere = issue(&plan.nodes[1].data, "Org1", ("Admin", Role::Admin), BTreeMap::new(), "here:1", NOW);
    assert_eq!(elsewhere.unwrap_err().code, Code::BadFile);
}

#[test]
fn keys_and_data_directories_are_their_owners_only() {
    let place = TempDir::new().unwrap();
    let plan = plan(place.path());
    found(&plan, NOW).unwrap();
    for planned in &plan.nodes {
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode(&planned.data.join(KEY_FILE)), 0o600);
        assert_eq!(mode(&planned.data), 0o700);
    }
}

#[test]
fn two_networks_made_alike_have_different_names() {
    let [first, second] = [TempDir::new().unwrap(), TempDir::new().unwrap()];
    assert_ne!(found(&plan(first.path()), NOW).unwrap().network, found(&plan(second.path()), NOW).unwrap().network);
}

#[test]
fn an_existing_directory_is_never_touched_and_nothing_else_is_made() {
    let place = TempDir::new().unwrap();
    let plan = plan(place.path());
    let last = &plan.nodes[2].data;
    fs::create_dir_all(last).unwrap();
    fs::write(last.join("precious"), "x").unwrap();
    let refused = found(&plan, NOW).unwrap_err();
    assert_eq!(refused.code, Code::BadFile);
    assert!(refused.to_string().contains("node3"), "{refused}");
    assert_eq!(fs::read_dir(last).unwrap().count(), 1);
    assert_eq!(fs::read_dir(place.path().join("deep")).unwrap().count(), 1);
}

#[test]
fn a_failure_on_the_way_leaves_nothing_behind() {
    let place = TempDir::new().unwrap();
    let mut plan = plan(place.path());
    // The parent of the last data directory is a file: it fails after others were staged.
    fs::write(place.path().join("file"), "x").unwrap();
    plan.nodes[2].data = place.path().join("file").join("node3");
    assert!(found(&plan, NOW).is_err());
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1, "only the file is left");

    // A name that no CA could have: it fails when everything is staged.
    let mut plan = self::plan(place.path());
    plan.organisations[1].name = "..".into();
    plan.nodes.truncate(1);
    assert!(found(&plan, NOW).is_err());
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
}

#[test]
fn directories_already_in_place_are_removed_when_a_later_one_fails() {
    let place = TempDir::new().unwrap();
    let plan = plan(place.path());
    let mut made = Made::default();
    let staged: Vec<_> = plan.nodes.iter().map(|node| made.stage(node).unwrap()).collect();
    let mut staged = staged.into_iter();
    made.publish(staged.next().unwrap(), &plan.nodes[0].data).unwrap();
    fs::create_dir(&plan.nodes[1].data).unwrap();
    assert!(made.publish(staged.next().unwrap(), &plan.nodes[1].data).is_err());
    drop((staged, made));
    assert!(!plan.nodes[0].data.exists());
    assert!(plan.nodes[1].data.exists(), "what somebody else made meanwhile stays");
    assert_eq!(fs::read_dir(place.path().join("deep")).unwrap().count(), 1);
}

#[test]
fn a_plan_that_contradicts_itself_is_refused() {
    let place = TempDir::new().unwrap();
    let good = plan(place.path());
    let spoil = |change: &dyn Fn(&mut NetworkPlan)| {
        let mut plan = good.clone();
        change(&mut plan);
        let refused = found(&plan, NOW).unwrap_err();
        assert_eq!(refused.code, Code::BadConfiguration, "{refused}");
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);
    };
    spoil(&|plan| plan.nodes.clear());
    spoil(&|plan| plan.nodes[0].voter = false);
    spoil(&|plan| plan.nodes[0].organisation = "Org3".into());
    spoil(&|plan| plan.nodes[0].name = "a/b".into());
    spoil(&|plan| plan.nodes[2].name = "node2".into());
    spoil(&|plan| plan.nodes[2].data = plan.nodes[1].data.clone());
    spoil(&|plan| plan.nodes[2].address = plan.nodes[1].address.clone());
    spoil(&|plan| plan.organisations[1].name = "Org1".into());
}
