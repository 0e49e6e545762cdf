//! Tmp.
pub mod client;
pub mod clock;
pub mod coverage;
pub mod history;
pub mod invariant;
pub mod links;
pub mod node;
pub mod oracle;
pub mod people;
pub mod plan;
pub mod policy;
pub mod random;
pub mod run;
pub mod trace;
pub mod world;
