//! Attacks on real processes, with bytes made by hand and with real certificates. The attackers are strangers, members,
//! admins of other organisations, and nodes. The page docs/security.md names their means, and a test for each.
//!
//! | module | the attacker |
//! |---|---|
//! | `nonsense` | sends what is no good input: each kind gets a clear answer |
//! | `crowd` | opens connections, to keep others out |
//! | `greedy` | is a member that wants more of everybody's machines than is its own |
//! | `liars` | is a member, or an admin, that abuses its rights |
//! | `pretenders` | is a node that lies about the ordering protocol |
//! | `equivocation` | is a voter that signs different things for one place |
//! | `contradicted` | is an organisation whose voters make another node execute what nobody certifies |
//! | `twice` | is an organisation that runs its voter twice |
//! | `withholding` | is an elected leader that withholds control calls |
//! | `target` | the node that is attacked, and its people |
//!
//! A node that lies to its own robot is in `tests/interop`, as that needs a bridge.

#![expect(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, clippy::print_stdout, reason = "tests")]

mod contradicted;
mod crowd;
mod equivocation;
mod greedy;
mod liars;
mod nonsense;
mod pretenders;
mod target;
mod twice;
mod withholding;

use ledgerd_support as support;
