//! Each rule of a certificate, and of the proof of a lie, has a case that only this rule refuses.

use crate::world::{NETWORK, NOW, World, statement};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;
use ledger_light::{
    Branch, BranchLink, Certificate, DoubleHead, DoubleVote, Fault, Head, Lie, Misbehaviour, Statement, Vote, Voter,
    block_hash,
};

fn code(world: &World, certificate: &Certificate) -> Code {
    world.verify(certificate).map_or_else(|refused| refused.code, |()| Code::Ok)
}

#[test]
fn a_majority_from_two_organisations_is_believed_nothing_less_and_others_that_sign_count_for_nothing() {
    let world = World::new();
    for (signers, wanted) in [
        (&[1, 3][..], Code::Ok),
        (&[2, 3], Code::Ok),
        (&[1, 2, 3], Code::Ok),
        (&[1, 2], Code::Untrusted),
        (&[3], Code::Untrusted),
        (&[], Code::Untrusted),
        (&[3, 4], Code::Untrusted),
        (&[1, 3, 4], Code::Ok),
        (&[1, 1], Code::Malformed),
    ] {
        assert_eq!(code(&world, &world.certificate(statement(5), signers)), wanted, "{signers:?}");
    }
}

#[test]
fn voters_of_one_organisation_certify_alone() {
    let mut world = World::new();
    world.voters.voters = [1, 2].into();
    assert_eq!(code(&world, &world.certificate(statement(5), &[1, 2])), Code::Ok);
    world.voters.voters = [1].into();
    assert_eq!(code(&world, &world.certificate(statement(5), &[1])), Code::Ok);
}

#[test]
fn while_voters_change_both_sets_must_agree() {
    let mut world = World::new();
    (world.voters.voters, world.voters.outgoing) = ([2, 3, 4].into(), [1, 2, 3].into());
    for (signers, wanted) in [(&[2, 3][..], Code::Ok), (&[3, 4], Code::Untrusted), (&[1, 3], Code::Untrusted)] {
        assert_eq!(code(&world, &world.certificate(statement(5), signers)), wanted, "{signers:?}");
    }
}

#[test]
fn a_signature_counts_for_its_node_its_network_and_its_statement_only() {
    let world = World::new();
    let good = world.certificate(statement(5), &[1, 3]);
    let with = |change: &dyn Fn(&mut Certificate)| {
        let mut changed = good.clone();
        change(&mut changed);
        code(&world, &changed)
    };
    assert_eq!(with(&|_| ()), Code::Ok);
    assert_eq!(with(&|c| c.statement.network = Hash::ZERO), Code::WrongNetwork);
    assert_eq!(with(&|c| c.statement.height += 1), Code::BadSignature);
    assert_eq!(with(&|c| c.statement.recoveries += 1), Code::Untrusted, "the voters have executed no forced recovery");
    assert_eq!(with(&|c| c.statement.time += 1), Code::BadSignature);
    assert_eq!(with(&|c| c.statement.block = Hash::ZERO), Code::BadSignature);
    assert_eq!(with(&|c| c.statement.results = Hash::ZERO), Code::BadSignature);
    assert_eq!(with(&|c| c.signatures[0].node = 2), Code::Untrusted, "the certificate is of node 1");
    let other = world.certificate(statement(6), &[1]).signatures[0].clone();
    assert_eq!(with(&|c| c.signatures[0] = other.clone()), Code::BadSignature);
    // A user of the node's name and organisation is no node.
    let user = world.cas[0].user("node1", "member", KeyKind::P256);
    let signed = statement(5).sign(1, user.certificate, &user.key).unwrap().signature;
    assert_eq!(with(&|c| c.signatures[0] = signed.clone()), Code::Untrusted);
}

#[test]
fn a_signers_certificate_must_be_valid_at_the_time_of_the_block() {
    let world = World::new();
    let late = Statement { time: NOW + 400 * 24 * 3600 * 1_000_000, ..statement(5) };
    assert_eq!(code(&world, &world.certificate(late, &[1, 3])), Code::CertificateExpired);
}

#[test]
fn two_blocks_that_one_node_has_signed_for_one_place_prove_a_lie_and_nothing_else_does() {
    let world = World::new();
    let other = Statement { block: Hash([3; 32]), ..statement(5) };
    let lie = |first: &Statement, by: u64, second: &Statement, and: u64| {
        let lie = Lie { first: world.sign(first, by), second: world.sign(second, and) };
        let proof = Misbehaviour::Lie(lie.clone());
        assert_eq!(Misbehaviour::from_bytes(&proof.to_bytes()).unwrap(), proof);
        lie.verify(|der, time| world.identify(der, time)).map(|liar| liar.id()).map_err(|refused| refused.code)
    };
    assert_eq!(lie(&statement(5), 3, &other, 3).unwrap(), "Org2/node3");
    assert_eq!(lie(&statement(5), 3, &statement(5), 3), Err(Code::Malformed), "the same twice");
    assert_eq!(lie(&statement(5), 3, &other, 1), Err(Code::Malformed), "two nodes");
    assert_eq!(lie(&statement(6), 3, &other, 3), Err(Code::Malformed), "two heights");
    let elsewhere = Statement { network: Hash::ZERO, ..other };
    assert_eq!(lie(&statement(5), 3, &elsewhere, 3), Err(Code::Malformed), "two networks");
    let recovered = Statement { recoveries: 1, ..other };
    assert_eq!(lie(&statement(5), 3, &recovered, 3), Err(Code::Malformed), "before and after a forced recovery");
    let results = Statement { results: Hash([3; 32]), ..statement(5) };
    assert_eq!(lie(&statement(5), 3, &results, 3), Err(Code::Malformed), "two results of one block are no lie");
    let mut forged = Lie { first: world.sign(&statement(5), 3), second: world.sign(&other, 3) };
    forged.second.statement.results = Hash([4; 32]);
    assert_eq!(forged.verify(|der, time| world.identify(der, time)).unwrap_err().code, Code::BadSignature);
    // The number of the node is signed: the same node under its former number has said nothing of the new one.
    let mut renumbered = Lie { first: world.sign(&statement(5), 3), second: world.sign(&other, 3) };
    (renumbered.first.signature.node, renumbered.second.signature.node) = (9, 9);
    assert_eq!(renumbered.verify(|der, time| world.identify(der, time)).unwrap_err().code, Code::BadSignature);
}

#[test]
fn two_results_of_one_block_that_one_node_has_signed_prove_a_fault_and_no_lie() {
    let world = World::new();
    let other = Statement { results: Hash([3; 32]), ..statement(5) };
    let fault = |first: &Statement, second: &Statement| {
        let fault = Fault { first: world.sign(first, 3), second: world.sign(second, 3) };
        let proof = Misbehaviour::Fault(fault.clone());
        assert_eq!(Misbehaviour::from_bytes(&proof.to_bytes()).unwrap(), proof);
        fault.verify(|der, time| world.identify(der, time)).map(|node| node.id()).map_err(|refused| refused.code)
    };
    assert_eq!(fault(&statement(5), &other).unwrap(), "Org2/node3");
    assert_eq!(fault(&statement(5), &statement(5)), Err(Code::Malformed), "the same twice");
    let block = Statement { block: Hash([3; 32]), ..other };
    assert_eq!(fault(&statement(5), &block), Err(Code::Malformed), "two blocks are a lie");
    let signed = |statement: &Statement| world.sign(statement, 3);
    let proof = Misbehaviour::of(signed(&statement(5)), signed(&other)).unwrap();
    assert!(!proof.is_lie() && Misbehaviour::from_bytes(&proof.to_bytes()).unwrap() == proof);
    let lie = Misbehaviour::of(signed(&other), signed(&block)).unwrap();
    assert!(lie.is_lie() && Misbehaviour::from_bytes(&lie.to_bytes()).unwrap() == lie);
    assert_eq!(Misbehaviour::of(signed(&other), world.sign(&block, 1)), None, "two nodes");
}

#[test]
fn a_proof_counts_against_the_node_that_the_ledger_knows_by_the_number_and_the_name() {
    let world = World::new();
    let other = Statement { block: Hash([3; 32]), ..statement(5) };
    let lie = Misbehaviour::of(world.sign(&statement(5), 3), world.sign(&other, 3)).unwrap();
    let code = |network: Hash, change: &dyn Fn(&mut std::collections::BTreeMap<u64, Voter>)| {
        let mut nodes = world.voters.nodes.clone();
        change(&mut nodes);
        lie.verify(&network, &nodes, |der, time| world.identify(der, time))
            .map_or_else(|refused| refused.code, |_| Code::Ok)
    };
    assert_eq!(code(NETWORK, &|_| ()), Code::Ok);
    assert_eq!(code(Hash::ZERO, &|_| ()), Code::WrongNetwork);
    assert_eq!(code(NETWORK, &|nodes| drop(nodes.remove(&3))), Code::NotAMember);
    assert_eq!(code(NETWORK, &|nodes| nodes.get_mut(&3).unwrap().name = "node4".into()), Code::Untrusted);
}

#[test]
fn two_votes_of_one_node_in_one_term_prove_a_lie_and_nothing_else_does() {
    let world = World::new();
    let vote = |candidate, voter| {
        (candidate, world.vote(&Vote { network: NETWORK, recoveries: 0, term: 7, candidate, voter }))
    };
    let proved = |votes| {
        let proof = DoubleVote { network: NETWORK, recoveries: 0, term: 7, time: NOW, votes };
        assert_eq!(DoubleVote::from_bytes(&proof.to_bytes()).unwrap(), proof);
        proof.verify(|der, time| world.identify(der, time)).map(|liar| liar.id()).map_err(|refused| refused.code)
    };
    assert_eq!(proved([vote(1, 3), vote(2, 3)]).unwrap(), "Org2/node3");
    assert_eq!(proved([vote(1, 3), vote(1, 3)]), Err(Code::Malformed), "the same twice");
    assert_eq!(proved([vote(1, 3), vote(2, 1)]), Err(Code::Malformed), "two nodes");
    let elsewhere = (2, world.vote(&Vote { network: NETWORK, recoveries: 0, term: 8, candidate: 2, voter: 3 }));
    assert_eq!(proved([vote(1, 3), elsewhere]), Err(Code::BadSignature), "two terms");
    let recovered = (2, world.vote(&Vote { network: NETWORK, recoveries: 1, term: 7, candidate: 2, voter: 3 }));
    assert_eq!(proved([vote(1, 3), recovered]), Err(Code::BadSignature), "before and after a forced recovery");
    let (_, signed) = vote(1, 3);
    assert_eq!(proved([(1, signed.clone()), (2, signed)]), Err(Code::BadSignature), "a vote for another candidate");
}

#[test]
fn two_heads_of_one_leader_in_one_term_above_two_blocks_of_one_height_prove_a_lie_and_nothing_else_does() {
    let world = World::new();
    let link = BranchLink { term: 6, time: NOW, root: Hash([9; 32]) };
    // A branch from block 5 with this hash on, with so many blocks, whose head is signed by a node as the leader of a term.
    let branch = |base: u8, blocks: u64, signer: u64, term: u64| {
        let base = Hash([base; 32]);
        let hash = (6..6 + blocks).fold(base, |hash, height| block_hash(height, &link, hash));
        let head = Head { network: NETWORK, recoveries: 0, leader: 3, term, height: 5 + blocks, hash };
        Branch { base, links: vec![link; blocks as usize], signature: world.head(&head, signer) }
    };
    let verify = |branches| {
        let proof = DoubleHead { network: NETWORK, recoveries: 0, leader: 3, term: 7, height: 5, time: NOW, branches };
        assert_eq!(DoubleHead::from_bytes(&proof.to_bytes()).unwrap(), proof);
        let any = Misbehaviour::from_bytes(&proof.to_bytes()).unwrap();
        assert_eq!((any.node(), any.is_lie(), any.to_bytes()), (3, true, proof.to_bytes()));
        proof.verify(|der, time| world.identify(der, time)).map(|liar| liar.id()).map_err(|refused| refused.code)
    };
    assert_eq!(verify([branch(1, 0, 3, 7), branch(2, 0, 3, 7)]).unwrap(), "Org2/node3");
    assert_eq!(verify([branch(1, 2, 3, 7), branch(2, 9, 3, 7)]).unwrap(), "Org2/node3", "heads of two heights");
    assert_eq!(verify([branch(1, 2, 3, 7), branch(1, 9, 3, 7)]), Err(Code::Malformed), "one log, which has grown");
    assert_eq!(verify([branch(1, 2, 3, 7), branch(2, 2, 1, 7)]), Err(Code::Malformed), "two nodes");
    assert_eq!(verify([branch(1, 2, 3, 7), branch(2, 2, 3, 8)]), Err(Code::BadSignature), "two terms");
    let mut longer = branch(2, 2, 3, 7);
    longer.links.push(link);
    assert_eq!(verify([branch(1, 2, 3, 7), longer]), Err(Code::BadSignature), "a block more than was signed");
}

#[test]
fn the_encodings_are_read_as_they_were_written() {
    let world = World::new();
    let certificate = world.certificate(statement(5), &[1, 2, 3]);
    assert_eq!(Certificate::from_bytes(&certificate.to_bytes()).unwrap(), certificate);
    let twice = world.certificate(statement(5), &[1, 1]);
    assert_eq!(Certificate::from_bytes(&twice.to_bytes()).unwrap_err().code, Code::Malformed);
    let disordered = world.certificate(statement(5), &[3, 1]);
    assert_eq!(Certificate::from_bytes(&disordered.to_bytes()).unwrap_err().code, Code::Malformed);
    let signed = world.sign(&statement(5), 1);
    assert_eq!(ledger_light::Signed::from_bytes(&signed.to_bytes()).unwrap(), signed);
    assert_eq!(signed.statement.network, NETWORK);
}
