//! Changes of the state: grants, the queue, tasks, confirmation, delegation, and the ends of all of them.
//!
//! A change of a record returns what [follows](follow_up::FollowUp) from it. One loop [settles](settle::settle) all of that. Each
//! module knows only those above it in this table:
//!
//! | modules | content |
//! |---|---|
//! | `capacity`, `follow_up`, `people`, `stops`, `looks`, `lease_bounds`, `contest`, `holders` | what changes look at |
//! | `grants`, `tasks`, `queue`, `confirmation` | changes of a grant, a task, a place in the queue, a request to be confirmed |
//! | `settle` | the loop |
//! | `acquisition`, `delegation`, `departures`, `task_ends` | how a right is acquired, passed on and lost |
//! | `undecided`, `turns`, `ends`, `robots`, `registration` | what begins without a call of the holder: turns, expiry, revocation, other policies or robots |
//! | `publishing`, `subscribing`, `content_keys` | the rights to publish and to read |
//! | `policy_approvals`, `policy_sets`, `policy_proposals`, `reachable`, `access` | the sets of policies, and whom they let do what |

pub(crate) mod access;
pub(crate) mod acquisition;
pub(crate) mod capacity;
pub(crate) mod confirmation;
pub(crate) mod content_keys;
pub(crate) mod contest;
pub(crate) mod delegation;
pub(crate) mod departures;
pub(crate) mod ends;
pub(crate) mod follow_up;
pub(crate) mod grants;
pub(crate) mod holders;
pub(crate) mod lease_bounds;
pub(crate) mod looks;
pub(crate) mod people;
pub(crate) mod policy_approvals;
pub(crate) mod policy_proposals;
pub(crate) mod policy_sets;
pub(crate) mod publishing;
pub(crate) mod queue;
pub(crate) mod reachable;
pub(crate) mod registration;
pub(crate) mod robots;
pub(crate) mod settle;
pub(crate) mod stops;
pub(crate) mod subscribing;
pub(crate) mod task_ends;
pub(crate) mod tasks;
pub(crate) mod turns;
pub(crate) mod undecided;
