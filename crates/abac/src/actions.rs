//! The actions: one file for each function of the chaincode, or for few that belong together.
//!
//! An action reads its arguments, asks the policies who may and the rules who wins, and changes the records.

pub(crate) mod acquire;
mod attributes;
pub(crate) mod authorize;
pub(crate) mod can;
pub(crate) mod confidential;
pub(crate) mod confirm;
pub(crate) mod contest;
pub(crate) mod delegate;
pub(crate) mod describe;
pub(crate) mod emergency;
pub(crate) mod end;
pub(crate) mod follow;
pub(crate) mod hold;
pub(crate) mod policies;
pub(crate) mod policy_proposals;
pub(crate) mod policy_rules;
pub(crate) mod policy_sets;
pub(crate) mod publish;
pub(crate) mod queue;
mod reachable;
pub(crate) mod release;
pub(crate) mod renew;
pub(crate) mod robots;
pub(crate) mod settings;
pub(crate) mod show;
pub(crate) mod side_door;
pub(crate) mod task_list;
pub(crate) mod task_turns;
pub(crate) mod tasks;
pub(crate) mod together;
pub(crate) mod undecided;

/// Name of the chaincode.
pub(crate) const NAME: &str = "abac";
