//! The end of a process in which an invariant does not hold. Each case is a process of its own: this one, started
//! again to play one case.
#![expect(clippy::panic, clippy::unwrap_used, reason = "tests")]

use ledger_base::invariant;
use ledger_base::invariant::{EXIT_CODE, end_process, vital, vital_task};
use std::future::{pending, poll_fn};
use std::pin::pin;
use std::process::{Command, Output};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll, Waker};

/// Names the case that a started process plays.
const CASE: &str = "LEDGER_INVARIANT_CASE";

#[test]
fn plays_one_case_in_a_process_of_its_own() {
    let Ok(case) = std::env::var(CASE) else { return };
    end_process();
    let thread = |body: fn()| std::thread::Builder::new().name("order".into()).spawn(move || vital(body)).unwrap();
    match case.as_str() {
        "under a lock" => {
            let lock = Arc::new(Mutex::new(3));
            let (held, wanted) = (Arc::clone(&lock), lock);
            drop(std::thread::spawn(move || {
                let term = held.lock().unwrap();
                invariant!(*term > 4, "the term never goes back", "term {term} after 4");
            }));
            loop {
                // Whoever comes for the lock later, or finds it poisoned, must not live to see it.
                drop(wanted.lock());
                std::thread::yield_now();
            }
        }
        "caught" => {
            let caught = std::panic::catch_unwind(|| invariant!(1 > 2, "one is more than two", "it is not"));
            panic!("it goes on with {caught:?}");
        }
        "another panic" => drop(thread(|| panic!("an index out of bounds")).join()),
        "a panic that is caught" => {
            let body = || drop(std::panic::catch_unwind(|| panic!("of a chaincode")));
            assert!(thread(body).join().is_ok());
        }
        "a panic of a task" => {
            let mut task = pin!(vital_task(poll_fn(|_| -> Poll<()> { panic!("an index out of bounds") })));
            let polled = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                let _never = task.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            }));
            panic!("it goes on with {polled:?}");
        }
        "a task that is cancelled" => {
            let mut task = Box::pin(vital_task(pending::<()>()));
            assert!(task.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_pending());
            drop(task);
        }
        other => panic!("no case {other}"),
    }
}

fn play(case: &str) -> (Option<i32>, String) {
    let Output { status, stderr, .. } = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "plays_one_case_in_a_process_of_its_own", "--nocapture"])
        .env(CASE, case)
        .output()
        .unwrap();
    (status.code(), String::from_utf8_lossy(&stderr).into_owned())
}

#[test]
fn a_broken_invariant_ends_the_process_before_anybody_finds_the_lock_poisoned() {
    let (code, said) = play("under a lock");
    assert_eq!(code, Some(EXIT_CODE), "{said}");
    let found = "found   term 3 after 4 (crates/base/tests/ending.rs:";
    assert!(said.contains(found) && said.contains("wanted  the term never goes back\n"), "{said}");
}

#[test]
fn a_broken_invariant_cannot_be_caught() {
    let (code, said) = play("caught");
    assert_eq!(code, Some(EXIT_CODE), "{said}");
    assert!(said.contains("found   it is not"), "{said}");
}

#[test]
fn any_panic_of_a_vital_thread_ends_the_process() {
    let (code, said) = play("another panic");
    assert_eq!(code, Some(EXIT_CODE), "{said}");
    assert!(said.contains("an index out of bounds") && said.contains("the thread order panicked"), "{said}");
}

#[test]
fn a_panic_that_is_caught_on_a_vital_thread_ends_nothing() {
    let (code, said) = play("a panic that is caught");
    assert_eq!(code, Some(0), "{said}");
}

#[test]
fn any_panic_of_a_vital_task_ends_the_process_although_the_runtime_would_catch_it() {
    let (code, said) = play("a panic of a task");
    assert_eq!(code, Some(EXIT_CODE), "{said}");
    assert!(said.contains("an index out of bounds"), "{said}");
}

#[test]
fn a_vital_task_that_is_cancelled_ends_nothing() {
    let (code, said) = play("a task that is cancelled");
    assert_eq!(code, Some(0), "{said}");
}
