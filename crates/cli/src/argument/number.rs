//! Whole numbers: heights of blocks, and counts.

/// A height of the chain.
///
/// # Errors
/// The wanted form, unless the text is a whole number.
pub(crate) fn height(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| "wanted the height of a block: a whole number, 0 or more".to_owned())
}

/// A count of things.
///
/// # Errors
/// The wanted form, unless the text is a whole number above zero.
pub(crate) fn count(text: &str) -> Result<u64, String> {
    text.parse().ok().filter(|count| *count > 0).ok_or_else(|| "wanted a whole number, 1 or more".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_and_anything_else_is_told_what_is_wanted() {
        assert_eq!((height("0"), count("7")), (Ok(0), Ok(7)));
        for text in ["", "one", "-1", "1.5", "18446744073709551616"] {
            assert!(height(text).is_err_and(|told| told.contains("height")), "{text:?}");
            assert!(count(text).is_err_and(|told| told.contains("1 or more")), "{text:?}");
        }
        assert!(count("0").is_err());
    }
}
