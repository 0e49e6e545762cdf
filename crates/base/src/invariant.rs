//! Invariants, stated where state changes, and the end of a process in which one does not hold.
//!
//! An invariant is a statement about this program, never about what others send: a peer, a client or a damaged disk is
//! answered with a refusal. Where a statement is false the memory of the process is not to be believed any more. So the
//! process ends at once, before a lock is poisoned or an answer is given, and says what it found. The disk is the truth:
//! the next start reads it and checks it. Ledgers that share a process share its memory, so all of them end.
//!
//! [`invariant!`] costs a comparison and stays on everywhere. [`costly_invariant!`] is for what must look at more than a
//! few values: it is on in debug builds, and in a process that called [`look_closely`], as the simulation does.
//!
//! In tests a broken invariant is a panic, which a test can expect and the simulation reports with its seed. A program
//! calls [`end_process`] once, in `main`; from then on it is the end of the process with [`EXIT_CODE`].
//!
//! ```
//! use ledger_base::invariant;
//!
//! let (committed, applied) = (7, 5);
//! invariant!(applied <= committed, "what is applied is committed", "applied {applied}, committed {committed}");
//! ```

use std::cell::Cell;
use std::fmt::Arguments;
use std::io::Write;
use std::panic::{AssertUnwindSafe, Location, PanicHookInfo, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};

/// The exit code of a process that found an invariant broken: that of an internal fault in `sysexits.h`.
pub const EXIT_CODE: i32 = 70;

/// Costly invariants are looked at.
static CLOSELY: AtomicBool = AtomicBool::new(cfg!(debug_assertions));

/// How the panic of a broken invariant begins.
const BROKEN: &str = "an invariant does not hold: ";

/// States that something holds: `invariant!(HOLDS, "the invariant as a sentence", "{values} that were found")`. The last
/// part is put into words only if it does not hold.
#[macro_export]
macro_rules! invariant {
    ($holds:expr, $invariant:literal, $($found:tt)+) => {
        if !$holds {
            $crate::invariant::broken($invariant, format_args!($($found)+));
        }
    };
}

/// As [`invariant!`], where costly ones are [looked at](looks_closely): elsewhere `HOLDS` is not even computed.
#[macro_export]
macro_rules! costly_invariant {
    ($holds:expr, $invariant:literal, $($found:tt)+) => {
        if $crate::invariant::looks_closely() {
            $crate::invariant!($holds, $invariant, $($found)+);
        }
    };
}

/// From now on this process looks at costly invariants, too.
pub fn look_closely() {
    CLOSELY.store(true, Ordering::Relaxed);
}

/// Are costly invariants looked at?
#[inline]
pub fn looks_closely() -> bool {
    CLOSELY.load(Ordering::Relaxed)
}

/// An invariant does not hold.
///
/// # Panics
/// Always, and the process ends with that if it called [`end_process`].
#[cold]
#[inline(never)]
#[track_caller]
#[expect(clippy::panic, reason = "the memory of this process is not to be believed any more")]
pub fn broken(invariant: &str, found: Arguments<'_>) -> ! {
    panic!("{BROKEN}{invariant}; found {found}")
}

/// From now on a broken invariant ends the process, on whichever thread and under whichever lock. All other panics stay
/// what they were: a chaincode's is caught and refuses its call.
pub fn end_process() {
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if let Some((invariant, found)) = read(panic) {
            end(&found, panic.location(), &invariant);
        }
        if !CAUGHT.get() {
            before(panic);
        }
    }));
}

thread_local! {
    /// A panic of this thread is an answer, and is not printed.
    static CAUGHT: Cell<bool> = const { Cell::new(false) };
}

/// Runs code of a library that panics where others return an error, such as a store on a damaged disk. Such a panic is an answer: a
/// program that called [`end_process`] prints nothing of it. A broken invariant ends the process all the same.
///
/// # Errors
/// The words of the panic.
pub fn caught<T>(body: impl FnOnce() -> T) -> Result<T, String> {
    let outer = CAUGHT.replace(true);
    let outcome = catch_unwind(AssertUnwindSafe(body));
    CAUGHT.set(outer);
    outcome.map_err(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without words").to_owned()
    })
}

/// Runs the body of a thread without which the process is of no use. If it panics the process ends: nobody would notice
/// otherwise that a thread is missing, and everything would wait for it.
pub fn vital<T>(body: impl FnOnce() -> T) -> T {
    let _ends = EndsWithPanic;
    body()
}

/// The same for a task of a runtime. One that is cancelled ends nothing.
pub async fn vital_task<T>(body: impl Future<Output = T>) -> T {
    let _ends = EndsWithPanic;
    body.await
}

/// Ends the process when it is dropped by a panic.
struct EndsWithPanic;

impl Drop for EndsWithPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let thread = std::thread::current();
            let name = thread.name().unwrap_or("without a name");
            end(
                &format!("the thread {name} panicked, as said above"),
                None,
                "threads and tasks of the node end in order",
            );
        }
    }
}

/// Invariant and what was found, if the panic is that of a broken one.
fn read(panic: &PanicHookInfo<'_>) -> Option<(String, String)> {
    let text = panic.payload().downcast_ref::<String>()?;
    let (invariant, found) = text.strip_prefix(BROKEN)?.split_once("; found ")?;
    Some((invariant.to_owned(), found.to_owned()))
}

/// Says why, and ends the process. No lock is waited for, and nothing is written but this.
fn end(found: &str, at: Option<&Location<'_>>, wanted: &str) -> ! {
    let at = at.map_or_else(String::new, |at| format!(" ({}:{})", at.file(), at.line()));
    let text = format!(
        "error: this process ends, because its memory is inconsistent\n  found   {found}{at}\n  wanted  {wanted}\n  \
         try     start it again: it reads and verifies its disk; report these lines with the log\n"
    );
    // If even that fails the exit code says enough.
    let _told = std::io::stderr().write_all(text.as_bytes());
    std::process::exit(EXIT_CODE)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    #[test]
    #[should_panic(expected = "an invariant does not hold: heights only grow; found 4 after 5")]
    fn a_broken_invariant_says_what_should_hold_and_what_was_found() {
        let (before, after) = (5, 4);
        invariant!(before < after, "heights only grow", "{after} after {before}");
    }

    #[test]
    #[expect(clippy::panic, reason = "a library that panics")]
    fn the_panic_of_a_library_is_an_answer() {
        assert_eq!(super::caught(|| 5), Ok(5));
        assert_eq!(super::caught(|| -> u8 { panic!("page {} is damaged", 7) }), Err("page 7 is damaged".to_owned()));
        assert_eq!(super::caught(|| -> u8 { panic!("damaged") }), Err("damaged".to_owned()));
    }

    #[test]
    fn a_costly_invariant_is_looked_at_in_debug_builds_and_where_somebody_says_so() {
        let looked = Cell::new(false);
        costly_invariant!(!looked.replace(true), "it was not looked at before", "it was");
        assert_eq!(looked.get(), cfg!(debug_assertions));
        super::look_closely();
        looked.set(false);
        costly_invariant!(!looked.replace(true), "it was not looked at before", "it was");
        assert!(looked.get());
    }
}
