//! Who this node is and whom it trusts: certificates of organisations and nodes.
//!
//! | module | content |
//! |---|---|
//! | `credentials` | the node's certificate and key, and the CAs whose keys it holds |
//! | `membership` | which of the network's nodes this is |
//! | `organisations` | the organisations on the ledger, for TLS |
//! | `ca` | the certificate authority of an organisation |
//! | `enrolment` | its API: enrolment secrets, certificates, moving a CA |
//! | `renewal` | replacing the node's certificate before it expires |

pub mod ca;
pub(crate) mod credentials;
pub(crate) mod enrolment;
pub(crate) mod membership;
pub(crate) mod organisations;
pub(crate) mod renewal;
