//! Stores on simulated and real disks.

mod audit;
mod block_store;
