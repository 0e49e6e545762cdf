//! Messages of other software, and hostile ones.

mod hostile;
mod messages;
