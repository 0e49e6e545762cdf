//! The decisions of a node between a socket and the engine, as state machines.
//!
//! Nothing here has a thread, a socket, a file or a clock of its own. A node's threads tell a [`Replica`] what happened
//! and when, and do what it says. The simulation (`tests/sim`) drives the same code in virtual time.
//!
//! | module | what is there |
//! |---|---|
//! | `replica` | [`Replica`]: the engine and its duties; events in, effects out |
//! | [`conductor`] | when a node has an engine: starting, ending, catching up |
//! | [`catch_up`] | what a node fetches from others, from whom, and whom it believes |
//! | [`company`] | what the others say while the node runs, and what it stops for |
//! | [`opening`] | opening what a node computed, which is rebuilt from the blocks if there is any doubt |
//! | [`trust`] | whether a snapshot is believed |
//! | [`certifier`] | what a voter states about its blocks, and when enough voters have signed |
//! | [`disputes`] | proofs of misbehaviour, and certificates of other blocks: what is believed, and what a node stops for |
//! | `voting` | [`Voting`]: signs votes in elections, and checks those of others |
//! | [`witness`] | what a node attests, and when |
//! | `executor` | [`Executor`]: applies committed blocks and tells the [`Observer`]s |
//! | `clock` | [`Clock`]: the time of a ledger, which never goes back |
//! | [`space`] | what is accepted with the space that the disk has, and who says that it is full |
//! | `budgets` | [`Budgets`]: bytes and messages a second of identities, organisations and services |
//! | `timing` | [`Timing`]: ticks, elections, and how long data waits |
//! | `in_place` | which blocks the thread that orders executes itself |
//! | `early` | [`Early`]: which calls readers hear of before they are ordered |
//! | [`gateway`] | calls that want to be ordered: shares, turns, lanes, admission |
//! | `ticks` | when the thread that orders wakes up by itself |
//! | `retries` | how many refused repetitions of one identity are ordered |
//! | `reads` | [`Reads`]: is the state as new as what was committed when somebody asked? |
//! | `withheld` | control calls that wait, and when a voter complains about its leader |
//! | `waiters` | [`Waiters`]: who waits for which verdict, and which verdict is the transaction's own |
//!
//! A turn of the thread that orders, for a replica that has everything it needs:
//!
//! ```
//! use ledger_storage::block_store::BlockStore;
//! use ledger_replica::{Circumstances, Effect, Event, Now, Replica, Waiter, Work};
//!
//! fn turn<W: Waiter>(replica: &mut Replica<W>, store: &BlockStore, now: Now, inputs: Vec<Event>) -> Vec<Effect> {
//!     let mut effects = Vec::new();
//!     for event in inputs {
//!         replica.step(now, event, &mut effects);
//!     }
//!     replica.step(now, Event::Time { full: false }, &mut effects);
//!     if replica.must_write(now) {
//!         replica.step(now, Event::Written(store.flush().map(drop)), &mut effects);
//!     }
//!     match replica.work(Circumstances { inputs_wait: false, other_is_idle: true }) {
//!         Some(Work::Here(_blocks)) => { /* execute, then tell Event::Executed */ }
//!         Some(Work::Elsewhere(_blocks)) => { /* give them to the thread that executes */ }
//!         None => {}
//!     }
//!     effects
//! }
//! ```

#![forbid(unsafe_code)]

mod budgets;
pub mod catch_up;
pub mod certifier;
mod clock;
pub mod company;
pub mod conductor;
pub mod disputes;
mod early;
mod executor;
pub mod gateway;
mod in_place;
pub mod offsets;
pub mod opening;
mod reads;
mod replica;
mod retries;
pub mod space;
mod ticks;
mod timing;
pub mod trust;
mod voting;
mod waiters;
mod withheld;
pub mod witness;

pub use budgets::{BURST, Budgets};
pub use clock::Clock;
pub use early::{Early, Foreseen};
pub use executor::{Executor, Observer, in_turns};
pub use in_place::Circumstances;
pub use reads::{Asker, CONFIRM_TIME_MAX, Known, ReadEffect, Reads, WAIT_FOR_HEIGHT};
pub use replica::{Effect, Event, FULL_DISK_PAUSE, LEARNER_WRITE_DELAY, Last, Now, Replica, Settings, Work};
pub use retries::Retries;
pub use timing::{ELECTION_TIME_MAX, ELECTION_TIME_MIN, Timing};
pub use voting::Voting;
pub use waiters::{Answer, Executed, WAIT_MAX, Waiter, Waiters};

/// How a node comes back that must not go on as it is.
pub const REJOIN: &str = "ledgerd rejoin --config FILE";
