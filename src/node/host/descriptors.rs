//! File descriptors: each connection takes one, and so does each file of the log. A process without a free one can make
//! no new segment, so connections get a part of them only.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Limit that is taken for one where the system has none.
const UNLIMITED: u64 = 65_536;
/// Most places of each kind at the door, whatever the limit.
const DOOR_MAX: u64 = 512;
/// Fewest places of each kind at the door, whatever the limit.
const DOOR_MIN: u64 = 16;

/// How many connections of each kind a process may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Connections {
    /// Handshakes with addresses from which no member has come.
    pub(super) handshakes: usize,
    /// Handshakes with addresses from which a member has come.
    pub(super) known_handshakes: usize,
    /// Established, without a certificate.
    pub(super) strangers: usize,
    /// Established, with a certificate.
    pub(super) members: usize,
}

/// Raises the limit of this process as far as it may, and divides it.
pub(super) fn divide() -> Connections {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let _as_it_was = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    let reached = getrlimit(Resource::Nofile).current.or(current).unwrap_or(UNLIMITED);
    parts_of(reached)
}

/// A quarter is left for files and everything else.
fn parts_of(limit: u64) -> Connections {
    let door = (limit / 8).clamp(DOOR_MIN, DOOR_MAX);
    let members = limit.saturating_sub(limit / 4 + 3 * door).max(DOOR_MIN);
    let count = |number| usize::try_from(number).unwrap_or(usize::MAX);
    Connections {
        handshakes: count(door),
        known_handshakes: count(door),
        strangers: count(door),
        members: count(members),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_of_the_descriptors_is_left_for_files_whatever_connects() {
        for limit in [256, 1024, 4096, 65_536, 1 << 20] {
            let parts = parts_of(limit);
            let all = parts.handshakes + parts.known_handshakes + parts.strangers + parts.members;
            assert!(all as u64 <= limit - limit / 4, "{limit}: {parts:?}");
        }
    }

    #[test]
    fn few_descriptors_still_leave_a_place_of_each_kind() {
        let parts = parts_of(20);
        assert!(parts.handshakes > 0 && parts.known_handshakes > 0 && parts.strangers > 0 && parts.members > 0);
    }
}
