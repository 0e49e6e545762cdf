//! The words of the documents: plain sentences that are read once.

use crate::sources::{files, read, root};

/// Longest sentence, in words.
const WORDS_MAX: usize = 30;

/// Words at whose begin a reader waits for the verb: "Who changes it holds a lock".
const BARE: [&str; 6] = ["Who", "What", "Whoever", "Whatever", "Whom", "Whose"];

/// A paragraph or an item of a list: the number of its first line, and its text on one line.
#[derive(Clone)]
pub(crate) struct Paragraph {
    pub(crate) line: usize,
    pub(crate) text: String,
}

/// The part of a line that belongs to a paragraph.
pub(crate) enum Line<'a> {
    /// Neither prose nor part of it: a blank line, a heading, a row of a table.
    Ends,
    /// Prose that begins a new paragraph, such as an item of a list.
    Begins(&'a str),
    /// Prose that may go on with the paragraph before.
    Prose(&'a str),
}

/// Collects paragraphs from lines, in order.
pub(crate) fn collect<'a>(lines: impl Iterator<Item = Line<'a>>) -> Vec<Paragraph> {
    let mut found: Vec<Paragraph> = Vec::new();
    let mut open = false;
    for (line, number) in lines.zip(1..) {
        let (words, begins) = match line {
            Line::Ends => {
                open = false;
                continue;
            }
            Line::Begins(words) => (words, true),
            Line::Prose(words) => (words, !open),
        };
        match found.last_mut().filter(|_| !begins) {
            Some(paragraph) => paragraph.text = format!("{} {words}", paragraph.text),
            None => found.push(Paragraph { line: number, text: words.to_owned() }),
        }
        open = true;
    }
    found
}

/// The paragraphs of a document, without code, tables and headings.
pub(crate) fn paragraphs(text: &str) -> Vec<Paragraph> {
    let mut code = false;
    collect(text.lines().map(|line| {
        let line = line.trim();
        if line.starts_with("```") {
            code = !code;
            return Line::Ends;
        }
        if code || line.is_empty() || line.starts_with(['|', '#', '<']) {
            return Line::Ends;
        }
        item(line).map_or(Line::Prose(line), Line::Begins)
    }))
}

/// The text of an item of a list.
fn item(line: &str) -> Option<&str> {
    let number = line.trim_start_matches(|c: char| c.is_ascii_digit());
    let numbered = number.strip_prefix(". ").filter(|_| number.len() < line.len());
    numbered.or(line.strip_prefix("- ")).or(line.strip_prefix("* "))
}

/// The comments of a file of settings; a line that is a setting, even one that is commented out, is none.
pub(crate) fn comments(text: &str) -> Vec<Paragraph> {
    collect(text.lines().map(|line| line.strip_prefix("# ").map_or(Line::Ends, Line::Prose)))
}

/// The comments of a proto file, which is the documentation of the API.
fn proto_comments(text: &str) -> Vec<Paragraph> {
    collect(text.lines().map(|line| match line.trim().strip_prefix("//") {
        Some(words) if !words.trim().is_empty() => Line::Prose(words.trim()),
        _ => Line::Ends,
    }))
}

/// The words of each sentence, with code as one word, and links and stress without their signs.
pub(crate) fn sentences(text: &str) -> Vec<Vec<String>> {
    let shown = without_links(&text.split('`').step_by(2).collect::<Vec<_>>().join("`code`")).replace('*', "");
    let words: Vec<&str> = shown.split_whitespace().collect();
    let mut found = vec![Vec::new()];
    for (at, word) in words.iter().enumerate() {
        if let Some(sentence) = found.last_mut() {
            sentence.push((*word).to_owned());
        }
        let ends = word.trim_end_matches([')', '"', '\'']).ends_with(['.', '!', '?']);
        let next = words.get(at + 1).and_then(|next| next.chars().next());
        if ends && next.is_some_and(|c| !c.is_lowercase()) {
            found.push(Vec::new());
        }
    }
    found
}

/// `[words](target)` as its words.
fn without_links(text: &str) -> String {
    let mut shown = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once("](") {
        shown.push_str(&before.replacen('[', "", 1));
        rest = after.split_once(')').map_or("", |(_, rest)| rest);
    }
    shown + rest
}

/// The faults in the sentences of these paragraphs, by file and line.
fn faults(file: &str, paragraphs: &[Paragraph]) -> Vec<String> {
    let mut faults = Vec::new();
    for paragraph in paragraphs {
        for sentence in sentences(&paragraph.text) {
            let words = sentence.iter().filter(|word| word.chars().any(char::is_alphanumeric)).count();
            let place = format!("{file}:{}: {}", paragraph.line, sentence.join(" "));
            if words > WORDS_MAX {
                faults.push(format!("{words} words of {WORDS_MAX}: {place}"));
            }
            if is_bare(&sentence) {
                faults.push(format!("name the subject: {place}"));
            }
        }
    }
    faults
}

/// Does a sentence, or a clause behind a semicolon, begin with a word at which a reader waits for the verb?
fn is_bare(sentence: &[String]) -> bool {
    let bare = |word: &str| !word.starts_with('{') && BARE.iter().any(|bare| word.eq_ignore_ascii_case(bare));
    let first = sentence
        .first()
        .map(|word| word.trim_start_matches(['(', '"', '*', '[']).trim_end_matches(|c: char| !c.is_alphanumeric()));
    let question = sentence.last().is_some_and(|word| word.ends_with('?'));
    let begins = first.is_some_and(bare) && !question;
    begins || sentence.windows(2).any(|pair| matches!(pair, [before, word] if before.ends_with(';') && bare(word)))
}

/// A path as the repository names it.
pub(crate) fn named(path: &std::path::Path) -> String {
    path.strip_prefix(root()).unwrap_or(path).to_string_lossy().into_owned()
}

#[test]
fn sentences_of_the_documents_are_short_and_name_their_subject() {
    let faults: Vec<_> =
        files(root(), ".md").iter().flat_map(|path| faults(&named(path), &paragraphs(&read(path)))).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn sentences_about_settings_are_short_and_name_their_subject() {
    let faults = faults("ledgerd.toml", &comments(&read(&root().join("ledgerd.toml"))));
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn sentences_about_the_api_are_short_and_name_their_subject() {
    let protos = files(&root().join("crates"), ".proto");
    assert!(!protos.is_empty(), "no proto file is found");
    let faults: Vec<_> = protos.iter().flat_map(|path| faults(&named(path), &proto_comments(&read(path)))).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// The doc comments of a source; code, tables and everything indented like code do not count.
fn doc_comments(text: &str) -> Vec<Paragraph> {
    let mut code = false;
    collect(text.lines().map(|line| {
        let line = line.trim();
        let Some(words) = line.strip_prefix("//! ").or(line.strip_prefix("/// ")) else { return Line::Ends };
        if words.starts_with("```") {
            code = !code;
            return Line::Ends;
        }
        if code || words.starts_with(['|', '#']) || words.starts_with("     ") {
            return Line::Ends;
        }
        item(words.trim()).map_or(Line::Prose(words.trim()), Line::Begins)
    }))
}

/// Is it a list of errors or events, whose items stand between semicolons? Readers look one up, and read no further.
fn is_list(text: &str) -> bool {
    text.starts_with("[`") || text.starts_with("Events:")
}

/// The faults of the doc comments of a source. An item of a list counts as a sentence.
fn doc_faults(name: &str, text: &str) -> Vec<String> {
    let (lists, prose): (Vec<_>, Vec<_>) =
        doc_comments(text).into_iter().partition(|paragraph| is_list(&paragraph.text));
    let items = lists.into_iter().flat_map(|Paragraph { line, text }| {
        let items: Vec<_> = text.split(';').map(str::to_owned).collect();
        items.into_iter().map(move |text| Paragraph { line, text })
    });
    [faults(name, &prose), faults(name, &items.collect::<Vec<_>>())].concat()
}

#[test]
fn sentences_of_doc_comments_are_short_and_name_their_subject() {
    let mut found = Vec::new();
    for path in
        ["benches", "crates", "examples", "src", "tests"].iter().flat_map(|from| files(&root().join(from), ".rs"))
    {
        found.extend(doc_faults(&named(&path), &read(&path)));
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// The texts of a source in front of its tests: log lines, errors and the rest of what it prints, with their lines.
pub(crate) fn texts(source: &str) -> Vec<Paragraph> {
    let product = source.split("#[cfg(test)]").next().unwrap_or_default();
    let mut found = Vec::new();
    for (line, number) in product.lines().zip(1..) {
        let line = line.trim();
        if !line.starts_with("//") {
            let texts = line.replace("\\\"", "'");
            found.extend(
                texts.split('"').skip(1).step_by(2).map(|text| Paragraph { line: number, text: text.to_owned() }),
            );
        }
    }
    found
}

#[test]
fn log_lines_and_errors_name_their_subject() {
    let mut found = Vec::new();
    for path in ["crates", "src"].iter().flat_map(|from| files(&root().join(from), ".rs")) {
        let name = named(&path);
        if name.contains("tests") || name.starts_with("crates/base/src/rejection") {
            continue;
        }
        let texts = texts(&read(&path)).into_iter().filter(|text| text.text.contains(' '));
        for Paragraph { line, text } in texts {
            let clauses = text.split([':', ';']).map(str::trim).filter(|clause| clause.split(' ').count() > 2);
            let bare = clauses.filter(|clause| is_bare(&clause.split(' ').map(str::to_owned).collect::<Vec<_>>()));
            found.extend(bare.map(|clause| format!("name the subject: {name}:{line}: {clause}")));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn a_long_sentence_and_a_bare_subject_are_found() {
    let long = "word ".repeat(31);
    let text = format!(
        "# Head\n\n{long}\n\n- Who reads `this and\nthat` waits. What is it? It is\n  [a link](x.md) to it.\n\n| {long} |\n"
    );
    let found = faults("file", &paragraphs(&text));
    let told: Vec<_> = found.iter().map(|fault| fault.trim_end_matches(" word")).collect();
    assert_eq!(told, ["31 words of 30: file:3:", "name the subject: file:5: Who reads `code` waits."]);
    let settings = comments("# Words of a setting. Whom it\n# concerns.\n#name = \"What\"\n");
    assert_eq!(faults("file", &settings), ["name the subject: file:1: Whom it concerns."]);
    let docs =
        "/// Nothing comes any more; what waits can be taken.\n/// # Errors\n/// [`A`] if it fails; [`B`] else.\n";
    let bare = "name the subject: file:1: Nothing comes any more; what waits can be taken.";
    assert_eq!(doc_faults("file", docs), [bare]);
    let printed: Vec<_> =
        texts("warn!(\"a \\\"b\\\" c\", \"d\");\n// \"no\"\n").into_iter().map(|text| text.text).collect();
    assert_eq!(printed, ["a 'b' c", "d"]);
}
