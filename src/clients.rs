//! What clients call: the gRPC gateway, the console, and the pages for monitoring.
//!
//! | module | content |
//! |---|---|
//! | `gateway` | the gRPC API |
//! | `audit` | an index of who did what |
//! | `rejections`, `rejection_reports` | rejected calls; reporting them to the ledger |
//! | `monitoring`, `health` | readiness and metrics over HTTP; health over gRPC |
//! | `console` | the console for browsers |

pub(crate) mod audit;
pub(crate) mod console;
pub(crate) mod gateway;
pub(crate) mod health;
pub(crate) mod monitoring;
pub(crate) mod rejection_reports;
pub(crate) mod rejections;
