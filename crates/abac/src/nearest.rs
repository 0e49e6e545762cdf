//! "Did you mean": the known name nearest to a mistaken one.

/// Longest name that is compared, in bytes: the comparison costs the product of both lengths.
const NAME_BYTES_MAX: usize = 256;

/// The candidate that differs from `name` by the fewest edits, if that is few enough to be a slip. Counts edits in
/// integers, because the text becomes part of a verdict and must be equal on every node.
pub(crate) fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    if name.len() > NAME_BYTES_MAX {
        return None;
    }
    let name = name.to_lowercase();
    let slip_max = (name.chars().count() / 3).clamp(1, 4);
    candidates
        .into_iter()
        .filter(|candidate| candidate.len() <= NAME_BYTES_MAX)
        .map(|candidate| (strsim::osa_distance(&name, &candidate.to_lowercase()), candidate))
        .filter(|(distance, _)| *distance <= slip_max)
        .min()
        .map(|(_, candidate)| candidate)
}

/// `did you mean "x"?`, or `otherwise` if nothing is near.
pub(crate) fn did_you_mean<'a>(
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
        assert_eq!(nearest(&"x".repeat(100_000), robots), None);
    }
}
