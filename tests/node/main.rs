//! Real processes, real TLS, real disks: `ledgerd` and `ledgerctl` as users run them, and as disks and enemies treat
//! them.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    unreachable_pub,
    reason = "tests"
)]

mod admin;
mod attributes;
mod audit;
mod backup;
mod ca;
mod catch_up;
mod certified;
mod clocks;
mod confidential;
mod config;
mod console;
mod contexts;
mod crash;
mod disasters;
mod disk_full;
mod doctor;
mod early;
mod examples;
mod fabric;
mod footprint;
mod formats;
mod histories;
mod http;
mod instances;
mod join;
mod keep;
mod lab;
mod languages;
mod leadership;
mod live;
mod members;
mod messages;
mod minority;
mod monitoring;
mod network;
mod nodes;
mod older;
mod output;
mod overload;
mod packaging;
mod passing;
mod policies;
mod power;
mod proofs;
mod readers;
mod rebuild;
mod reference;
mod renewal;
mod rules;
mod shares;
mod sharing;
mod story;
mod subscribing;
mod tasks;
mod three;
mod transcripts;
mod two_nodes;
mod verify;
mod witness;

use ledgerd_support::{self as support, two_networks};
use testkit::own_network;
