mod evidence;

use super::*;
use bytes::Bytes;
use ledger_identity::key::{KeyKind, SigningKey};
use ledger_identity::msp::Msp;
use ledger_light::{CertificateRule, Voter};
use testkit::{Ca, User};

const NETWORK: Hash = Hash([7; 32]);
/// 2030-01-01, microseconds.
const TIME: u64 = 1_893_456_000_000_000;

/// Nodes 1 and 2 of Org1 and 3 of Org2 vote; 4 of Org2 follows.
struct World {
    nodes: Vec<User>,
    era: Era,
}

struct Keys(u64, User);

impl Signing for Keys {
    fn sign(&self, statement: &Statement) -> Result<Signed, Rejection> {
        statement.sign(self.0, self.1.certificate.clone(), &self.1.key)
    }

    fn sign_vote(&self, vote: &Vote) -> Result<Signature, Rejection> {
        vote.sign(self.1.certificate.clone(), &self.1.key)
    }

    fn sign_transfer(&self, transfer: &Transfer) -> Result<Signature, Rejection> {
        transfer.sign(self.1.certificate.clone(), &self.1.key)
    }

    fn sign_head(&self, head: &Head) -> Result<Signature, Rejection> {
        head.sign(self.1.certificate.clone(), &self.1.key)
    }

    fn identify(&self, msps: &Arc<Msps>, certificate: &[u8], time: u64) -> Result<Identity, Rejection> {
        msps.verify(certificate, &[], time).map_err(Rejection::from)
    }
}

fn organisation(node: u64) -> usize {
    usize::from(node > 2)
}

impl World {
    fn new() -> Self {
        let cas = [Ca::new("Org1 CA"), Ca::new("Org2 CA")];
        let names = ["Org1", "Org2"];
        let mut msps = Msps::new();
        for (ca, name) in cas.iter().zip(names) {
            msps.insert(Msp::new(name, &[ca.root()], &[] as &[Bytes]).unwrap()).unwrap();
        }
        let user = |node: u64| cas[organisation(node)].user(&format!("node{node}"), "node", KeyKind::Ed25519);
        let voter = |node: u64| Voter { organisation: names[organisation(node)].into(), name: format!("node{node}") };
        let nodes = (1..=4).map(|node| (node, voter(node))).collect();
        let voters = Voters {
            nodes,
            voters: [1, 2, 3].into(),
            outgoing: [].into(),
            rule: CertificateRule::default(),
            recoveries: 0,
        };
        Self { nodes: (1..=4).map(user).collect(), era: Era { from: 1, voters, msps: Arc::new(msps) } }
    }

    fn user(&self, node: u64) -> User {
        let User { key, certificate } = &self.nodes[node as usize - 1];
        User { key: SigningKey::from_pkcs8_der(key.to_pkcs8_der()).unwrap(), certificate: certificate.clone() }
    }

    fn node(&self, node: u64) -> Certifier<Keys> {
        self.node_with(node, Earlier::default())
    }

    fn node_with(&self, node: u64, earlier: Earlier) -> Certifier<Keys> {
        Certifier::new(node, NETWORK, Keys(node, self.user(node)), self.era.clone(), earlier)
    }

    fn sign(&self, statement: Statement, node: u64) -> Signed {
        Keys(node, self.user(node)).sign(&statement).unwrap()
    }

    fn verifies(&self, certificate: &Certificate) -> bool {
        let identify = |der: &[u8], time: u64| self.era.msps.verify(der, &[], time).map_err(Rejection::from);
        certificate.verify(&NETWORK, &self.era.voters, identify).is_ok()
    }
}

fn statement(height: u64) -> Statement {
    Statement { network: NETWORK, recoveries: 0, height, time: TIME, block: Hash([1; 32]), results: Hash([2; 32]) }
}

fn certifiable(height: u64) -> Certifiable {
    let Statement { height, time, block, results, .. } = statement(height);
    Certifiable { height, time, block, results }
}

/// Another block.
fn forked(height: u64, block: u8) -> Statement {
    Statement { block: Hash([block; 32]), ..statement(height) }
}

fn other(height: u64, results: u8) -> Statement {
    Statement { results: Hash([results; 32]), ..statement(height) }
}

fn step(node: &mut Certifier<Keys>, event: Event) -> Vec<Effect> {
    let mut out = Vec::new();
    node.step(0, event, &mut out);
    out
}

fn executed(height: u64) -> Event {
    Event::Executed { block: certifiable(height), governs: false }
}

fn certificates(effects: &[Effect]) -> Vec<Certificate> {
    let certified = |effect: &Effect| match effect {
        Effect::Certified { certificate, .. } => Some(certificate.clone()),
        _ => None,
    };
    effects.iter().filter_map(certified).collect()
}

fn told(effects: &[Effect]) -> Vec<u64> {
    let told = |effect: &Effect| match effect {
        Effect::Tell(signed) => Some(signed.statement.height),
        _ => None,
    };
    effects.iter().filter_map(told).collect()
}

fn proofs(effects: &[Effect]) -> Vec<Misbehaviour> {
    let proof = |effect: &Effect| match effect {
        Effect::Misbehaved(proof) => Some((**proof).clone()),
        _ => None,
    };
    effects.iter().filter_map(proof).collect()
}

fn lies(effects: &[Effect]) -> usize {
    proofs(effects).iter().filter(|proof| proof.is_lie()).count()
}

fn passed(effects: &[Effect]) -> Vec<(u64, Statement)> {
    let passed = |effect: &Effect| match effect {
        Effect::Pass(signed) => Some((signed.signature.node, signed.statement)),
        _ => None,
    };
    effects.iter().filter_map(passed).collect()
}

#[test]
fn statements_of_a_majority_of_two_organisations_become_one_certificate_in_any_order() {
    let world = World::new();
    for order in [[1, 2, 3], [3, 2, 1], [2, 3, 1], [2, 1, 3]] {
        for first in [true, false] {
            // Node 4 follows, and gathers as voters do.
            let mut node = world.node(4);
            let mut effects = if first { step(&mut node, executed(5)) } else { Vec::new() };
            for from in order {
                let signed = world.sign(statement(5), from);
                effects.extend(step(&mut node, Event::Heard { from, signed }));
            }
            if !first {
                effects.extend(step(&mut node, executed(5)));
            }
            effects.extend(step(&mut node, Event::Durable(9)));
            let certificates = certificates(&effects);
            assert_eq!(certificates.len(), 1, "{order:?} {first}");
            assert!(world.verifies(&certificates[0]) && certificates[0].statement == statement(5));
            assert!(told(&effects).is_empty(), "a learner says nothing");
        }
    }
}

#[test]
fn voters_of_one_organisation_and_learners_certify_nothing() {
    let world = World::new();
    let mut node = world.node(1);
    let mut effects = step(&mut node, Event::Durable(5));
    effects.extend(step(&mut node, executed(5)));
    assert_eq!(told(&effects), [5]);
    for from in [2, 4] {
        effects.extend(step(&mut node, Event::Heard { from, signed: world.sign(statement(5), from) }));
    }
    assert!(certificates(&effects).is_empty());
    let last = step(&mut node, Event::Heard { from: 3, signed: world.sign(statement(5), 3) });
    assert_eq!(certificates(&last)[0].signatures.iter().map(|it| it.node).collect::<Vec<_>>(), [1, 2, 3]);
}

#[test]
fn a_voter_says_nothing_about_a_block_that_its_disk_does_not_hold() {
    let world = World::new();
    let mut node = world.node(1);
    let mut early = step(&mut node, executed(5));
    early.extend(step(&mut node, executed(7)));
    early.extend(step(&mut node, Event::Durable(4)));
    assert!(told(&early).is_empty() && node.waits_for_disk());
    assert_eq!(told(&step(&mut node, Event::Durable(6))), [5]);
    assert!(node.waits_for_disk());
    assert_eq!(told(&step(&mut node, Event::Durable(7))), [7]);
    assert!(!node.waits_for_disk() && told(&step(&mut node, Event::Durable(8))).is_empty(), "once");
}

#[test]
fn about_blocks_that_the_log_held_at_the_start_a_voter_signs_only_what_its_record_has() {
    let world = World::new();
    let recorded = |effects: &[Effect]| {
        let recorded = |effect: &Effect| match effect {
            Effect::Record(statement) => Some(*statement),
            _ => None,
        };
        effects.iter().filter_map(recorded).collect::<Vec<_>>()
    };
    // Another disk than the one on which it signed: the same statement about 5, another one about 6, and none about 7.
    let earlier = Earlier { end: 7, signed: vec![statement(5), forked(6, 9)] };
    let mut node = world.node_with(1, earlier);
    let mut effects = step(&mut node, Event::Durable(9));
    for height in 5..=8 {
        effects.extend(step(&mut node, executed(height)));
    }
    assert_eq!((told(&effects), recorded(&effects)), (vec![5, 8], vec![statement(8)]));
    // What is recorded comes before what is sent.
    let at = |wanted: &dyn Fn(&Effect) -> bool| effects.iter().position(wanted).unwrap();
    let sent = |effect: &Effect| matches!(effect, Effect::Tell(signed) if signed.statement.height == 8);
    assert!(at(&|effect| matches!(effect, Effect::Record(_))) < at(&sent));
}

#[test]
fn what_is_signed_badly_does_not_count_whoever_brings_it() {
    let world = World::new();
    let mut node = world.node(1);
    step(&mut node, Event::Durable(5));
    step(&mut node, executed(5));
    let mut forged = world.sign(statement(5), 2);
    forged.signature.node = 3;
    let mut elsewhere = world.sign(other(5, 9), 3);
    elsewhere.statement = statement(5);
    let mut effects = Vec::new();
    for signed in [forged, elsewhere] {
        for from in [2, 3, 4] {
            effects.extend(step(&mut node, Event::Heard { from, signed: signed.clone() }));
        }
    }
    let learner = world.sign(statement(5), 4);
    effects.extend(step(&mut node, Event::Heard { from: 2, signed: learner }));
    assert!(effects.is_empty(), "{effects:?}");
    let good = step(&mut node, Event::Heard { from: 3, signed: world.sign(statement(5), 3) });
    assert_eq!(certificates(&good).len(), 1, "its own word counts after all");
    // What another node passes on is signed all the same.
    let mut node = world.node(1);
    step(&mut node, Event::Durable(5));
    step(&mut node, executed(5));
    let passed_on = step(&mut node, Event::Heard { from: 4, signed: world.sign(statement(5), 3) });
    assert_eq!(certificates(&passed_on).len(), 1);
}

#[test]
fn statements_name_the_forced_recoveries_before_their_block_and_of_another_number_none_counts() {
    let world = World::new();
    let mut node = world.node(1);
    step(&mut node, Event::Durable(99));
    let recovered = Era { from: 6, voters: Voters { recoveries: 1, ..world.era.voters.clone() }, ..world.era.clone() };
    let mut effects = step(&mut node, executed(5));
    effects.extend(step(&mut node, Event::Voters(recovered)));
    effects.extend(step(&mut node, executed(6)));
    let own = effects.iter().filter_map(|effect| match effect {
        Effect::Tell(signed) => Some((signed.statement.height, signed.statement.recoveries)),
        _ => None,
    });
    assert_eq!(own.collect::<Vec<_>>(), [(5, 0), (6, 1)]);
    for (recoveries, wanted) in [(0, 0), (2, 0), (1, 1)] {
        let signed = world.sign(Statement { recoveries, ..statement(6) }, 3);
        assert_eq!(certificates(&step(&mut node, Event::Heard { from: 3, signed })).len(), wanted, "{recoveries}");
    }
}

#[test]
fn voters_count_by_the_block_before() {
    let mut world = World::new();
    let mut node = world.node(1);
    step(&mut node, Event::Durable(99));
    let mut next = world.era.clone();
    (next.from, next.voters.voters) = (6, [1, 2, 4].into());
    step(&mut node, executed(5));
    step(&mut node, Event::Voters(next.clone()));
    step(&mut node, executed(6));
    let from = |node: u64, height: u64| Event::Heard { from: node, signed: world.sign(statement(height), node) };
    assert_eq!(certificates(&step(&mut node, from(4, 5))).len(), 0, "it votes from 6 on");
    assert_eq!(certificates(&step(&mut node, from(3, 6))).len(), 0, "it votes up to 5");
    let old = certificates(&step(&mut node, from(3, 5)));
    assert!(world.verifies(&old[0]));
    let new = certificates(&step(&mut node, from(4, 6)));
    world.era = next;
    assert!(world.verifies(&new[0]));
}

#[test]
fn what_was_signed_with_a_vote_that_is_lost_by_then_is_in_no_certificate() {
    let world = World::new();
    let mut node = world.node(1);
    step(&mut node, executed(5));
    // A liar contradicts itself about a block to come, so its first statement was looked at, and is good.
    let hear = |node: &mut Certifier<Keys>, from, statement| {
        step(node, Event::Heard { from, signed: world.sign(statement, from) })
    };
    hear(&mut node, 3, statement(6));
    assert_eq!(lies(&hear(&mut node, 3, forked(6, 9))), 1);
    let mut era = Era { from: 6, ..world.era.clone() };
    era.voters.voters = [1, 2, 4].into();
    step(&mut node, Event::Voters(era));
    step(&mut node, executed(6));
    step(&mut node, Event::Durable(6));
    hear(&mut node, 2, statement(6));
    let made = certificates(&hear(&mut node, 4, statement(6)));
    let signers: Vec<_> = made[0].signatures.iter().map(|signature| signature.node).collect();
    assert_eq!(signers, [1, 2, 4]);
}

#[test]
fn memory_is_bounded_whatever_peers_say() {
    let world = World::new();
    let mut node = world.node(1);
    let statements = |node: &Certifier<Keys>| node.heights.values().map(|height| height.heard.len()).sum::<usize>();
    for height in 1..=1000 {
        let signed = world.sign(statement(height), 3);
        step(&mut node, Event::Heard { from: 3, signed });
    }
    assert_eq!(statements(&node), AHEAD_MAX, "the newest ones");
    assert!(node.heights.contains_key(&1000) && !node.heights.contains_key(&1));
    step(&mut node, Event::Durable(2000));
    for height in 1..=2000 {
        step(&mut node, executed(height));
        let signed = world.sign(statement(height), 2);
        step(&mut node, Event::Heard { from: 2, signed });
    }
    assert!(node.heights.len() <= HEIGHTS_MAX && statements(&node) <= 3 * HEIGHTS_MAX);
    let late = step(&mut node, Event::Heard { from: 3, signed: world.sign(statement(1), 3) });
    assert!(late.is_empty() && !node.heights.contains_key(&1));
}

#[test]
fn the_newest_statement_is_told_again_less_and_less_often() {
    let world = World::new();
    let mut node = world.node(1);
    step(&mut node, Event::Durable(5));
    step(&mut node, executed(5));
    let mut times = Vec::new();
    for second in 0..200 {
        let mut out = Vec::new();
        node.step(second * 1_000_000, Event::Time, &mut out);
        times.extend(told(&out).iter().map(|_| second));
    }
    assert_eq!(times, [1, 3, 7, 15, 31, 63, 127, 191]);
}

#[test]
fn statements_about_blocks_that_change_whom_others_trust_are_told_again_with_the_newest() {
    let world = World::new();
    let mut node = world.node(1);
    step(&mut node, Event::Durable(99));
    for height in 1..=30 {
        step(&mut node, Event::Executed { block: certifiable(height), governs: height % 3 == 0 });
    }
    let mut out = Vec::new();
    node.step(1_000_000, Event::Time, &mut out);
    assert_eq!(told(&out), [27, 24, 21, 18, 15, 12, 9, 6, 30]);
}
