//! "Did you mean": the known name nearest to a mistaken one.
//!
//! Edits are counted in integers, because a suggestion becomes part of a verdict and must be equal on every node.
//!
//! ```
//! assert_eq!(ledger_base::nearest::nearest("turtelbot4", ["Husky", "Turtlebot4"]), Some("Turtlebot4"));
//! assert_eq!(ledger_base::nearest::did_you_mean("Huski", ["Husky"], "robot list"), "did you mean \"Husky\"?");
//! ```

/// Longest name that is compared, in bytes: the comparison costs the product of both lengths.
const NAME_BYTES_MAX: usize = 256;

/// The candidate that differs from `name` by the fewest edits, if they are a slip or `name` is most of its beginning.
/// Upper and lower case are alike.
pub fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    if name.len() > NAME_BYTES_MAX {
        return None;
    }
    let name = name.to_lowercase();
    let letters = name.chars().count();
    let slip_max = ((letters + 1) / 3).clamp(1, 4);
    let edits = |candidate: &'a str| {
        let known = candidate.to_lowercase();
        let edits = strsim::osa_distance(&name, &known);
        let begins = known.starts_with(&name) && edits <= letters;
        (edits <= slip_max || begins).then_some((edits, candidate))
    };
    let short = candidates.into_iter().filter(|candidate| candidate.len() <= NAME_BYTES_MAX);
    short.filter_map(edits).min().map(|(_, candidate)| candidate)
}

/// `did you mean "x"?`, or `otherwise` if nothing is near.
pub fn did_you_mean<'a>(
    name: &str,
    candidates: impl IntoIterator<Item = &'a str>,
    otherwise: impl Into<String>,
) -> String {
    nearest(name, candidates).map_or_else(|| otherwise.into(), |near| format!("did you mean {near:?}?"))
}

#[cfg(test)]
mod tests {
    use super::nearest;

    #[test]
    fn a_slip_finds_its_name_and_a_stranger_does_not() {
        let robots = ["Husky", "OptiTrack", "Turtlebot4"];
        assert_eq!(nearest("turtelbot4", robots), Some("Turtlebot4"));
        assert_eq!(nearest("Turtlebot", robots), Some("Turtlebot4"));
        assert_eq!(nearest("Spot", robots), None);
        assert_eq!(nearest("modus", ["direction", "mode"]), Some("mode"));
    }

    #[test]
    fn most_of_the_beginning_of_a_name_finds_it() {
        let settings = ["in_flight_max", "infinite", "payload_bytes_max"];
        assert_eq!(nearest("in_flight", settings), Some("in_flight_max"));
        assert_eq!(nearest("in", settings), None);
        assert_eq!(nearest("", settings), None);
    }

    #[test]
    fn a_name_without_end_is_compared_with_nothing() {
        assert_eq!(nearest(&"x".repeat(100_000), ["x"]), None);
        assert_eq!(nearest("x", ["y".repeat(100_000).as_str()]), None);
    }
}
