//! Replicas on simulated disks and networks.

mod barrier;
mod catch_up;
mod chaos;
mod clocks;
mod cluster;
mod driver;
mod members;
mod ordering;
mod reads;
mod trust;
mod voting;
