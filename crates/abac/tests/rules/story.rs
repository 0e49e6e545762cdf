//! The story of the stored chains: calls of every chaincode, allowed and refused, and blocks that are none.

use crate::chain::Chain;
use crate::contests::contests;
use crate::teller::{SECOND, Teller, Who};
use bytes::Bytes;
use ledger::members::{Change, MembershipChange};
use ledger_abac::DEFAULT_POLICY;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code::{self, Ok};
use ledger_identity::certificate::Certificate;
use ledger_storage::entry::EntryKind;
use serde_json::json;

pub(crate) const BOSS: Who = |teller| &teller.boss;
pub(crate) const OWNER: Who = |teller| &teller.owner;
pub(crate) const SALMA: Who = |teller| &teller.salma;
pub(crate) const FARHAD: Who = |teller| &teller.farhad;
const CAMERA: Who = |teller| &teller.camera;
pub(crate) const NODE1: Who = |teller| &teller.node1;
const NODE2: Who = |teller| &teller.node2;
const NODE3: Who = |teller| &teller.node3;
const STRANGER: Who = |teller| &teller.stranger;

pub(crate) const COMMANDS: &str = "Turtlebot4/cmd_vel";
/// CDR of nothing in particular.
pub(crate) const MESSAGE: &str = "\0\u{1}\0\0message";

/// The whole story: it begins under these rules, and goes on under the next ones.
pub(crate) fn tell(rules: u32) -> Chain {
    let mut teller = Teller::new(rules);
    // What a new leader begins with.
    teller.entry(EntryKind::Normal, Bytes::new());
    robots(&mut teller);
    leases(&mut teller);
    policies(&mut teller);
    changed_robots(&mut teller);
    forged(&mut teller);
    activation(&mut teller, rules + 1);
    contests(&mut teller);
    nodes(&mut teller);
    identities(&mut teller);
    organisations(&mut teller);
    teller.finish()
}

fn robot(name: &str, mode: &str) -> String {
    let service = json!({ "topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": mode });
    json!({ "name": name, "attribute_required": name, "trusted": ["Org1", "Org2"], "services": [service] }).to_string()
}

fn robots(teller: &mut Teller) {
    let poses = json!({ "topic": "/poses", "type": "geometry_msgs/msg/PoseStamped", "direction": "feed" });
    let camera = json!({ "name": "OptiTrack", "attribute_required": "OptiTrack", "trusted": ["Org1", "Org2"], "services": [poses] }).to_string();
    let (turtlebot, husky) = (robot("Turtlebot4", "exclusive"), robot("Husky", "open"));
    teller.call(SALMA, Code::NotAdmin, "abac", "setup", &[&turtlebot]);
    teller.call(OWNER, Ok, "abac", "setup", &[&turtlebot, &husky, &camera]);
    teller.call(OWNER, Code::AlreadyExists, "abac", "setup", &[&turtlebot]);
    for (function, args) in [
        ("robots", &[][..]),
        ("robot", &["Husky"]),
        ("service", &["Husky"]),
        ("grants", &[]),
        ("policies", &[]),
        ("authorize", &["Husky", "publish"]),
        ("GetSubmittingClientIdentity", &[]),
    ] {
        teller.read(SALMA, "abac", function, args);
    }
    teller.call(SALMA, Code::UnknownRobot, "abac", "declare", &["Go2"]);
    teller.call(CAMERA, Ok, "abac", "set", &["OptiTrack", "0", "1", MESSAGE, MESSAGE]);
}

fn leases(teller: &mut Teller) {
    let epoch = teller.call(SALMA, Ok, "abac", "acquire", &["Turtlebot4", "20000"])["epoch"].to_string();
    let set = |teller: &mut Teller, by: Who, epoch: &str, seq: &str| {
        teller.signed(by, "abac", "set", &[COMMANDS, epoch, seq, MESSAGE])
    };
    let block = vec![
        teller.signed(FARHAD, "abac", "acquire", &["Turtlebot4"]),
        set(teller, SALMA, &epoch, "1"),
        set(teller, SALMA, &epoch, "2"),
        set(teller, SALMA, &epoch, "2"),
        set(teller, SALMA, "77", "3"),
        set(teller, FARHAD, &epoch, "1"),
        teller.signed(SALMA, "abac", "set", &["Husky", "0", "1", MESSAGE]),
        teller.signed(FARHAD, "abac", "set", &["Husky", "0", "1", MESSAGE]),
    ];
    let codes: Vec<_> = teller.block(block).into_iter().map(|(code, _)| code).collect();
    assert_eq!((codes[0], codes[1], codes[3], codes[7]), (Code::Held, Ok, Code::StaleSequence, Code::MissingAttribute));
    teller.call(SALMA, Ok, "abac", "renew", &["Turtlebot4", "5000"]);
    teller.call(FARHAD, Code::NotHolder, "abac", "release", &["Turtlebot4"]);
    // The lease ends at the beginning of an empty block.
    teller.time += 30 * SECOND;
    teller.block(vec![]);
    let epoch = teller.call(FARHAD, Ok, "abac", "acquire", &["Turtlebot4", "600000"])["epoch"].to_string();
    let first = set(teller, FARHAD, &epoch, "1");
    teller.ends(first, Ok);
    teller.call(FARHAD, Ok, "abac", "release", &["Turtlebot4"]);
    teller.call(SALMA, Ok, "abac", "acquire", &["Turtlebot4", "600000"]);
    teller.call(OWNER, Ok, "abac", "release", &["Turtlebot4", "Org1/Salma"]);
}

fn policies(teller: &mut Teller) {
    teller.call(FARHAD, Ok, "abac", "acquire", &["Turtlebot4", "600000"]);
    let stricter = format!("{DEFAULT_POLICY}\nforbid (principal == User::\"Org1/Farhad\", action, resource);");
    teller.call(SALMA, Code::NotAdmin, "abac", "policy", &["apply", &set(&[("stricter", &stricter)])]);
    teller.call(OWNER, Code::PolicyInvalid, "abac", "policy", &["apply", &set(&[("wrong", "permit (principal")])]);
    // Ends Farhad's grant in the same block.
    teller.call(OWNER, Ok, "abac", "policy", &["apply", &set(&[("stricter", &stricter)])]);
    teller.call(FARHAD, Code::DeniedByPolicy, "abac", "acquire", &["Turtlebot4"]);
    teller.read(SALMA, "abac", "policies", &[]);
    teller.call(OWNER, Ok, "abac", "policy", &["apply", &set(&[])]);
    teller.call(FARHAD, Ok, "abac", "acquire", &["Turtlebot4", "600000"]);
}

/// A whole set of policies.
pub(crate) fn set(policies: &[(&str, &str)]) -> String {
    let policies: Vec<_> = policies.iter().map(|(id, text)| json!({ "id": id, "text": text })).collect();
    json!({ "policies": policies }).to_string()
}

fn changed_robots(teller: &mut Teller) {
    teller.call(OWNER, Ok, "abac", "configure", &["Husky/cmd_vel", r#"{"mode":"exclusive"}"#]);
    teller.call(OWNER, Ok, "abac", "replace", &[&robot("Husky", "open")]);
    teller.call(BOSS, Code::NotOwner, "abac", "remove", &["Husky"]);
    teller.call(OWNER, Ok, "abac", "remove", &["Husky"]);
}

/// Calls that nobody should send, and blocks that are none.
fn forged(teller: &mut Teller) {
    let good = teller.signed(SALMA, "abac", "declare", &["Turtlebot4"]);
    let other_network = {
        let mut body = teller.body(SALMA, "abac", "robots", &[]);
        body.network = Bytes::from_static(&[7; 32]);
        teller.sign(SALMA, &body)
    };
    let late = {
        let mut body = teller.body(SALMA, "abac", "robots", &[]);
        body.not_after = teller.time - SECOND;
        teller.sign(SALMA, &body)
    };
    let early = {
        let mut body = teller.body(SALMA, "abac", "robots", &[]);
        body.not_after = teller.time + 3600 * SECOND;
        teller.sign(SALMA, &body)
    };
    let forged = {
        let mut body = teller.body(SALMA, "abac", "robots", &[]);
        body.creator = Bytes::copy_from_slice(&Hash::of(&[&teller.salma.certificate]).0);
        let other = ledger::transaction::Transaction::sign(&body, &teller.farhad.key).unwrap();
        other.with_certificate(teller.salma.certificate.clone()).unwrap().encoded().clone()
    };
    let block = vec![
        good.clone(),
        good,
        other_network,
        late,
        early,
        forged,
        Bytes::from_static(b"\xff no transaction"),
        teller.signed(STRANGER, "abac", "robots", &[]),
        teller.signed(SALMA, "inventory", "robots", &[]),
        teller.signed(SALMA, "abac", "steal", &[]),
        teller.signed(SALMA, "abac", "declare", &["Turtlebot4", "superfluous"]),
    ];
    let codes: Vec<_> = teller.block(block).into_iter().map(|(code, _)| code).collect();
    let wanted = [
        Ok,
        Code::Duplicate,
        Code::WrongNetwork,
        Code::Expired,
        Code::NotAfterTooFar,
        Code::BadSignature,
        Code::Malformed,
        Code::Untrusted,
        Code::UnknownChaincode,
        Code::UnknownFunction,
        Code::BadArgument,
    ];
    assert_eq!(codes, wanted);
    teller.entry(EntryKind::Normal, Bytes::from_static(b"\xff\xff no payload"));
    teller.entry(EntryKind::ConfChangeV2, Bytes::from_static(b"\xff no change"));
}

/// Both organisations activate the next rules.
fn activation(teller: &mut Teller, number: u32) {
    let speaks = json!({ "newest": number, "release": "0.1.0" }).to_string();
    let activate = json!({ "number": number }).to_string();
    teller.call(BOSS, Code::RulesNotSpoken, "msp", "activate_rules", &[&activate]);
    teller.call(SALMA, Code::WrongRole, "msp", "speak", &[&speaks]);
    teller.call(NODE1, Ok, "msp", "speak", &[&speaks]);
    assert_eq!(teller.call(BOSS, Ok, "msp", "activate_rules", &[&activate])["executed"], false);
    assert_eq!(teller.call(OWNER, Ok, "msp", "activate_rules", &[&activate])["executed"], true);
    teller.read(OWNER, "msp", "rules", &[]);
}

fn nodes(teller: &mut Teller) {
    teller.read(NODE1, "msp", "nodes", &[]);
    teller.call(NODE1, Ok, "msp", "join_node", &[r#"{"address":"10.0.0.1:7450"}"#]);
    teller.call(NODE3, Ok, "msp", "join_node", &[r#"{"address":"10.0.0.3:7450","name":"node3"}"#]);
    let (height, hash) = (teller.height(), Hash::of(&[b"block"]));
    let attest = json!({ "height": height, "hash": hash, "digest": hash }).to_string();
    teller.call(NODE2, Ok, "msp", "attest", &[&attest]);
    teller.call(SALMA, Code::WrongRole, "msp", "attest", &[&attest]);
    teller.read(NODE1, "msp", "attestations", &[]);
    // Another organisation must agree.
    let voter = r#"{"organisation":"Org2","name":"node2","role":"voter"}"#;
    let decision = teller.call(OWNER, Ok, "msp", "set_node_role", &[voter]);
    assert_eq!(decision["executed"], false);
    teller.read(SALMA, "msp", "proposals", &[]);
    let id = decision["proposal"]["id"].as_str().unwrap().to_owned();
    teller.call(SALMA, Code::NotAdmin, "msp", "approve", &[&id]);
    assert_eq!(teller.call(BOSS, Ok, "msp", "approve", &[&id])["executed"], true);
    teller.call(BOSS, Code::NotFound, "msp", "approve", &[&id]);
    let change = MembershipChange::new([Change::AddVoter(2)]).to_bytes();
    teller.entry(EntryKind::ConfChangeV2, change);
    let promote = r#"{"organisation":"Org2","name":"node3","role":"voter"}"#;
    let late = teller.call(BOSS, Ok, "msp", "set_node_role", &[promote]);
    let removed = r#"{"organisation":"Org2","name":"node3","role":"removed"}"#;
    assert_eq!(teller.call(OWNER, Ok, "msp", "set_node_role", &[removed])["executed"], true);
    let decision = teller.call(OWNER, Ok, "msp", "approve", &[late["proposal"]["id"].as_str().unwrap()]);
    assert_eq!(decision["proposal"]["failed"]["code"], Code::NotAMember.number());
    quorums(teller);
    teller.read(NODE1, "msp", "nodes", &[]);
}

fn quorums(teller: &mut Teller) {
    teller.read(SALMA, "msp", "quorums", &[]);
    let call = |function: &str, argument: &str| {
        json!({ "chaincode": "msp", "function": function, "args": [hex::encode(argument)] }).to_string()
    };
    teller.call(BOSS, Code::BadArgument, "msp", "propose", &[&call("approve", "00000000")]);
    let set = |quorum| json!({ "chaincode": "msp", "function": "set_node_role", "quorum": quorum }).to_string();
    let admins = call("set_quorum", &set("admins of Org1 = 1"));
    assert_eq!(teller.call(OWNER, Ok, "msp", "propose", &[&admins])["missing"], 1);
    assert_eq!(teller.call(BOSS, Ok, "msp", "propose", &[&admins])["executed"], true);
    // Now an admin of Org1 decides alone.
    let all = teller.call(BOSS, Ok, "msp", "set_quorum", &[&set("organisations = all")]);
    assert_eq!(all["executed"], true);
}

fn identities(teller: &mut Teller) {
    let expires = teller.time + 3600 * SECOND;
    let register = json!({ "name": "Nadia", "role": "member", "attributes": { "Husky": "true" },
        "secret": Hash::of(&[b"secret"]), "expires": expires });
    teller.call(BOSS, Ok, "msp", "register", &[&register.to_string()]);
    teller.call(BOSS, Code::AlreadyRegistered, "msp", "register", &[&register.to_string()]);
    for (name, code) in [("Nad\u{456}a", Code::BadName), ("Noel", Ok), ("Noe1", Code::AlreadyRegistered)] {
        let mut alike = register.clone();
        alike["name"] = name.into();
        teller.call(BOSS, code, "msp", "register", &[&alike.to_string()]);
    }
    teller.read(BOSS, "msp", "identities", &["{}"]);
    teller.call(BOSS, Ok, "msp", "cancel_registration", &[r#"{"name":"Nadia"}"#]);
    // Farhad still holds the Turtlebot4: his grant ends in this block.
    teller.read(FARHAD, "abac", "GetSubmittingClientIdentity", &[]);
    let certificate = Certificate::parse(&teller.farhad.certificate).unwrap();
    let issuer = certificate.issuer_name.hash().to_string();
    let serial = hex::encode(&certificate.serial);
    teller.call(OWNER, Code::NotAdmin, "msp", "revoke", &[&issuer, &serial]);
    teller.call(BOSS, Ok, "msp", "revoke", &[&issuer, &serial, "left"]);
    teller.call(FARHAD, Code::Revoked, "abac", "robots", &[]);
    teller.read(SALMA, "msp", "revocations", &[]);
}

fn organisations(teller: &mut Teller) {
    teller.read(SALMA, "msp", "organisations", &[]);
    teller.read(SALMA, "msp", "organisation", &["Org2"]);
    let expires = teller.time + 3600 * SECOND;
    let invite = json!({ "name": "Org3", "key": Hash::of(&[b"key"]), "expires": expires }).to_string();
    let id = teller.call(BOSS, Ok, "msp", "invite_organisation", &[&invite])["proposal"]["id"].clone();
    teller.call(BOSS, Ok, "msp", "withdraw", &[id.as_str().unwrap()]);
    teller.call(BOSS, Ok, "msp", "invite_organisation", &[&invite]);
    // The same action is an approval.
    assert_eq!(teller.call(OWNER, Ok, "msp", "invite_organisation", &[&invite])["executed"], true);
    teller.read(SALMA, "msp", "invitations", &[]);
    teller.call(BOSS, Ok, "msp", "cancel_invitation", &[r#"{"name":"Org3"}"#]);
    teller.call(SALMA, Ok, "abac", "acquire", &["Turtlebot4", "600000"]);
    let remove = r#"{"name":"Org1"}"#;
    teller.call(BOSS, Code::NotFound, "msp", "set_node_role", &[r#"{"id":99,"role":"removed"}"#]);
    assert_eq!(teller.call(BOSS, Ok, "msp", "remove_organisation", &[remove])["executed"], false);
    // Ends Salma's grant, and what Org1 is trusted with.
    assert_eq!(teller.call(OWNER, Ok, "msp", "remove_organisation", &[remove])["executed"], true);
    teller.call(SALMA, Code::Untrusted, "abac", "robots", &[]);
    teller.read(OWNER, "msp", "organisations", &[]);
}
