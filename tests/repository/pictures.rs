//! Pictures: pages show each of them, say in words what it shows, and need nothing from elsewhere.

use crate::sources::{files, read, root};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Largest picture, in bytes: a page with all of them loads in a second.
const BYTES_MAX: u64 = 150_000;

/// Largest picture that is text, in bytes.
const SVG_BYTES_MAX: u64 = 65_000;

/// A picture in a page: `![alternative text](target)`.
#[derive(Debug, PartialEq)]
struct Shown {
    alternative: String,
    target: String,
}

/// The pictures that a page shows.
fn shown(page: &str) -> Vec<Shown> {
    let part = |rest: &str| {
        let (alternative, rest) = rest.split_once("](")?;
        let (target, _) = rest.split_once(')')?;
        Some(Shown { alternative: alternative.to_owned(), target: target.to_owned() })
    };
    page.split("![").skip(1).filter_map(part).collect()
}

/// The pictures below docs/.
fn drawn() -> BTreeSet<PathBuf> {
    [".svg", ".png"].iter().flat_map(|ending| files(&root().join("docs"), ending)).collect()
}

/// The faults of a page with these pictures: missing files and missing alternative texts.
fn faults(page: &Path, text: &str, drawn: &BTreeSet<PathBuf>) -> Vec<String> {
    let directory = page.parent().unwrap_or(root());
    let fault = |Shown { alternative, target }: Shown| {
        let is_missing = !drawn.contains(&directory.join(&target));
        let is_mute = alternative.split(' ').count() < 4;
        (is_missing || is_mute).then(|| {
            let why = if is_missing { "there is no such picture below docs/" } else { "say in words what it shows" };
            format!("{} shows {target} ({alternative:?}): {why}", page.display())
        })
    };
    shown(text).into_iter().filter_map(fault).collect()
}

#[test]
fn each_picture_of_a_page_exists_and_has_an_alternative_text() {
    let drawn = drawn();
    let found: Vec<_> = files(root(), ".md").iter().flat_map(|page| faults(page, &read(page), &drawn)).collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn each_picture_is_shown_by_a_page() {
    let of_page = |page: &PathBuf| {
        let directory = page.parent().unwrap_or(root()).to_owned();
        shown(&read(page)).into_iter().map(move |Shown { target, .. }| directory.join(target))
    };
    let used: BTreeSet<PathBuf> = files(root(), ".md").iter().flat_map(of_page).collect();
    let unused: Vec<_> = drawn().difference(&used).cloned().collect();
    assert!(unused.is_empty(), "no page shows {unused:?}: remove them, or show them");
}

#[test]
fn pictures_are_small() {
    for path in drawn() {
        let bytes = path.metadata().map_or(0, |about| about.len());
        let bytes_max = if path.extension().is_some_and(|ending| ending == "svg") { SVG_BYTES_MAX } else { BYTES_MAX };
        assert!((1..=bytes_max).contains(&bytes), "{} has {bytes} bytes of {bytes_max}", path.display());
    }
}

#[test]
fn drawings_are_readable_by_day_and_by_night_and_load_nothing() {
    let drawings = files(&root().join("docs/pictures"), ".svg");
    assert!(!drawings.is_empty(), "docs/pictures has no drawing");
    for path in drawings {
        let text = read(&path);
        for part in ["<title", "<desc", "class=\"card\"", "@media (prefers-color-scheme:dark)"] {
            assert!(text.contains(part), "{} lacks {part}", path.display());
        }
        for foreign in ["href", "<script", "<image", "@import", "url(http"] {
            assert!(!text.contains(foreign), "{} needs something from elsewhere: {foreign}", path.display());
        }
    }
}

/// The texts of a drawing, in their order.
pub(crate) fn texts(drawing: &str) -> String {
    let texts = drawing.split("<text").skip(1).filter_map(|rest| rest.split_once('>')?.1.split_once("</text>"));
    let texts: Vec<_> = texts.map(|(text, _)| text).collect();
    texts.join(" ").replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
}

#[test]
fn a_missing_picture_and_one_without_words_are_found() {
    let page = root().join("docs/page.md");
    let drawn = BTreeSet::from([root().join("docs/pictures/a.svg")]);
    let found = faults(&page, "![A robot and two bridges](pictures/a.svg) [a link](b.svg)", &drawn);
    assert_eq!(found, Vec::<String>::new());
    for text in ["![A robot and two bridges](pictures/b.svg)", "![picture](pictures/a.svg)"] {
        assert_eq!(faults(&page, text, &drawn).len(), 1, "{text}");
    }
    assert_eq!(texts("<text class=\"dim\" x=\"1\">a &lt;</text>\n<text>b c</text>"), "a < b c");
}
