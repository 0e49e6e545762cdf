//! Routes of calls of ROS 2 services: the user's side serves them ([`server`]), the robot's side calls ([`client`]).

pub(super) mod client;
pub(super) mod server;
