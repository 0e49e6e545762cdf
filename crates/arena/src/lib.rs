//! The paper's experiment without its network: what drives, what is measured, what is claimed, and the pictures of it.
//!
//! Pure: no process, socket, clock or file. Time is in seconds since the begin of a run, lengths in metres, angles in
//! radians. `ledgerd demo --arena` puts real nodes, bridges and DDS between these parts; docs/arena.md describes it.
//!
//! # Map
//! | module | what is in it |
//! |---|---|
//! | [`geometry`] | points, poses, angles |
//! | [`course`] | the arena, the users, their waypoints, the order that each run plans |
//! | [`robot`] | the simulated Turtlebot4 |
//! | [`controller`] | a user's controller |
//! | [`link`] | a link with delay, jitter and loss |
//! | [`noise`] | seeded random numbers |
//! | [`record`] | everything that was seen in a run |
//! | [`figures`] | the numbers of a run |
//! | [`claims`] | what must be true of them |
//! | [`baseline`] | figures of others, to compare with |
//! | [`picture`] | pictures of it, and the page |
//!
//! # Example
//! ```
//! use arena::{controller::Controller, course::{Course, User}, robot::Turtlebot};
//!
//! let course = Course::new(1.0);
//! let mut robot = Turtlebot::new(course.start());
//! let mut salma = Controller::new(course.waypoints(User::Salma));
//! for tick in 0..500 {
//!     let now = f64::from(tick) * 0.02;
//!     robot.advance(now);
//!     salma.hear(now, now, robot.pose());
//!     robot.command(now, salma.command(now));
//! }
//! assert!(salma.reached() >= 1, "A1 is two metres away");
//! ```

#![cfg_attr(test, expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests"))]

pub mod baseline;
pub mod claims;
pub mod controller;
pub mod course;
pub mod figures;
pub mod geometry;
pub mod link;
pub mod noise;
pub mod picture;
pub mod record;
pub mod robot;

#[cfg(test)]
mod drill;
