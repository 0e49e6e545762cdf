//! A running bridge: its routes, and what they have done.

mod graph_loss;
mod renewal;
mod run;
mod running;
mod start;

#[cfg(test)]
mod tests;

pub use self::{
    renewal::keep_renewed,
    run::run,
    running::{Bridge, Summary},
};
