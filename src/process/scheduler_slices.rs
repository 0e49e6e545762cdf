//! Short turns on a processor for threads on which many wait, while many wait.
//!
//! Where more threads want processors than there are, a thread that becomes ready waits for the turns of others, some 3
//! ms each. A call that gives or ends control passes a handful of threads. Linux (6.12 and later) lets a thread ask for
//! shorter turns of its own: it gets no more of the processors, but gets its part earlier (`sched_runtime` in
//! sched_setattr(2)). While little is to do they are only in the way: a thread that was just woken would interrupt the
//! one that is about to finish. Only the profile `low-latency` asks for them. Figures are in docs/experiments.md.

use crate::process::config::Profile;
use std::cell::Cell;
use std::io;
use std::time::{Duration, Instant};

/// The shortest turn that can be asked for, nanoseconds.
const SHORTEST: u64 = 100_000;
/// Stands for a turn as long as any other thread's.
const USUAL: u64 = 0;
/// Turns stay short for so long after the last time that many waited.
const RUSH: Duration = Duration::from_millis(100);

thread_local! {
    /// While turns are short: until when at least.
    static SHORT_UNTIL: Cell<Option<Instant>> = const { Cell::new(None) };
}

/// `struct sched_attr` of sched_setattr(2), as of its first version.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Attributes {
    size: u32,
    policy: u32,
    flags: u64,
    nice: i32,
    priority: u32,
    runtime: u64,
    deadline: u64,
    period: u64,
}

const ATTRIBUTES_BYTES: u32 = size_of::<Attributes>() as u32;

/// Whether threads may ask for short turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turns {
    /// Never.
    Usual,
    /// While many wait.
    Short,
}

impl Turns {
    /// The turns that the profile wants.
    pub(crate) fn of(profile: Profile) -> Self {
        match profile {
            Profile::Balanced => Self::Usual,
            Profile::LowLatency => Self::Short,
        }
    }

    /// Gives the calling thread short turns while many wait on it, and usual ones again a while after. Where the system
    /// knows no such turns, nothing happens.
    pub(crate) fn adapt(self, many_wait: bool) {
        if self == Self::Short {
            adapt(many_wait);
        }
    }
}

fn adapt(many_wait: bool) {
    let (now, until) = (Instant::now(), SHORT_UNTIL.get());
    if many_wait {
        SHORT_UNTIL.set(Some(now + RUSH));
    } else if until.is_some_and(|until| until <= now) {
        SHORT_UNTIL.set(None);
    }
    let runtime = match (until, SHORT_UNTIL.get()) {
        (None, Some(_)) => SHORTEST,
        (Some(_), None) => USUAL,
        _ => return,
    };
    if let Err(error) = attributes().and_then(|attributes| set(&Attributes { runtime, ..attributes })) {
        tracing::debug!(%error, "cannot set the time slice of a thread");
    }
}

#[expect(unsafe_code, reason = "the C library has no function for it")]
fn attributes() -> io::Result<Attributes> {
    let mut attributes = Attributes::default();
    // SAFETY: the kernel writes at most the size it is given, that of the structure; 0 is the calling thread.
    let done = unsafe { libc::syscall(libc::SYS_sched_getattr, 0, &raw mut attributes, ATTRIBUTES_BYTES, 0) };
    if done == 0 { Ok(attributes) } else { Err(io::Error::last_os_error()) }
}

#[expect(unsafe_code, reason = "the C library has no function for it")]
fn set(attributes: &Attributes) -> io::Result<()> {
    // SAFETY: the kernel reads as many bytes as the structure says it has, its own size; 0 is the calling thread.
    let done = unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const *attributes, 0) };
    if done == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_balanced_profile_changes_no_turn() {
        let usual = attributes().unwrap();
        Turns::of(Profile::Balanced).adapt(true);
        assert_eq!((attributes().unwrap(), SHORT_UNTIL.get()), (usual, None));
    }

    #[test]
    fn only_the_length_of_turns_changes_and_only_for_this_thread() {
        let others = attributes().unwrap();
        assert_eq!(others.size, ATTRIBUTES_BYTES);
        let of_a_thread = std::thread::spawn(|| {
            set(&Attributes { nice: 3, ..attributes().unwrap() }).unwrap();
            let usual = attributes().unwrap();
            let turns = Turns::of(Profile::LowLatency);
            turns.adapt(false);
            assert_eq!(attributes().unwrap(), usual);
            turns.adapt(true);
            let shortened = attributes().unwrap();
            SHORT_UNTIL.set(Some(Instant::now() + 1000 * RUSH));
            turns.adapt(false);
            assert_eq!(attributes().unwrap(), shortened, "not at once");
            SHORT_UNTIL.set(Some(Instant::now()));
            turns.adapt(false);
            assert_eq!(attributes().unwrap(), usual);
            (usual, shortened)
        });
        let (usual, shortened) = of_a_thread.join().unwrap();
        assert_eq!(shortened, Attributes { runtime: shortened.runtime, ..usual });
        // Kernels before 6.12 know no turns of a thread's own.
        assert!([0, SHORTEST].contains(&shortened.runtime), "{shortened:?}");
        assert_eq!(attributes().unwrap(), others);
    }
}
