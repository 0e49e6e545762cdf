//! The prose of a file: pages with their headings and tables, comments, and the texts that a program prints.

use crate::words::{Line, Paragraph, collect, paragraphs, texts};

/// The prose of a page: paragraphs, headings and cells of tables.
pub(crate) fn of_page(text: &str) -> Vec<Paragraph> {
    let mut found = paragraphs(text);
    found.extend(headings(text));
    for (line, number) in shown(text).filter(|(line, _)| line.starts_with('|')) {
        found.extend(line.split('|').map(|cell| Paragraph { line: number, text: cell.trim().to_owned() }));
    }
    found
}

/// The headings of a page.
pub(crate) fn headings(text: &str) -> Vec<Paragraph> {
    let heading = |(line, number): (&str, usize)| {
        let text = line.strip_prefix('#')?.trim_start_matches('#').trim().to_owned();
        Some(Paragraph { line: number, text })
    };
    shown(text).filter_map(heading).collect()
}

/// The lines of a page outside of its blocks of code, with their numbers.
fn shown(text: &str) -> impl Iterator<Item = (&str, usize)> {
    let mut code = false;
    text.lines().map(str::trim).zip(1..).filter(move |(line, _)| {
        let fence = line.starts_with("```");
        code ^= fence;
        !code && !fence
    })
}

/// The prose of a source, by the ending of its name; none for other files.
pub(crate) fn of_source(name: &str, text: &str) -> Vec<Paragraph> {
    match name.rsplit_once('.').map(|(_, ending)| ending) {
        Some("rs") => {
            [comments(text, &["//"]), if name.contains("tests") { Vec::new() } else { printed(text) }].concat()
        }
        Some("js" | "mjs") => [comments(text, &["//", "*", "/**"]), printed(text)].concat(),
        Some("proto" | "go" | "cpp" | "hpp") => comments(text, &["//"]),
        Some("py") => [comments(text, &["#"]), docstrings(text), printed(&without_docstrings(text))].concat(),
        Some("toml" | "yml") => comments(text, &["#"]),
        _ => Vec::new(),
    }
}

/// The texts of a source that have more than one word: the others are names.
fn printed(text: &str) -> Vec<Paragraph> {
    texts(text).into_iter().filter(|text| text.text.contains(' ')).collect()
}

/// The comments of a source, those behind code, too.
fn comments(text: &str, signs: &[&str]) -> Vec<Paragraph> {
    collect(text.lines().map(|line| {
        let line = line.trim();
        for sign in signs {
            if let Some(words) = line.strip_prefix(sign) {
                let words = words.trim_start_matches(['/', '!', '*', '#']).trim();
                return if words.is_empty() { Line::Ends } else { Line::Prose(words) };
            }
            if let Some((code, words)) = line.split_once(&format!(" {sign} "))
                && *sign != "*"
                && code.matches('"').count() % 2 == 0
            {
                return Line::Begins(words);
            }
        }
        Line::Ends
    }))
}

/// Is each line of a Python source part of a text between three quotes?
fn in_docstrings(text: &str) -> impl Iterator<Item = (&str, bool)> {
    let mut inside = false;
    text.lines().map(move |line| {
        let quotes = line.matches("\"\"\"").count();
        let was_inside = inside;
        inside ^= quotes % 2 == 1;
        (line.trim(), was_inside || quotes > 0)
    })
}

/// The texts between three quotes in a Python source.
fn docstrings(text: &str) -> Vec<Paragraph> {
    collect(in_docstrings(text).map(|(line, is_inside)| {
        let words = line.trim_matches('"');
        if is_inside && !words.is_empty() { Line::Prose(words) } else { Line::Ends }
    }))
}

/// A Python source with empty lines in place of its texts between three quotes.
fn without_docstrings(text: &str) -> String {
    in_docstrings(text).map(|(line, is_inside)| if is_inside { "\n".to_owned() } else { format!("{line}\n") }).collect()
}
