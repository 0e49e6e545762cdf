//! Messages of other software, and hostile ones.

mod hostile;
mod installed;
mod messages;
mod rosidl;
