//! From a transaction to its verdict: ordering, execution, and the clients and readers that wait for them.
//!
//! | module | content |
//! |---|---|
//! | `orderer` | the two threads that order and execute |
//! | `orderer_slot` | access to the running orderer; empty while the node synchronises |
//! | `directory` | the members of the network, from the ledger |
//! | `waiters`, `reads` | clients that wait for a verdict; readers that wait for a current state |
//! | `node_transactions`, `spoken_rules` | transactions of the node itself; the rules of execution that it speaks |

pub(crate) mod directory;
pub(crate) mod node_transactions;
pub(crate) mod orderer;
pub(crate) mod orderer_slot;
pub(crate) mod reads;
pub(crate) mod spoken_rules;
pub(crate) mod waiters;
