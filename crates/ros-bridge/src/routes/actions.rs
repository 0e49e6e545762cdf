//! Routes of actions: a goal, its feedback and its result through the ledger.
//!
//! An action of ROS 2 is three services (send a goal, cancel it, get its result) and two topics (feedback, status). All of it
//! goes over two services of the ledger, as a service does. Requests go over the one that users hold, and what the robot says
//! over the one for replies. See [`frame`] for the bytes.
//!
//! A goal runs under the grant of whoever has set it. The bridge of the robot cancels the goals that it has passed on when the gate
//! says that the robot must stop. While a goal runs and its client is there, the user's bridge gives a sign of life, which uses the
//! grant. So a lease that ends tells the robot that the user's bridge is gone. The robot's bridge answers it with the goals that it has
//! lost: else the grant would be used for them for ever.

pub(super) mod client;
mod frame;
mod goals;
mod parts;
mod patience;
pub(super) mod server;
mod topics;
