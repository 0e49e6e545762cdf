//! New names for topics: `FROM:=TO`, as ROS 2 writes them.

/// A topic and the name that it gets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Remap {
    /// As it is called.
    pub(crate) from: String,
    /// As it will be called.
    pub(crate) to: String,
}

impl std::str::FromStr for Remap {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(":=") {
            Some((from, to)) if from.starts_with('/') && to.starts_with('/') => {
                Ok(Self { from: from.to_owned(), to: to.to_owned() })
            }
            _ => Err("wanted FROM:=TO, two topic names with leading slashes".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_topics_stand_around_the_sign_of_ros() {
        let read = |text: &str| text.parse::<Remap>().map(|remap| (remap.from, remap.to));
        assert_eq!(read("/a/b:=/c"), Ok(("/a/b".into(), "/c".into())));
        for text in ["", "/a", "/a=/b", "a:=/b", "/a:=b", ":=/b"] {
            assert!(read(text).is_err_and(|told| told.contains("FROM:=TO")), "{text:?}");
        }
    }
}
