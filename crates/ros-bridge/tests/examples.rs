//! The examples of the documents are configurations that a bridge accepts.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

#[test]
fn the_bridges_of_the_readme_are_accepted() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let readme = std::fs::read_to_string(root.join("README.md")).unwrap();
    let examples: Vec<_> = readme.split("```toml\n").skip(1).filter_map(|rest| rest.split_once("\n```")).collect();
    assert_eq!(examples.len(), 2, "a user's bridge and a robot's");
    for (example, _) in examples {
        let parsed = ros_bridge::Config::parse(example, root, |_| ());
        assert!(parsed.is_ok(), "{example}\n{:?}", parsed.err());
    }
}
