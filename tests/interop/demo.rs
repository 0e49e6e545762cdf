//! `ledgerd demo`, for programs.

use crate::network;
use crate::support::programs;

#[test]
fn demo_json_is_alone_on_standard_output_and_the_story_beside_it() {
    if !network::isolated(&|| ()) {
        return;
    }
    let mut command = programs::node();
    let played = command.args(["demo", "--json", "--seconds", "1"]).output().unwrap();
    let (line, story) = (String::from_utf8(played.stdout).unwrap(), String::from_utf8(played.stderr).unwrap());
    // Whether a machine with other work keeps the rates is not asked here.
    let result: serde_json::Value =
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}\n{story}"));
    assert_eq!(line.lines().count(), 1, "{line}");
    assert!(result["ok"].is_boolean() && result["controlled"]["salma_hz"].is_number(), "{line}\n{story}");
    assert!(story.contains("Salma acquires the Turtlebot4"), "{story}");
    assert!(!story.contains('\x1b'), "nobody sees colours or a moving cursor in a file:\n{story}");
}
