//! The most that is accepted from others, each checked before anything is allocated for it.

/// Longest message that zenoh assembles from fragments, in bytes. A peer that sends a longer one loses its link.
pub const MESSAGE_BYTES_MAX: usize = 64 * 1024 * 1024;
/// Longest liveliness token in bytes: twice the longest names of ROS 2 with everything around them. Longer ones are ignored.
pub const TOKEN_BYTES_MAX: usize = 2048;
/// Most endpoints of others that are known at a time. Tokens beyond it are ignored and counted.
pub const ENDPOINTS_MAX: usize = 16_384;
/// Most endpoints that are remembered after they have left.
pub const LEFT_MAX: usize = 4096;
/// Most requests at a server, or replies at a client, that wait to be taken. More are dropped and counted.
pub const WAITING_MAX: usize = 1024;
/// Most requests of a server without a reply, and most calls of a client without one. The oldest request is given up for a new one;
/// a call beyond it fails.
pub const PENDING_MAX: usize = 1024;
