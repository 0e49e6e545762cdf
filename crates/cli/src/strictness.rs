//! From which block on certificates were strict on the way that a reader followed, in words.

/// `since` is the block that made certificates strict as of the certified one; the way was followed from `began_at`, and 0 is the
/// genesis.
pub(crate) fn strictness(since: Option<u64>, began_at: u64) -> String {
    let began = beginning(began_at);
    match since {
        None => "no: one lying organisation could have another block certified".to_owned(),
        Some(since) if since <= began_at => {
            format!(
                "since block {since}, for the whole chain from {began}: no single organisation can have another block \
                 certified"
            )
        }
        Some(since) => format!(
            "since block {since}, but not between {began} and block {since}: a lying organisation could have had \
             other blocks certified then"
        ),
    }
}

/// Where the way begins.
pub(crate) fn beginning(began_at: u64) -> String {
    if began_at == 0 { "the genesis".to_owned() } else { format!("block {began_at}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_that_was_strict_in_part_is_shown_as_such() {
        assert!(strictness(None, 0).starts_with("no: one lying organisation"));
        assert!(strictness(Some(0), 0).starts_with("since block 0, for the whole chain from the genesis: "));
        assert!(strictness(Some(7), 9).starts_with("since block 7, for the whole chain from block 9: "));
        assert!(strictness(Some(7), 0).starts_with("since block 7, but not between the genesis and block 7: "));
        assert!(strictness(Some(7), 5).starts_with("since block 7, but not between block 5 and block 7: "));
    }
}
