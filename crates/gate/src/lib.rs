//! The decisions of a robot that trusts no single node: which message passes, when the robot must stop, and when to ask how it
//! stands.
//!
//! Nothing here does IO, reads a clock or has a thread: events and times come in, acts go out. The bridge drives it between a
//! gateway and a ROS 2 graph, and the simulation does between nodes that lie and nothing.
//!
//! | module | what is in it |
//! |---|---|
//! | [`guard`] | one service of a robot: what comes from a node, and what is to be done then; when to ask, when to stop |
//! | [`gate`] | whether a message passes |
//! | [`standing`] | how a robot stands, as the voters have signed it |
//! | [`service`] | the service and the events of the ledger, as far as they are read here |
//! | [`sample`] | one message as raw CDR, in the form that travels on the ledger |
//! | [`speed`] | the speed that a message asks for, and how it is brought down to a limit |

#[cfg(any(test, feature = "fixture"))]
pub mod fixture;
pub mod gate;
pub mod guard;
pub mod sample;
pub mod service;
pub mod speed;
pub mod standing;

/// The access-control chaincode.
pub const ABAC: &str = "abac";
/// The chaincode that knows revocations.
pub const MSP: &str = "msp";
