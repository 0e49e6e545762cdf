//! Tmp.
fn main() {}
