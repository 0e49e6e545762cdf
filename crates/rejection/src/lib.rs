//! Refusals that explain themselves, and their stable codes.
//!
//! Every crate refuses with a [`Rejection`]: a [`Code`], and what was found, what was wanted, and what to do next. The
//! [`Class`] of a code decides the exit code of command-line tools.
//!
//! ```
//! use ledger_rejection::{Code, Rejection};
//!
//! let refused = Rejection::new(Code::UnknownRobot, "no robot is registered as Husky").wanted("Turtlebot4");
//! assert_eq!(refused.to_string(), "no robot is registered as Husky [LGR-3003]\n  wanted  Turtlebot4");
//! assert_eq!(refused.code.class().exit_code(), 3);
//! ```

mod code;
mod rejection;

pub use code::{Class, Code};
pub use rejection::Rejection;
