//! Confidential services: who reads them, and which keys are good.

mod story;

use crate::fleet::{Fleet, SECOND, START, TURTLEBOT, TWIST, admin1, bytes, camera, farhad, identity, owner, salma};
use bytes::Bytes;
use ledger_abac::{DEFAULT_POLICY, Keyed, Readers, RobotChange, Share};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_confidential::{Keyring, ReadingKey, Sealer, Unreadable};
use ledger_contract::{READERS_MAX, ReaderTold};
use ledger_identity::{Identity, Role};

const POSES: &str = "OptiTrack/poses";
const HOUR: u64 = 3600 * SECOND;

/// Somebody with a reading key.
struct Person {
    identity: Identity,
    keyring: Keyring,
}

impl Person {
    fn new(identity: Identity) -> Self {
        let keyring = Keyring::new(Hash::ZERO, identity.id(), ReadingKey::generate());
        Self { identity, keyring }
    }

    fn enter(&self, fleet: &mut Fleet, service: &str) -> Result<Bytes, Rejection> {
        fleet.call(&self.identity, "reader", &bytes(&[service, &self.keyring.public_hex()]))
    }
}

/// A member of Org1 that may read the poses.
fn member(name: &str, serial: u8) -> Identity {
    identity("Org1", name, Role::Member, &["OptiTrack", "Turtlebot4"], serial)
}

/// The poses are confidential, and an admin of the owner reads them.
fn fleet() -> (Fleet, Person) {
    let mut fleet = Fleet::of_the_paper();
    let admin = Person::new(owner());
    for service in [POSES, TURTLEBOT] {
        fleet.ok(&owner(), "configure", &[service, r#"{"sharing":{"confidential":true}}"#]);
        admin.enter(&mut fleet, service).unwrap();
    }
    (fleet, admin)
}

/// The default policies, as the owner's own, so that others can stand beside them.
fn own_policies(fleet: &mut Fleet) {
    fleet.ok(&owner(), "policy", &["put", "base", DEFAULT_POLICY]);
}

fn readers(fleet: &Fleet, service: &str) -> Readers {
    serde_json::from_slice(&fleet.simulate(&owner(), "readers", &bytes(&[service])).unwrap()).unwrap()
}

fn share_as(
    fleet: &mut Fleet,
    who: &Identity,
    (service, epoch): (&str, u64),
    share: &Share,
) -> Result<Keyed, Rejection> {
    let share = serde_json::to_string(share).unwrap();
    let answer = fleet.call(who, "share", &bytes(&[service, &epoch.to_string(), &share]))?;
    Ok(serde_json::from_slice(&answer).unwrap())
}

/// Shares a key with those who read now.
fn share(fleet: &mut Fleet, who: &Identity, service: &str, epoch: u64) -> Result<(Sealer, Share), Rejection> {
    let (share, fresh) = Sealer::share(&Hash::ZERO, &who.id(), &readers(fleet, service)).unwrap();
    let keyed = share_as(fleet, who, (service, epoch), &share)?;
    Ok((fresh.shared_at(keyed.key), share))
}

fn send(
    fleet: &mut Fleet,
    who: &Identity,
    sealer: &Sealer,
    (service, epoch, seq): (&str, u64, u64),
) -> Result<Bytes, Rejection> {
    let sealed = sealer.seal(epoch, seq, &TWIST).unwrap();
    let mut args = bytes(&[service, &epoch.to_string(), &seq.to_string()]);
    args.push(sealed.clone());
    fleet.call(who, "set", &args).map(|_| sealed)
}

#[test]
fn on_a_confidential_service_only_envelopes_pass() {
    let (mut fleet, _admin) = fleet();
    let refused = fleet.set_refused(&camera(), Code::BadArgument, POSES, 0, 1);
    assert!(refused.message.contains("not encrypted") && refused.advice().contains("ledgerctl publish"), "{refused}");
    let (sealer, _) = share(&mut fleet, &camera(), POSES, 0).unwrap();
    send(&mut fleet, &camera(), &sealer, (POSES, 0, 1)).unwrap();
    let mut mixed = bytes(&[POSES, "0", "2"]);
    mixed.extend([sealer.seal(0, 2, &TWIST).unwrap(), Bytes::from_static(&TWIST)]);
    assert_eq!(fleet.call(&camera(), "set", &mixed).unwrap_err().code, Code::BadArgument, "one of them plain");
    mixed.reverse();
    fleet.ok(&owner(), "configure", &[POSES, r#"{"clear":["confidential"]}"#]);
    assert_eq!(send(&mut fleet, &camera(), &sealer, (POSES, 0, 3)).unwrap_err().code, Code::BadArgument);
    fleet.set(&camera(), POSES, 0, 4, 1).unwrap();
    let (share, _) = Sealer::share(&Hash::ZERO, "Org2/OptiTrack", &readers(&fleet, POSES)).unwrap();
    let refused = share_as(&mut fleet, &camera(), (POSES, 0), &share).unwrap_err();
    assert!(refused.code == Code::BadArgument && refused.message.contains("not confidential"), "{refused}");
}

#[test]
fn a_share_that_leaves_out_the_owner_or_adds_a_stranger_is_refused() {
    let (mut fleet, admin) = fleet();
    let salma = Person::new(member("Salma", 71));
    salma.enter(&mut fleet, POSES).unwrap();
    let all = readers(&fleet, POSES);
    assert_eq!(
        all.readers.iter().map(|reader| reader.reader.as_str()).collect::<Vec<_>>(),
        ["Org1/Salma", "Org2/admin"]
    );
    let (good, _) = Sealer::share(&Hash::ZERO, "Org2/OptiTrack", &all).unwrap();
    let refused = |fleet: &mut Fleet, share: &Share, code: Code| {
        let refused = share_as(fleet, &camera(), (POSES, 0), share).unwrap_err();
        assert_eq!(refused.code, code, "{refused}");
        refused
    };
    let without = |at: usize| Share { readers: vec![good.readers[at].clone()] };
    let told = refused(&mut fleet, &without(0), Code::ReadersChanged);
    assert_eq!((told.found.as_str(), told.wanted.as_str()), ("\"Org1/Salma\"", "Org1/Salma, Org2/admin"));
    refused(&mut fleet, &without(1), Code::ReadersChanged);
    refused(&mut fleet, &Share::default(), Code::ReadersChanged);
    let mut more = good.clone();
    more.readers.push(more.readers[1].clone());
    refused(&mut fleet, &more, Code::ReadersChanged);
    let mut other_key = good.clone();
    other_key.readers[0].key = Person::new(farhad()).keyring.public_hex();
    refused(&mut fleet, &other_key, Code::ReadersChanged);
    for bad in ["", "zz", &"0".repeat(159), &"A".repeat(160), &"0".repeat(60_000)] {
        let mut broken = good.clone();
        broken.readers[1].wrapped = bad.to_owned();
        refused(&mut fleet, &broken, Code::BadArgument);
    }
    let many = Share { readers: vec![good.readers[0].clone(); 10_000] };
    refused(&mut fleet, &many, Code::BadArgument);
    // Without anybody of the owner there is no share at all.
    fleet.ok(&owner(), "reader", &[POSES, "none"]);
    let (alone, _) = Sealer::share(&Hash::ZERO, "Org2/OptiTrack", &readers(&fleet, POSES)).unwrap();
    let told = refused(&mut fleet, &alone, Code::ReadersChanged);
    assert!(told.advice().contains("ledgerctl readers OptiTrack/poses --enter"), "{told}");
    admin.enter(&mut fleet, POSES).unwrap();
    share(&mut fleet, &camera(), POSES, 0).unwrap();
}

#[test]
fn only_who_may_publish_shares_and_once_in_a_block() {
    let (mut fleet, _admin) = fleet();
    let (given, _) = Sealer::share(&Hash::ZERO, "Org1/Salma", &readers(&fleet, TURTLEBOT)).unwrap();
    for (who, epoch, code) in
        [(salma(), 1, Code::NotHolder), (salma(), 0, Code::NotHolder), (admin1(), 0, Code::MissingAttribute)]
    {
        assert_eq!(share_as(&mut fleet, &who, (TURTLEBOT, epoch), &given).unwrap_err().code, code, "{}", who.id());
    }
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    share_as(&mut fleet, &salma(), (TURTLEBOT, 1), &given).unwrap();
    fleet.joins = true;
    assert_eq!(share_as(&mut fleet, &salma(), (TURTLEBOT, 1), &given).unwrap_err().code, Code::LimitExceeded);
    let keyed = share_as(&mut fleet, &salma(), (TURTLEBOT, 1), &given).unwrap();
    assert_eq!((keyed.key, keyed.readers, keyed.until), (fleet.height, 1, fleet.time + HOUR));
    assert_eq!(fleet.newest::<Keyed>("keyed"), keyed);
    assert_eq!(readers(&fleet, TURTLEBOT).keys[0].key, keyed.key);
}

#[test]
fn a_key_from_before_a_change_of_readers_policies_or_the_robot_is_refused() {
    let (mut fleet, admin) = fleet();
    own_policies(&mut fleet);
    let (reader, other) = (Person::new(member("Salma", 71)), Person::new(member("Third", 72)));
    reader.enter(&mut fleet, POSES).unwrap();
    let mut seq = 0;
    let mut stale = |fleet: &mut Fleet, why: &str, change: &mut dyn FnMut(&mut Fleet)| {
        let (sealer, _) = share(fleet, &camera(), POSES, 0).unwrap();
        seq += 10;
        send(fleet, &camera(), &sealer, (POSES, 0, seq)).unwrap();
        change(fleet);
        let refused = send(fleet, &camera(), &sealer, (POSES, 0, seq + 1)).unwrap_err();
        assert_eq!(refused.code, Code::ReadersChanged, "{why}: {refused}");
        assert!(refused.advice().contains("share a new content key"), "{refused}");
    };
    stale(&mut fleet, "one is taken out", &mut |fleet| {
        other.enter(fleet, POSES).unwrap();
        fleet.ok(&owner(), "reader", &[POSES, "none", "Org1/Third"]);
    });
    stale(&mut fleet, "one is revoked", &mut |fleet| fleet.revoke(&reader.identity));
    reader.enter(&mut fleet, POSES).unwrap();
    stale(&mut fleet, "its authority is lost", &mut |fleet| fleet.lose_authority(&reader.identity));
    stale(&mut fleet, "policies", &mut |fleet| {
        fleet.ok(
            &owner(),
            "policy",
            &["put", "p", "forbid (principal, action, resource) when { principal.name == \"X\" };"],
        );
    });
    stale(&mut fleet, "the robot", &mut |fleet| {
        fleet.ok(&owner(), "configure", &["OptiTrack", r#"{"attribute_required":"level"}"#])
    });
    stale(&mut fleet, "an hour", &mut |fleet| fleet.time += HOUR);
    stale(&mut fleet, "a newer key", &mut |fleet| drop(share(fleet, &camera(), POSES, 0).unwrap()));
    admin.enter(&mut fleet, TURTLEBOT).unwrap();
    let (sealer, _) = share(&mut fleet, &camera(), POSES, 0).unwrap();
    send(&mut fleet, &camera(), &sealer, (POSES, 0, 1000)).unwrap();
}

#[test]
fn whoever_comes_and_goes_all_the_time_keeps_no_publisher_from_the_others() {
    let (mut fleet, _admin) = fleet();
    let reader = Person::new(member("Salma", 71));
    let (sealer, _) = share(&mut fleet, &camera(), POSES, 0).unwrap();
    for round in 0..50 {
        reader.enter(&mut fleet, POSES).unwrap();
        send(&mut fleet, &camera(), &sealer, (POSES, 0, 2 * round)).unwrap();
        fleet.ok(&reader.identity, "reader", &[POSES, "none"]);
        send(&mut fleet, &camera(), &sealer, (POSES, 0, 2 * round + 1)).unwrap();
    }
    fleet.time += 2 * SECOND;
    let refused = send(&mut fleet, &camera(), &sealer, (POSES, 0, 1000)).unwrap_err();
    assert!(refused.code == Code::ReadersChanged && refused.found.contains("a change of readers 2 s ago"), "{refused}");
    let (sealer, _) = share(&mut fleet, &camera(), POSES, 0).unwrap();
    fleet.time += 10 * SECOND;
    send(&mut fleet, &camera(), &sealer, (POSES, 0, 1000)).unwrap();
}

#[test]
fn a_reader_that_goes_and_is_revoked_reads_nothing_more() {
    for how in ["the certificate", "the authority", "the organisation"] {
        let (mut fleet, _admin) = fleet();
        let reader = Person::new(member("Salma", 71));
        reader.enter(&mut fleet, POSES).unwrap();
        let (sealer, _) = share(&mut fleet, &camera(), POSES, 0).unwrap();
        fleet.ok(&reader.identity, "reader", &[POSES, "none"]);
        send(&mut fleet, &camera(), &sealer, (POSES, 0, 1)).unwrap();
        match how {
            "the certificate" => fleet.revoke(&reader.identity),
            "the authority" => fleet.lose_authority(&reader.identity),
            _ => fleet.remove_organisation("Org1"),
        }
        // Somebody else that comes does not bring the grace back.
        Person::new(owner()).enter(&mut fleet, POSES).unwrap();
        let refused = send(&mut fleet, &camera(), &sealer, (POSES, 0, 2)).unwrap_err();
        assert_eq!(refused.code, Code::ReadersChanged, "{how}: {refused}");
        assert!(refused.found.contains("and a revocation"), "{how}: {refused}");
        let (sealer, _) = share(&mut fleet, &camera(), POSES, 0).unwrap();
        send(&mut fleet, &camera(), &sealer, (POSES, 0, 2)).unwrap();
    }
}

#[test]
fn a_key_of_another_publisher_or_service_is_not_good() {
    let (mut fleet, _admin) = fleet();
    let (of_poses, _) = share(&mut fleet, &camera(), POSES, 0).unwrap();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let refused = send(&mut fleet, &salma(), &of_poses, (TURTLEBOT, 1, 1)).unwrap_err();
    assert_eq!(refused.code, Code::ReadersChanged, "{refused}");
}

#[test]
fn whoever_loses_the_place_of_a_subscriber_gets_no_later_message() {
    let (mut fleet, mut admin) = fleet();
    fleet.ok(&owner(), "configure", &[POSES, r#"{"mode":"limited","sharing":{"subscribers":1}}"#]);
    let mut reader = Person::new(member("Salma", 71));
    assert_eq!(reader.enter(&mut fleet, POSES).unwrap_err().code, Code::NotHolder);
    fleet.ok(&reader.identity, "acquire", &["OptiTrack/poses:subscribe"]);
    reader.enter(&mut fleet, POSES).unwrap();
    let (sealer, shared) = share(&mut fleet, &camera(), POSES, 0).unwrap();
    let before = send(&mut fleet, &camera(), &sealer, (POSES, 0, 1)).unwrap();
    let learn = |person: &mut Person, sealer: &Sealer, shared: &Share| {
        person.keyring.learn(POSES, "Org2/OptiTrack", sealer.key(), shared)
    };
    assert!(learn(&mut reader, &sealer, &shared));
    fleet.ok(&reader.identity, "release", &["OptiTrack/poses:subscribe"]);
    fleet.time += 2 * SECOND;
    assert_eq!(send(&mut fleet, &camera(), &sealer, (POSES, 0, 2)).unwrap_err().code, Code::ReadersChanged);
    let (sealer, shared) = share(&mut fleet, &camera(), POSES, 0).unwrap();
    let after = send(&mut fleet, &camera(), &sealer, (POSES, 0, 3)).unwrap();
    assert!(!learn(&mut reader, &sealer, &shared) && learn(&mut admin, &sealer, &shared));
    let open = |person: &Person, seq: u64, sealed: &Bytes| person.keyring.open(POSES, "Org2/OptiTrack", 0, seq, sealed);
    assert!(open(&reader, 1, &before).is_ok());
    assert_eq!(open(&reader, 3, &after), Err(Unreadable::NoKey(sealer.key())));
    assert!(open(&admin, 3, &after).is_ok());
}

#[test]
fn a_place_that_the_owner_takes_back_ends_the_key_at_once() {
    let (mut fleet, _admin) = fleet();
    fleet.ok(&owner(), "configure", &[POSES, r#"{"mode":"limited","sharing":{"subscribers":1}}"#]);
    let reader = Person::new(member("Salma", 71));
    for (by, is_good) in [(&reader.identity, true), (&owner(), false)] {
        fleet.ok(&reader.identity, "acquire", &["OptiTrack/poses:subscribe"]);
        reader.enter(&mut fleet, POSES).unwrap();
        let (sealer, _) = share(&mut fleet, &camera(), POSES, 0).unwrap();
        fleet.ok(by, "release", &["OptiTrack/poses:subscribe", "Org1/Salma"]);
        let height = fleet.height;
        let sent = send(&mut fleet, &camera(), &sealer, (POSES, 0, height));
        assert_eq!(
            sent.map(drop).map_err(|refused| refused.code),
            if is_good { Ok(()) } else { Err(Code::ReadersChanged) }
        );
    }
}

#[test]
fn who_may_not_subscribe_enters_not_and_the_owner_always_may() {
    let (mut fleet, _admin) = fleet();
    assert_eq!(Person::new(farhad()).enter(&mut fleet, POSES).unwrap_err().code, Code::MissingAttribute);
    own_policies(&mut fleet);
    fleet.ok(&owner(), "policy", &["put", "none", "forbid (principal, action == Action::\"subscribe\", resource);"]);
    assert_eq!(Person::new(member("Salma", 71)).enter(&mut fleet, POSES).unwrap_err().code, Code::DeniedByPolicy);
    for (name, role, serial) in [("admin9", Role::Admin, 81), ("node1", Role::Node, 82), ("OptiTrack", Role::Robot, 83)]
    {
        Person::new(identity("Org2", name, role, &[], serial)).enter(&mut fleet, POSES).unwrap();
    }
    let member_of_owner = Person::new(identity("Org2", "guest", Role::Member, &["OptiTrack"], 84));
    assert_eq!(member_of_owner.enter(&mut fleet, POSES).unwrap_err().code, Code::DeniedByPolicy);
    share(&mut fleet, &camera(), POSES, 0).unwrap();
    assert_eq!(fleet.newest::<Keyed>("keyed").readers, 4);
}

#[test]
fn readers_leave_by_themselves_or_by_an_admin_of_the_owner() {
    let (mut fleet, _admin) = fleet();
    let reader = Person::new(member("Salma", 71));
    reader.enter(&mut fleet, POSES).unwrap();
    let entered = ReaderTold { service: POSES.into(), reader: "Org1/Salma".into(), change: "entered".into() };
    assert_eq!(fleet.newest::<ReaderTold>("reader"), entered);
    for who in [admin1(), farhad(), camera()] {
        fleet.refused(&who, Code::NotOwner, "reader", &[POSES, "none", "Org1/Salma"]);
    }
    let key = reader.keyring.public_hex();
    fleet.refused(&owner(), Code::NotOwner, "reader", &[POSES, &key, "Org1/Salma"]);
    let left: ReaderTold = fleet.get(&owner(), "reader", &[POSES, "none", "Org1/Salma"]);
    assert_eq!(left.change, "left");
    fleet.refused(&owner(), Code::NotFound, "reader", &[POSES, "none", "Org1/Salma"]);
    for bad in ["", "NONE", "00", &"g".repeat(64), &key.to_uppercase()] {
        fleet.refused(&reader.identity, Code::BadArgument, "reader", &[POSES, bad]);
    }
}

#[test]
fn readers_are_bounded_and_leave_with_their_certificates() {
    let (mut fleet, _admin) = fleet();
    for serial in 1..u8::try_from(READERS_MAX).unwrap() {
        let mut identity = member(&format!("Reader{serial:02}"), 100 + serial);
        identity.not_after = START + HOUR;
        Person::new(identity).enter(&mut fleet, POSES).unwrap();
    }
    let late = Person::new(member("Late", 71));
    let refused = late.enter(&mut fleet, POSES).unwrap_err();
    assert!(refused.code == Code::LimitExceeded && refused.advice().contains("--remove"), "{refused}");
    share(&mut fleet, &camera(), POSES, 0).unwrap();
    assert_eq!(fleet.newest::<Keyed>("keyed").until, START + HOUR, "no certificate ends before the key");
    fleet.time = START + HOUR;
    share(&mut fleet, &camera(), POSES, 0).unwrap();
    assert_eq!(fleet.newest::<Keyed>("keyed").readers, 1, "a certificate that has ended gets no key");
    late.enter(&mut fleet, POSES).unwrap();
    assert_eq!((readers(&fleet, POSES).readers.len(), fleet.keys("reading/")), (2, 3));
    fleet.remove_organisation("Org1");
    assert_eq!(readers(&fleet, POSES).readers.len(), 1);
    fleet.ok(&owner(), "remove", &["OptiTrack"]);
    assert_eq!((fleet.keys("reader/OptiTrack"), fleet.keys("reading/")), (0, 1), "the admin still reads the Turtlebot");
}

#[test]
fn calls_are_not_confidential_and_messages_of_every_mode_may_be() {
    let mut fleet = Fleet::of_the_paper();
    let arm = |kind: &str| {
        format!(
            r#"{{"name":"Arm","attribute_required":"Arm","trusted":["Org1","Org2"],"services":[{{"topic":"/home","type":"{kind}","sharing":{{"confidential":true}}}}]}}"#
        )
    };
    for kind in ["std_srvs/srv/Trigger", "nav2_msgs/action/NavigateToPose"] {
        let refused = fleet.refused(&owner(), Code::BadArgument, "setup", &[&arm(kind)]);
        assert!(refused.message.contains("cannot be confidential"), "{refused}");
    }
    fleet.ok(&owner(), "setup", &[&arm("std_msgs/msg/Empty")]);
    for settings in [
        r#"{"mode":"open"}"#,
        r#"{"mode":"limited","sharing":{"publishers":2}}"#,
        r#"{"mode":"exclusive","sharing":{"publishers":null},"clear":["publishers"]}"#,
    ] {
        let change: RobotChange = fleet.get(&owner(), "configure", &["Arm/home", settings]);
        assert!(change.robot.services[0].sharing.is_confidential(), "{settings}");
    }
    let change: RobotChange = fleet.get(&owner(), "configure", &["Arm/home", r#"{"sharing":{"confidential":false}}"#]);
    assert_eq!((change.changed[0].before.as_str(), change.changed[0].after.as_str()), ("true", "false"));
}
