use crate::world::{Network, code, failed, is_executed, json, waiting};
use bytes::Bytes;
use ledger::block::Payload;
use ledger::msp::{MspChaincode, NodeRecord, RulesOverview, Speaks};
use ledger::{Activation, Chaincode, Context, Page, Rules};
use ledger_base::rejection::Code;
use ledger_base::rejection::Rejection;
use ledger_identity::key::KeyKind;
use ledger_storage::entry::{Entry, EntryKind};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// The number that is activated.
const NEXT: u32 = Rules::OF_TESTS.number();

fn speaks(newest: u32) -> String {
    format!(r#"{{"newest":{newest},"release":"9.0.0"}}"#)
}

fn activate(number: u32) -> String {
    format!(r#"{{"number":{number}}}"#)
}

fn overview(network: &Network) -> RulesOverview {
    network.query("rules", &[])
}

/// Three organisations whose nodes vote.
fn old() -> Network {
    Network::new(3, 3)
}

/// The next block, which is empty.
fn next(network: &Network) -> Entry {
    let data = Payload { time: network.time, transactions: Vec::new() }.to_bytes();
    Entry { index: network.ledger.tip().height + 1, term: 1, kind: EntryKind::Normal, data }
}

#[test]
fn rules_are_activated_when_every_voter_speaks_them_and_more_than_half_of_the_organisations_approve() {
    let mut network = old();
    assert_eq!(code(&network.admin(1, "activate_rules", &[&activate(NEXT)])), Code::RulesNotSpoken);
    for node in [1, 2] {
        network.node(node, "speak", &[&speaks(NEXT)]).unwrap();
    }
    let refused = network.admin(1, "activate_rules", &[&activate(NEXT)]).unwrap_err();
    assert!(refused.code == Code::RulesNotSpoken && refused.found == "Org3/node3 (up to 1)", "{refused}");
    network.node(3, "speak", &[&speaks(NEXT)]).unwrap();
    let id = waiting(network.admin(1, "activate_rules", &[&activate(NEXT)]));
    assert_eq!((overview(&network).active, network.ledger.rules()), (1, Rules::FIRST));
    assert!(is_executed(network.admin(2, "approve", &[&id])));
    let height = network.ledger.tip().height;
    let shown = overview(&network);
    assert_eq!((shown.active, shown.pending), (NEXT, None), "from the next block on");
    assert_eq!(shown.activations, [Activation { number: NEXT, height: height + 1 }]);
    assert_eq!(network.ledger.rules(), Rules::OF_TESTS);
    assert_eq!(network.event_names(), ["approved", "rules_activated", "executed"]);
    let again = network.admin(1, "activate_rules", &[&activate(NEXT)]);
    assert_eq!(code(&again), Code::BadArgument, "they are in force");
}

#[test]
fn a_voter_that_takes_its_word_back_before_the_last_approval_keeps_the_rules_as_they_are() {
    let mut network = old();
    for node in [1, 2, 3] {
        network.node(node, "speak", &[&speaks(NEXT)]).unwrap();
    }
    let id = waiting(network.admin(1, "activate_rules", &[&activate(NEXT)]));
    network.node(3, "speak", &[&speaks(NEXT - 1)]).unwrap();
    assert_eq!(failed(network.admin(2, "approve", &[&id])), Code::RulesNotSpoken);
    assert_eq!((overview(&network).active, overview(&network).pending), (1, None));
    network.node(3, "speak", &[&speaks(NEXT)]).unwrap();
    let id = waiting(network.admin(1, "activate_rules", &[&activate(NEXT)]));
    assert!(is_executed(network.admin(2, "approve", &[&id])));
}

#[test]
fn rules_for_a_later_block_wait_for_it_and_nobody_becomes_a_voter_who_does_not_speak_them() {
    let mut network = Network::new(1, 1);
    network.node(1, "speak", &[&speaks(NEXT)]).unwrap();
    let edge = network.cas[0].user("edge", "node", KeyKind::Ed25519);
    network.call(&edge, "join_node", &[r#"{"address":"edge:7450"}"#]).unwrap();
    let height = network.ledger.tip().height + 6;
    let wish = format!(r#"{{"number":{NEXT},"height":{height}}}"#);
    assert!(is_executed(network.admin(1, "activate_rules", &[&wish])));
    let pending = Some(Activation { number: NEXT, height });
    assert_eq!((overview(&network).active, overview(&network).pending), (1, pending));
    assert_eq!(network.ledger.pending_rules(), pending);
    assert_eq!(code(&network.admin(1, "activate_rules", &[&activate(NEXT + 1)])), Code::AlreadyExists);
    let voter = r#"{"id":2,"role":"voter"}"#;
    assert_eq!(code(&network.admin(1, "set_node_role", &[voter])), Code::RulesNotSpoken);
    network.call(&edge, "speak", &[&speaks(NEXT)]).unwrap();
    assert!(is_executed(network.admin(1, "set_node_role", &[voter])));
    while network.ledger.tip().height + 1 < height {
        assert_eq!(network.ledger.rules(), Rules::FIRST);
        network.block(&[]);
    }
    assert_eq!(network.ledger.rules(), Rules::OF_TESTS);
    assert_eq!((overview(&network).active, overview(&network).pending), (NEXT, None));
}

#[test]
fn a_node_that_does_not_speak_the_rules_of_the_next_block_stops_and_says_which_release_does() {
    let mut network = Network::new(1, 1);
    let unknown = Rules::OF_TESTS.number() + 1;
    network.node(1, "speak", &[&speaks(unknown)]).unwrap();
    assert!(is_executed(network.admin(1, "activate_rules", &[&activate(unknown)])));
    let height = network.ledger.tip().height;
    let refused = network.ledger.apply(&next(&network)).unwrap_err();
    assert_eq!(refused.code, Code::UnknownRules);
    assert_eq!(refused.found, format!("rules {unknown} from block {} on", height + 1));
    assert_eq!(refused.wanted, Rules::OF_TESTS.and_older());
    assert!(refused.advice().contains("ledgerd 9.0.0, which Org1/node1 runs"), "{refused}");
    assert_eq!(network.ledger.tip().height, height, "nothing was executed");
    let again = network.open_again();
    assert_eq!(again.err().map(|reason| reason.code), Some(Code::UnknownRules), "nor does it start");
}

#[test]
fn a_ledger_that_speaks_less_goes_on_under_the_rules_that_it_speaks_and_stops_before_others() {
    let mut network = Network::new(1, 1);
    let old = network.open_older(Rules::FIRST);
    network.node(1, "speak", &[&speaks(NEXT)]).unwrap();
    let height = network.ledger.tip().height + 4;
    let wish = format!(r#"{{"number":{NEXT},"height":{height}}}"#);
    assert!(is_executed(network.admin(1, "activate_rules", &[&wish])));
    while network.ledger.tip().height < height {
        network.block(&[]);
    }
    for block in &network.blocks {
        let Err(refused) = old.apply(block) else { continue };
        assert_eq!((refused.code, refused.wanted.as_str()), (Code::UnknownRules, "rules 1"));
        assert!(refused.advice().contains("ledgerd 9.0.0, which Org1/node1 runs"), "{refused}");
    }
    assert_eq!(old.tip().height, height - 1);
}

/// By height, the rules that a chaincode of a node saw.
#[derive(Clone, Default)]
struct Seen(Arc<Mutex<BTreeMap<u64, u32>>>);

impl Chaincode for Seen {
    fn name(&self) -> &'static str {
        "seen"
    }

    fn invoke(&self, _: &mut Context<'_>, _: &str, _: &[Bytes]) -> Result<Bytes, Rejection> {
        Ok(Bytes::new())
    }

    fn begin_block(&self, ctx: &mut Context<'_>) {
        let before = self.0.lock().unwrap().insert(ctx.height(), ctx.rules().number());
        assert!(before.is_none_or(|before| before == ctx.rules().number()), "executed again by other rules");
    }
}

#[test]
fn every_node_executes_every_block_by_the_rules_of_its_height_whenever_it_starts_again() {
    for ahead in 1..6 {
        let mut network = Network::new(1, 1);
        network.node(1, "speak", &[&speaks(NEXT)]).unwrap();
        let height = network.ledger.tip().height + ahead;
        let wish = format!(r#"{{"number":{NEXT},"height":{height}}}"#);
        assert!(is_executed(network.admin(1, "activate_rules", &[&wish])));
        let height = network.ledger.pending_rules().map_or(network.ledger.tip().height + 1, |pending| pending.height);
        while network.ledger.tip().height < height + 3 {
            network.block(&[]);
        }
        // A node that starts again after each block: from its state, or from nothing.
        for restart in 0..network.blocks.len() {
            for keeps_its_state in [true, false] {
                let seen = Seen::default();
                let state = Network::no_state();
                let first = network.open_beside(&state, seen.clone());
                network.blocks[..restart].iter().for_each(|block| drop(first.apply(block).unwrap()));
                let state = if keeps_its_state { state } else { Network::no_state() };
                let again = network.open_beside(&state, seen.clone());
                let reached = usize::try_from(again.tip().height).unwrap();
                network.blocks[reached..].iter().for_each(|block| drop(again.apply(block).unwrap()));
                assert_eq!(again.tip(), network.ledger.tip());
                let seen = seen.0.lock().unwrap();
                let wanted =
                    network.blocks.iter().map(|block| (block.index, if block.index < height { 1 } else { NEXT }));
                assert!(
                    seen.iter().map(|(height, number)| (*height, *number)).eq(wanted),
                    "{seen:?}, wanted {NEXT} from {height} on"
                );
            }
        }
    }
}

#[test]
fn only_nodes_say_what_they_speak_and_only_admins_activate() {
    let mut network = old();
    assert_eq!(code(&network.admin(1, "speak", &[&speaks(NEXT)])), Code::WrongRole);
    assert_eq!(code(&network.node(1, "activate_rules", &[&activate(NEXT)])), Code::NotAdmin);
    let stranger = network.cas[0].user("stranger", "node", KeyKind::Ed25519);
    assert_eq!(code(&network.call(&stranger, "speak", &[&speaks(NEXT)])), Code::NotAMember);
    for release in ["", "1 0", &"9".repeat(65)] {
        let wrong = format!(r#"{{"newest":2,"release":"{release}"}}"#);
        assert_eq!(code(&network.node(1, "speak", &[&wrong])), Code::BadArgument, "{release}");
    }
    let record: NodeRecord = json(network.node(1, "speak", &[&speaks(NEXT)]));
    assert_eq!(record.speaks, Some(Speaks { newest: NEXT, release: "9.0.0".into() }));
}

#[test]
fn a_transaction_answers_with_little_and_a_query_with_more() {
    let much = Bytes::from(vec![b'x'; 600 * 1024]);
    let mut network = Network::new(1, 1);
    let member = network.cas[0].user("Salma", "member", KeyKind::Ed25519);
    let call = network.sign_for("listener", &member, "echo", &[&"x".repeat(600 * 1024)]);
    let refused = network.block(&[&call]).remove(0).unwrap_err();
    assert!(refused.code == Code::OverBudget && refused.wanted.contains("524288"), "{refused}");
    let caller = network.ledger.msps().verify(&member.certificate, &[], network.time).unwrap();
    let ask =
        |text: &Bytes| network.ledger.query(&caller, network.time, "listener", "echo", std::slice::from_ref(text));
    assert_eq!(ask(&much).unwrap().0, much);
    let refused = ask(&Bytes::from(vec![b'x'; 1024 * 1024 + 1])).unwrap_err();
    assert!(refused.code == Code::OverBudget && refused.advice().contains("pages"), "{refused}");
}

#[test]
fn a_call_that_goes_on_for_ever_is_stopped_and_the_block_goes_on() {
    let mut network = Network::new(1, 1);
    let [member, other] = ["Salma", "Farhad"].map(|name| network.cas[0].user(name, "member", KeyKind::Ed25519));
    let calls = [(&member, "hog"), (&member, "stare"), (&other, "arm")];
    let calls = calls.map(|(by, function)| network.sign_for("listener", by, function, &[]));
    let outcomes = network.block(&calls.each_ref());
    let codes: Vec<_> = outcomes.iter().map(code).collect();
    assert_eq!(codes, [Code::OverBudget, Code::OverBudget, Code::Ok]);
    let refused = outcomes[0].as_ref().unwrap_err();
    assert!(refused.found.contains("bytes written") && refused.advice().contains("several"), "{refused}");
    assert!(outcomes[1].as_ref().unwrap_err().found.contains("keys read"));
    let admitted = network.sign_for("listener", &member, "hog", &[]);
    let refused = network.ledger.admit(admitted.encoded().clone(), network.time).unwrap_err();
    assert_eq!(refused.rejection.code, Code::OverBudget, "nobody orders it");
}

#[test]
fn functions_of_msp_that_only_read_are_queries_and_no_transactions() {
    let mut network = Network::new(2, 2);
    let admin = network.cas[0].user("Reader", "admin", KeyKind::Ed25519);
    for function in MspChaincode.reads() {
        let args: &[&str] = match *function {
            "organisation" | "quotas" => &["Org1"],
            "identities" | "enrolled" => &["{}"],
            "holder" => &["Org1/Nobody"],
            _ => &[],
        };
        let refused = network.call(&admin, function, args).unwrap_err();
        assert!(refused.code == Code::QueryOnly && refused.advice().contains("ledgerctl query msp"), "{refused}");
        match network.ask(&admin, function, args) {
            Ok(_) => {}
            // Names of all organisations are told to chaincodes only.
            Err(refused) if *function == "enrolled" => assert_eq!(refused.code, Code::BadArgument, "{refused}"),
            Err(refused) => assert_eq!((*function, refused.code), ("holder", Code::NotFound), "{refused}"),
        }
    }
    for function in ["proposals", "revocations"] {
        let page: Page<serde_json::Value> = network.query(function, &["{}"]);
        assert_eq!((page.items.len(), page.next), (0, None));
    }
    let Err(refused) = network.call(&admin, "no_such_function", &[]) else { panic!("it exists") };
    let functions: Vec<_> = refused.wanted.trim_start_matches("one of ").split(", ").map(str::to_owned).collect();
    assert!(functions.len() > 30, "{refused}");
    for function in functions.iter().filter(|function| !MspChaincode.reads().contains(&function.as_str())) {
        assert_ne!(code(&network.call(&admin, function, &["x", "y", "z"])), Code::QueryOnly, "{function}");
    }
}

#[test]
fn a_chaincode_never_refuses_with_a_code_of_a_nodes_own_trouble() {
    let mut network = Network::new(1, 1);
    let member = network.cas[0].user("Salma", "member", KeyKind::Ed25519);
    let call = network.sign_for("listener", &member, "overload", &[]);
    let refused = network.block(&[&call]).remove(0).unwrap_err();
    assert_eq!((refused.code, refused.message.as_str()), (Code::Refused, "as the test asked"));
}
