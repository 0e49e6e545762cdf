//! Signed things that contradict each other: the proof they make, and the nodes that receive it.

use super::*;

#[test]
fn two_blocks_of_one_node_and_height_are_kept_as_a_lie_once() {
    let world = World::new();
    for [first, second] in [[1, 9], [9, 1], [8, 9]] {
        let mut node = world.node(1);
        step(&mut node, executed(5));
        let mut effects = Vec::new();
        for block in [first, second, second, 10, 11] {
            let signed = world.sign(forked(5, block), 3);
            effects.extend(step(&mut node, Event::Heard { from: 3, signed }));
        }
        assert_eq!((lies(&effects), proofs(&effects).len()), (1, 1), "{first} {second}");
        let liar = proofs(&effects)[0].verify(&NETWORK, &world.era.voters.nodes, |der, time| {
            world.era.msps.verify(der, &[], time).map_err(Rejection::from)
        });
        assert_eq!(liar.unwrap().id(), "Org2/node3");
    }
    // Nobody can make another node a liar.
    let mut node = world.node(1);
    step(&mut node, executed(5));
    step(&mut node, Event::Heard { from: 3, signed: world.sign(statement(5), 3) });
    let mut forged = world.sign(forked(5, 9), 2);
    forged.signature.node = 3;
    for from in [2, 3] {
        assert_eq!(lies(&step(&mut node, Event::Heard { from, signed: forged.clone() })), 0);
    }
}

#[test]
fn two_results_of_one_block_by_one_node_are_a_fault_and_no_lie_and_a_lie_about_it_is_still_proved() {
    let world = World::new();
    let mut node = world.node(1);
    step(&mut node, executed(5));
    let mut effects = Vec::new();
    for said in [other(5, 8), other(5, 9), other(5, 10)] {
        effects.extend(step(&mut node, Event::Heard { from: 3, signed: world.sign(said, 3) }));
    }
    assert_eq!((lies(&effects), proofs(&effects).len()), (0, 1));
    assert_eq!(lies(&step(&mut node, Event::Heard { from: 3, signed: world.sign(forked(5, 9), 3) })), 1);
    // Results of two nodes that differ prove nothing.
    let mut node = world.node(1);
    step(&mut node, executed(5));
    step(&mut node, Event::Heard { from: 2, signed: world.sign(other(5, 8), 2) });
    assert!(proofs(&step(&mut node, Event::Heard { from: 3, signed: world.sign(other(5, 9), 3) })).is_empty());
}

/// Sends everything that nodes 1 and 2 want to send to each other until nothing is left; the proofs of each.
fn exchanged(nodes: &mut [Certifier<Keys>; 2], heard: [Signed; 2]) -> [Vec<Misbehaviour>; 2] {
    let mut proved = [Vec::new(), Vec::new()];
    let mut waiting: Vec<(usize, u64, Signed)> =
        heard.into_iter().enumerate().map(|(to, signed)| (to, signed.signature.node, signed)).collect();
    for _ in 0..100 {
        let Some((to, from, signed)) = waiting.pop() else { return proved };
        let effects = step(&mut nodes[to], Event::Heard { from, signed });
        proved[to].extend(proofs(&effects));
        for effect in effects {
            if let Effect::Pass(signed) = effect {
                waiting.push((1 - to, to as u64 + 1, signed));
            }
        }
    }
    panic!("they pass things on without end");
}

#[test]
fn a_voter_that_signs_one_block_for_one_node_and_another_for_another_is_proved_a_liar_at_both() {
    let world = World::new();
    for [first, second] in [[8, 9], [1, 9], [9, 1]] {
        let mut nodes = [world.node(1), world.node(2)];
        nodes.iter_mut().for_each(|node| drop(step(node, executed(5))));
        let heard = [first, second].map(|block| world.sign(forked(5, block), 3));
        let proved = exchanged(&mut nodes, heard);
        // Of one that both hold, one proves it; it sends the proof to the other.
        assert!(proved.iter().flatten().all(|proof| proof.is_lie() && proof.node() == 3), "{proved:?}");
        assert!(proved.iter().any(|proofs| !proofs.is_empty()), "{first} {second}");
    }
}

#[test]
fn two_certificates_of_one_height_are_exchanged_signature_by_signature() {
    // Node 3 signs block 1 with node 1 and block 9 with node 2, so each of them has a certificate.
    let world = World::new();
    let mut nodes = [world.node(1), world.node(2)];
    let fork = Certifiable { block: Hash([9; 32]), ..certifiable(5) };
    let mut own = Vec::new();
    for (node, block) in nodes.iter_mut().zip([certifiable(5), fork]) {
        step(node, Event::Durable(5));
        own.extend(step(node, Event::Executed { block, governs: false }));
    }
    let own: Vec<Signed> = own
        .iter()
        .filter_map(|effect| match effect {
            Effect::Tell(signed) => Some(signed.clone()),
            _ => None,
        })
        .collect();
    for (node, block) in nodes.iter_mut().zip([1, 9]) {
        let signed = world.sign(forked(5, block), 3);
        assert_eq!(certificates(&step(node, Event::Heard { from: 3, signed })).len(), 1);
    }
    let proved = exchanged(&mut nodes, [own[1].clone(), own[0].clone()]);
    for proofs in &proved {
        assert!(proofs.iter().any(|proof| proof.is_lie() && proof.node() == 3), "{proved:?}");
    }
}

#[test]
fn what_all_have_signed_alike_is_passed_on_by_nobody_and_a_dispute_once() {
    let world = World::new();
    let mut node = world.node(1);
    step(&mut node, executed(5));
    let hear = |node: &mut Certifier<Keys>, from, statement| {
        step(node, Event::Heard { from, signed: world.sign(statement, from) })
    };
    assert!(passed(&hear(&mut node, 2, statement(5))).is_empty());
    let both = hear(&mut node, 3, forked(5, 9));
    assert_eq!(passed(&both), [(2, statement(5)), (3, forked(5, 9))]);
    assert!(passed(&hear(&mut node, 3, forked(5, 9))).is_empty());
    // One that comes before the block is executed waits for it.
    let mut node = world.node(1);
    assert!(passed(&hear(&mut node, 3, forked(5, 9))).is_empty());
    assert_eq!(passed(&step(&mut node, executed(5))), [(3, forked(5, 9))]);
    // What joins a dispute is passed on, too, whatever it says.
    assert_eq!(passed(&hear(&mut node, 2, statement(5))), [(2, statement(5))]);
}

#[test]
fn a_peer_that_passes_on_too_much_is_not_heard_for_the_rest_of_the_second_and_takes_nothing_from_others() {
    let world = World::new();
    let mut node = world.node(1);
    step(&mut node, executed(5));
    let mut forged = world.sign(statement(5), 2);
    forged.signature.node = 3;
    let pass = |node: &mut Certifier<Keys>, now, from, signed: &Signed| {
        let mut out = Vec::new();
        node.step(now, Event::Heard { from, signed: signed.clone() }, &mut out);
        passed(&out).len()
    };
    for _ in 0..PASSED_MAX {
        pass(&mut node, 0, 4, &forged);
    }
    let good = world.sign(forked(5, 9), 3);
    assert_eq!(pass(&mut node, PASSED_TIME - 1, 4, &good), 0);
    assert_eq!(pass(&mut node, PASSED_TIME - 1, 2, &good), 1);
    let later = world.sign(forked(5, 9), 2);
    assert_eq!(pass(&mut node, PASSED_TIME, 4, &later), 1);
}
