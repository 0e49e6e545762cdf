//! Enrolment: a node records the certificates of those who may receive a service. Only whom the ledger knows by name is
//! passed anything.

use super::Call;
use crate::people::{CERTIFICATES, ca_key};
use crate::world::World;
use ledger::msp::CarryCa;

/// Those who have enrolled.
const ENROLLED: [(&str, &str); 5] =
    [("Org1", "Salma"), ("Org1", "Farhad"), ("Org1", "Nina"), ("Org2", "Owen"), ("Org2", "Mallory")];
/// The node that carries the CAs.
const CARRIER: u64 = 1;

impl World {
    /// Has a node record certificates, where somebody may be passed a service.
    pub(super) fn enrol(&mut self) {
        if !self.plan.contests {
            return;
        }
        let node = self.people.node(CARRIER, self.plan.organisations).id();
        let carry = |organisation| {
            let CarryCa { proof, .. } = CarryCa::prove(&self.network, organisation, &node, &ca_key(organisation));
            Call::Carry { organisation, proof }
        };
        let mut orders: Vec<Call> = ["Org1", "Org2"].map(carry).into();
        // The certificate that a person uses first is recorded last: the newest on the ledger is the one in use.
        for nth in (0..CERTIFICATES).rev() {
            let recorded = ENROLLED.iter().filter_map(|(organisation, name)| {
                let at = self.people.index(&format!("{organisation}/{name}"), nth)?;
                let certificate = hex::encode(&self.people.all.get(at)?.certificate);
                Some(Call::Record { organisation, certificate })
            });
            orders.extend(recorded);
        }
        self.employ_for(&node, orders, true);
    }
}
