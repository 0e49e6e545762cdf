//! `status`, `block`, `tx`: the node and its chain.

mod block;
mod event;
mod status;
mod tx;

pub(crate) use block::Block;
pub(crate) use status::Status;
pub(crate) use tx::Tx;

/// The printed form of a code that may be unknown to this version.
fn code_text(number: u32) -> String {
    if number == 0 { "OK".to_owned() } else { format!("LGR-{number:04}") }
}
