//! The rules of the repository: what a reviewer would say twice.

#![expect(clippy::panic, clippy::indexing_slicing, reason = "tests")]

mod access;
mod architecture;
mod book;
mod circles;
mod clients;
mod codes;
mod documents;
mod driver;
mod enums;
mod events;
mod hints;
mod idiom;
mod invariants;
mod keys;
mod layers;
mod links;
mod logs;
mod pictures;
mod protos;
mod routes;
mod security;
mod sources;
mod words;
