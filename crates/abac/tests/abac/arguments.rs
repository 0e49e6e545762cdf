//! Every function against arguments it cannot use.

use crate::fleet::{Fleet, TURTLEBOT, bytes, owner};
use bytes::Bytes;
use ledger_base::rejection::{Class, Code};

pub(crate) const FUNCTIONS: [&str; 18] = [
    "GetSubmittingClientIdentity",
    "acquire",
    "authorize",
    "configure",
    "declare",
    "grants",
    "latest",
    "policies",
    "policy",
    "release",
    "remove",
    "renew",
    "replace",
    "robot",
    "robots",
    "service",
    "set",
    "setup",
];

#[test]
fn too_many_arguments_and_too_few_are_refused_with_the_usage() {
    let mut fleet = Fleet::of_the_paper();
    for function in FUNCTIONS {
        let many = vec![Bytes::from_static(b"x"); 2000];
        let refusal = fleet.call(&owner(), function, &many).unwrap_err();
        assert_eq!(refusal.code, Code::BadArgument, "{function}: {refusal}");
        assert!(refusal.advice().starts_with(&format!("call it as: {function}")), "{function}: {refusal}");
    }
    for function in ["acquire", "authorize", "policy", "release", "remove", "renew", "robot", "service", "set", "setup"]
    {
        let refusal = fleet.call(&owner(), function, &[]).unwrap_err();
        assert_eq!(refusal.code, Code::BadArgument, "{function}: {refusal}");
    }
}

#[test]
fn garbage_in_any_place_is_invalid_input_and_never_a_panic() {
    let mut fleet = Fleet::of_the_paper();
    let garbage: [Bytes; 6] = [
        Bytes::new(),
        Bytes::from_static(b"\xff\xfe\x00"),
        Bytes::from_static(b"Turtlebot4\0/cmd_vel"),
        Bytes::from("\u{202e}\u{0}🦀".repeat(10)),
        Bytes::from(vec![b'['; 100_000]),
        Bytes::from(vec![b'a'; 1_000_000]),
    ];
    for function in FUNCTIONS {
        for bad in &garbage {
            for count in 1..=5 {
                if let Err(refusal) = fleet.call(&owner(), function, &vec![bad.clone(); count]) {
                    assert_eq!(refusal.code.class(), Class::Invalid, "{function} {refusal}");
                    assert!(refusal.to_string().len() < 4096, "{function}: too long a message");
                } else {
                    panic!("{function} accepted garbage");
                }
            }
        }
    }
}

#[test]
fn numbers_are_plain_decimal() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "policy", &["put", "all", "permit (principal, action, resource);"]);
    fleet.ok(&owner(), "acquire", &[TURTLEBOT]);
    for number in ["", "-1", "+1", "1.0", "0x1", " 1", "１", "18446744073709551616", "one"] {
        let cases = [
            ("acquire", vec![TURTLEBOT, number]),
            ("renew", vec![TURTLEBOT, number]),
            ("set", vec![TURTLEBOT, number, "1", "\0\u{1}\0\0"]),
            ("set", vec![TURTLEBOT, "1", number, "\0\u{1}\0\0"]),
        ];
        for (function, args) in cases {
            let refusal = fleet.call(&owner(), function, &bytes(&args)).unwrap_err();
            assert_eq!(refusal.code, Code::BadArgument, "{function} {number}: {refusal}");
        }
    }
    fleet.ok(&owner(), "set", &[TURTLEBOT, "1", "1", "\0\u{1}\0\0"]);
}

#[test]
fn an_unknown_action_is_answered_with_the_known_ones() {
    let mut fleet = Fleet::of_the_paper();
    let refusal = fleet.refused(&owner(), Code::BadArgument, "authorize", &[TURTLEBOT, "publsh"]);
    assert_eq!(refusal.wanted, "acquire, publish or subscribe");
    assert_eq!(refusal.advice(), r#"did you mean "publish"?"#);
}
