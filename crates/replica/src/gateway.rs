//! The decisions of a gateway about calls that want to be ordered, before they reach the engine.
//!
//! | module | what is there |
//! |---|---|
//! | `entrance` | [`Entrance`]: what is refused without looking closer; the lane of a call |
//! | `share` | [`Shares`]: how much of one identity and one organisation may be in flight |
//! | `turns` | [`Turns`]: who looks at transactions now, in turns between organisations, and within each between identities |
//! | `line` | what has come over one stream: order of lanes, and what waited too long |
//! | `held` | what the state refuses, until it is known whether the state is current, and what waits behind it |
//! | `admission` | [`Admitting`]: order a transaction, answer it, or hold it |
//! | `desk` | [`Desk`]: all of this for one stream |

mod admission;
mod desk;
mod entrance;
mod held;
mod line;
mod share;
mod turns;

pub use admission::{Admitting, Decision, id_of};
pub use desk::{Desk, Job, Looked};
pub use entrance::{Call, Entrance, Turned};
pub use held::Item;
pub use line::{Arrived, Ticket};
pub use share::{InFlight, Share, Shares};
pub use turns::{Applicant, Turn, Turns};
