//! Messages as JSON that only this API has. Those that `ledgerctl -o json` prints as well are in [`ledger_api::facts`].

mod delivery;
mod network;
mod node;

pub(super) use delivery::DeliveryFacts;
pub(super) use network::NetworkFacts;
pub(super) use node::NodeFacts;
