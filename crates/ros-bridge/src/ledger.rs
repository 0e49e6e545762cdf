//! The ledger as the bridge uses it: calls and events, the grants of readers, services, and the certified state of a robot.

#[cfg(test)]
pub(crate) mod fake;
pub(crate) mod gateway;
mod reader_slot;
pub(crate) mod robot_state;
pub(crate) mod service;
