//! Memory that is no longer needed goes back to the operating system.
//!
//! glibc learns from its use: once a large buffer was freed, such buffers and everything around them stay with the
//! process from then on. That is up to tens of megabytes. That fits a program that needs as much again. A node on a
//! robot needs it in its first second and after a burst, so it keeps the thresholds where they start (mallopt(3)).
//!
//! There each buffer of more than 128 KiB is fetched from the operating system page by page, and given back. With images of
//! 1 MB that is a third of the processor time of a bridge. So a process that has such messages keeps some memory for
//! the next one.

use std::sync::Once;

/// Bytes that are asked for in advance: the value that holds anyway. Setting it is what ends the learning.
#[cfg(target_env = "gnu")]
const TOP_PAD_BYTES: libc::c_int = 128 * 1024;
/// Messages from this size on are large.
const LARGE_BYTES: usize = 256 * 1024;
/// With large messages: buffers up to this size come from the heap. A message has at most 4 MiB, and is packed with
/// some more.
#[cfg(target_env = "gnu")]
const HEAP_BYTES_MAX: libc::c_int = 8 * 1024 * 1024;
/// With large messages: free bytes that a heap keeps at its end.
#[cfg(target_env = "gnu")]
const KEPT_BYTES_MAX: libc::c_int = 8 * 1024 * 1024;

/// To be called once, first. False if the allocator does not know the setting; then more memory is kept, nothing else.
#[cfg(target_env = "gnu")]
pub(crate) fn give_back() -> bool {
    set(libc::M_TOP_PAD, TOP_PAD_BYTES)
}

/// Other allocators do not learn.
#[cfg(not(target_env = "gnu"))]
pub(crate) fn give_back() -> bool {
    true
}

/// A message of so many bytes has come: a large one is not the last.
pub(crate) fn has_carried(message_bytes: usize) {
    static KEEPS: Once = Once::new();
    if message_bytes >= LARGE_BYTES {
        KEEPS.call_once(|| {
            let _known = keep();
        });
    }
}

/// From now on some memory is kept for large messages. False as for [`give_back`].
#[cfg(target_env = "gnu")]
pub(crate) fn keep() -> bool {
    set(libc::M_MMAP_THRESHOLD, HEAP_BYTES_MAX) && set(libc::M_TRIM_THRESHOLD, KEPT_BYTES_MAX)
}

/// Other allocators keep by themselves.
#[cfg(not(target_env = "gnu"))]
pub(crate) fn keep() -> bool {
    true
}

#[cfg(target_env = "gnu")]
#[expect(unsafe_code, reason = "the only way to say it to the allocator")]
fn set(setting: libc::c_int, value: libc::c_int) -> bool {
    // SAFETY: mallopt takes two integers and may be called at any time by any thread.
    unsafe { libc::mallopt(setting, value) == 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_allocator_knows_the_settings() {
        assert!(give_back() && keep());
    }
}
