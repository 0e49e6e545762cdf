//! Policies: how they are listed, and what changing one does.

use crate::grant::Released;
use serde::{Deserialize, Serialize};

/// A policy, as `policies` lists it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyEntry {
    /// The organisation about whose robots it decides; empty for the built-in one, which decides about the robots
    /// of every organisation that has no policy of its own.
    pub organisation: String,
    /// Its id within the organisation.
    pub id: String,
    /// Cedar.
    pub text: String,
}

/// Answer of `policy put` and `policy remove`, and payload of the event `policy`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyChange {
    /// The organisation whose policies changed.
    pub organisation: String,
    /// The policy that changed.
    pub id: String,
    /// `put` or `removed`.
    pub change: String,
    /// Is the built-in policy in force now, because the organisation has none of its own?
    pub default_in_force: bool,
    /// The grants that the change ended. If they are very many, the rest ends with the next blocks.
    pub ended: Vec<Released>,
}
