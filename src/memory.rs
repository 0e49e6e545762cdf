//! Memory that is no longer needed goes back to the operating system.
//!
//! glibc learns from its use: once a large buffer was freed, such buffers and everything around them stay with the
//! process from then on. That is up to tens of megabytes. That fits a program that needs as much again. A node on a
//! robot needs it in its first second and after a burst, so it keeps the thresholds where they start (mallopt(3)).

/// Bytes that are asked for in advance: the value that holds anyway. Setting it is what ends the learning.
#[cfg(target_env = "gnu")]
const TOP_PAD_BYTES: libc::c_int = 128 * 1024;

/// To be called once, first. False if the allocator does not know the setting; then more memory is kept, nothing else.
#[cfg(target_env = "gnu")]
#[expect(unsafe_code, reason = "the only way to say it to the allocator")]
pub(crate) fn give_back() -> bool {
    // SAFETY: mallopt takes two integers and may be called at any time by any thread.
    unsafe { libc::mallopt(libc::M_TOP_PAD, TOP_PAD_BYTES) == 1 }
}

/// Other allocators do not learn.
#[cfg(not(target_env = "gnu"))]
pub(crate) fn give_back() -> bool {
    true
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_allocator_knows_the_setting() {
        assert!(super::give_back());
    }
}
