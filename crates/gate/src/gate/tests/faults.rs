//! A gate whose own memory is wrong.

use super::super::Holding;
use super::*;

#[test]
fn a_gate_that_contradicts_itself_lets_nothing_pass_any_more() {
    let network = Network::default();
    let held = [grant("Org1/Salma", 4)];
    let breaks: [fn(&mut Gate); 2] = [
        // The newest epoch is forgotten.
        |gate| gate.epoch = 2,
        // The holder is mistaken for one of another epoch.
        |gate| {
            gate.holders.insert("Org1/Farhad".into(), Holding::of(&grant("Org1/Farhad", 9), NOW));
        },
    ];
    for broken in breaks {
        let mut gate = network.gate(&service("exclusive"), &held);
        assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(4, 1, &TWIST)), Ok(1));
        broken(&mut gate);
        gate.released(&released("Org1/Nobody", gate.epoch), NOW, now());
        assert!(gate.fault().is_some_and(|found| found.contains("epoch")), "{:?}", gate.fault());
        learn(&mut gate, &network, &service("exclusive"), &held);
        let next = network.salma.set(4, 2, &TWIST);
        assert_eq!(deliver(&mut gate, &network.salma, &next), Err(Refused::NoService), "a standing does not open it");
    }
}
