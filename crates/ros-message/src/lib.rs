//! ROS 2 messages by their definitions: bytes as DDS carries them to values that people read, and back.
//!
//! A [`Library`] holds definitions in the text formats of `.msg`, `.srv` and `.action` files; those of the common types are built in. A
//! [`Message`] is one of them with everything that it contains, and reads and writes CDR. That is version 1, both byte
//! orders, with the encapsulation header of four bytes in front, as every ROS 2 middleware sends it. People write
//! messages as YAML, as after `ros2 topic pub`; JSON is YAML, too.
//!
//! ```
//! use ros_message::{ByteOrder, Library, Time, Written};
//!
//! let mut library = Library::builtin();
//! let twist = library.message("geometry_msgs/msg/Twist")?;
//! let written = Written::parse("{linear: {x: 0.5}, angular: {z: 0.1}}")?;
//! let bytes = twist.encode(&written, ByteOrder::Little, Time::default())?;
//! assert_eq!(bytes.len(), 4 + 48);
//! twist.check(&bytes)?;
//! assert!(twist.decode(&bytes)?.to_yaml(None).starts_with("linear:\n  x: 0.5\n"));
//! # Ok::<(), ros_message::Fault>(())
//! ```
//!
//! Nothing here knows a file, a network or a clock. Bytes come from anybody: lengths are checked before anything is
//! allocated, nesting is bounded, and nothing panics.
//!
//! | module | what is there |
//! |---|---|
//! | `definition`, `name` | the text format of `.msg` files as rosidl reads it; names |
//! | `interface` | the messages that make up a service or an action |
//! | `library`, `message` | definitions by name; a definition with everything that it contains |
//! | `cdr` | reading and writing aligned numbers and strings |
//! | `decode`, `encode`, `check` | CDR to a value; what a person wrote to CDR; whether bytes can be a message |
//! | `hash`, `text` | the hash of a type, by which ROS 2 nodes compare definitions; a definition as text, for recordings |
//! | `value` | a decoded message, as JSON and YAML |
//! | `written`, `yaml` | what a person wrote; YAML text |
//! | `fault` | what was refused, what was found, what was wanted, what to do |

mod cdr;
mod check;
mod decode;
mod definition;
mod encode;
mod fault;
mod hash;
mod interface;
mod library;
mod message;
mod name;
mod text;
mod value;
mod written;
mod yaml;

pub use cdr::ByteOrder;
pub use encode::{MESSAGE_BYTES_MAX, Time};
pub use fault::Fault;
pub use library::Library;
pub use message::Message;
pub use value::Value;
pub use written::Written;
