//! Reads TOML files setting by setting, so that all faults of a file are found at once.
//!
//! Each fault names its line, the value that was found and the value that was wanted. An unknown setting is told with the
//! nearest known one. A reader by serde would stop at the first fault. A program takes out the settings that it knows,
//! and all others are faults.
//!
//! ```
//! use ledger_base::settings::Reader;
//! use std::path::Path;
//!
//! let mut depth = 10_u32;
//! let mut reader = Reader::parse("depht = 5\n", Path::new("queue.toml"));
//! reader.root(|root| root.integer("depth", 1..=100, &mut depth));
//! let faults = reader.finish().unwrap_err();
//! assert!(faults[0].to_string().starts_with("queue.toml:1: the top level has no setting \"depht\""));
//! assert_eq!(faults[0].rejection.advice(), "did you mean depth?");
//! ```

mod fault;
mod reader;

pub use fault::Fault;
pub use reader::{FILE_BYTES_MAX, Reader, Section, Spot, load};
