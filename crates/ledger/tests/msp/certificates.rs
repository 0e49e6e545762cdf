//! How many signatures make a certificate: strict where any one voter can be lost, and never weaker by one organisation's word.

use crate::world::{Network, code, is_executed, json, waiting};
use ledger::members::{Change, MembershipChange};
use ledger::msp::{self, NodeRecord, NodeRole, Nodes, Recovery};
use ledger_base::rejection::Code;
use ledger_light::CertificateRule;

fn set(id: u64, role: &str) -> String {
    format!(r#"{{"id":{id},"role":"{role}"}}"#)
}

impl Network {
    fn rule(&self) -> CertificateRule {
        msp::certificate_rule(&**self.ledger.state()).unwrap()
    }

    fn strict_since(&self) -> Option<u64> {
        self.rule().strict_since
    }

    /// All organisations say the same, until it is done.
    fn all_agree(&mut self, function: &str, argument: &str) {
        let done = (1..=self.admins.len()).any(|number| {
            let answer = self.admin(number, function, &[argument]);
            answer.is_ok() && is_executed(answer)
        });
        assert!(done, "{function} {argument}");
    }

    fn quorum(&self) -> usize {
        self.ledger.voters().unwrap().quorum()
    }
}

#[test]
fn certificates_are_strict_from_the_block_on_whose_voters_can_lose_any_one() {
    let founded = Network::new(4, 4);
    assert_eq!(founded.strict_since(), Some(0), "by the genesis");
    assert_eq!(founded.query::<Nodes>("nodes", &[]).certificates, founded.rule());
    let mut network = Network::new(4, 3);
    assert_eq!((network.strict_since(), network.quorum()), (None, 2), "three voters can lose none");
    network.all_agree("set_node_role", &set(4, "voter"));
    assert_eq!(network.strict_since(), None, "it is wanted, and no voter yet");
    network.change_members([Change::AddVoter(4)]);
    let height = network.ledger.tip().height;
    assert_eq!((network.strict_since(), network.quorum()), (Some(height), 3));
    assert_eq!(network.event_names(), ["certificate_rule_changed"]);
}

#[test]
fn no_organisation_ends_strict_certificates_by_its_own_nodes() {
    for role in ["learner", "removed"] {
        let mut network = Network::new(4, 4);
        waiting(network.admin(4, "set_node_role", &[&set(4, role)]));
        assert_eq!((network.role(4), network.strict_since()), (NodeRole::Voter, Some(0)), "three others must agree");
        network.admin(1, "set_node_role", &[&set(4, role)]).unwrap();
        assert!(is_executed(network.admin(2, "set_node_role", &[&set(4, role)])));
        assert_eq!(network.strict_since(), None);
        assert!(network.event_names().contains(&"certificate_rule_changed"), "{:?}", network.event_names());
        // They become so again by themselves.
        if role == "learner" {
            network.change_members([Change::AddLearner(4)]);
            network.all_agree("set_node_role", &set(4, "voter"));
            network.change_members([Change::AddVoter(4)]);
            assert_eq!(network.strict_since(), Some(network.ledger.tip().height));
        }
    }
    let mut five = Network::new(5, 5);
    assert!(is_executed(five.admin(5, "set_node_role", &[&set(5, "learner")])), "four are enough");
    assert_eq!(five.strict_since(), Some(0));
    waiting(five.admin(4, "set_node_role", &[&set(4, "learner")]));
}

#[test]
fn a_replaced_voter_keeps_its_vote_so_no_organisation_is_asked() {
    let mut network = Network::new(4, 4);
    let node: NodeRecord = json(network.node(4, "join_node", &[r#"{"address":"node4:7450","replace":true}"#]));
    assert_eq!((node.id, node.role, network.role(4)), (5, NodeRole::Voter, NodeRole::Removed));
    network.change_members([Change::AddLearner(5)]);
    network.change_members([Change::AddVoter(5), Change::Remove(4)]);
    network.change_members([]);
    assert_eq!((network.strict_since(), network.quorum()), (Some(0), 3));
}

#[test]
fn the_organisations_end_it_and_only_they_set_it_again() {
    let mut network = Network::new(4, 4);
    waiting(network.admin(1, "set_certificate_rule", &[r#"{"strict":false}"#]));
    network.admin(2, "set_certificate_rule", &[r#"{"strict":false}"#]).unwrap();
    assert_eq!(network.strict_since(), Some(0), "two of four");
    assert!(is_executed(network.admin(3, "set_certificate_rule", &[r#"{"strict":false}"#])));
    assert_eq!((network.rule().cleared, network.strict_since(), network.quorum()), (true, None, 3));
    network.admin(4, "set_node_role", &[&set(4, "learner")]).unwrap();
    network.change_members([Change::AddLearner(4)]);
    network.all_agree("set_node_role", &set(4, "voter"));
    network.change_members([Change::AddVoter(4)]);
    assert_eq!(network.strict_since(), None, "they decided against it");
    network.all_agree("set_certificate_rule", r#"{"strict":true}"#);
    assert_eq!(network.strict_since(), Some(network.ledger.tip().height));
    // Where none can be lost, too: three organisations may want to stand still rather than to believe one.
    let mut three = Network::new(3, 3);
    three.all_agree("set_certificate_rule", r#"{"strict":true}"#);
    assert_eq!(three.quorum(), 3);
    three.change_members([]);
    assert_eq!(three.quorum(), 3, "what was decided stays");
}

#[test]
fn organisations_under_one_hand_are_declared_by_all_and_forgotten_when_one_leaves() {
    let mut network = Network::new(5, 5);
    for (hands, wanted) in [
        (r#"[["Org1"]]"#, Code::BadArgument),
        (r#"[["Org1","Org2"],["Org2","Org3"]]"#, Code::BadArgument),
        (r#"[["Org1","Org9"]]"#, Code::NotFound),
    ] {
        let argument = format!(r#"{{"hands":{hands}}}"#);
        assert_eq!(code(&network.admin(1, "set_certificate_rule", &[&argument])), wanted, "{hands}");
    }
    assert_eq!(code(&network.admin(1, "set_certificate_rule", &["{}"])), Code::BadArgument);
    assert_eq!(network.quorum(), 4);
    network.all_agree("set_certificate_rule", r#"{"hands":[["Org1","Org2"]]}"#);
    assert_eq!((network.strict_since(), network.quorum()), (Some(0), 4), "five voters, of whom two are one");
    network.all_agree("set_certificate_rule", r#"{"hands":[["Org1","Org2","Org3"]]}"#);
    assert_eq!((network.strict_since(), network.quorum()), (None, 3), "none can be lost any more, as all agreed");
    network.all_agree("remove_organisation", r#"{"name":"Org1"}"#);
    assert_eq!(network.rule().hands.len(), 1);
    network.all_agree("remove_organisation", r#"{"name":"Org2"}"#);
    assert!(network.rule().hands.is_empty());
}

#[test]
fn a_change_of_members_that_nobody_wants_is_not_certified_nor_is_one_by_force() {
    let leave_one = MembershipChange::new([Change::Remove(2), Change::Remove(3), Change::Remove(4)]);
    assert!(!Network::new(4, 4).change_members_as(&leave_one), "the leader alone would be left");
    let add = MembershipChange::new([Change::AddVoter(4)]);
    let mut network = Network::new(4, 3);
    assert!(!network.change_members_as(&add), "nobody has given it a vote");
    let mut network = Network::new(4, 3);
    network.all_agree("set_node_role", &set(4, "voter"));
    assert!(network.change_members_as(&add));
    let recovery =
        Recovery { id: 1, node: "Org1/node1".into(), voters: [1, 2, 3, 4].into(), at: 1, reason: String::new() };
    assert!(!network.change_members_as(&recovery.change([2, 3, 4]).unwrap()));
    assert_eq!(network.strict_since(), None, "people have decided");
}
