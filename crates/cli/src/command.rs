//! The commands, one file per group. Each is a struct of its arguments and a `run`.

pub(crate) mod audit;
pub(crate) mod bridge;
pub(crate) mod ca;
pub(crate) mod can;
pub(crate) mod chaincode;
pub(crate) mod completions;
pub(crate) mod console;
pub(crate) mod context;
pub(crate) mod denials;
pub(crate) mod emergency;
pub(crate) mod enroll;
pub(crate) mod explain;
pub(crate) mod grant;
pub(crate) mod identity;
pub(crate) mod ledger;
pub(crate) mod light;
pub(crate) mod message;
pub(crate) mod network;
pub(crate) mod policy;
pub(crate) mod prove;
pub(crate) mod readers;
pub(crate) mod record;
pub(crate) mod replay;
pub(crate) mod robot;
pub(crate) mod task;
pub(crate) mod whoami;
