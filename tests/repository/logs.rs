//! Log lines are for operators: they name values, and print no struct as a debugger would.

use crate::sources::{files, read, root};

/// The macros that write a line.
const MACROS: [&str; 5] = ["error", "warn", "info", "debug", "trace"];

/// The arguments of every log line of a source.
fn lines(text: &str) -> Vec<&str> {
    let mut found = Vec::new();
    for (at, call) in text.match_indices("tracing::") {
        let rest = text.get(at + call.len()..).unwrap_or_default();
        let arguments = MACROS.iter().find_map(|name| rest.strip_prefix(name)?.strip_prefix("!("));
        if let Some(arguments) = arguments {
            found.push(arguments.get(..end(arguments)).unwrap_or(arguments));
        }
    }
    found
}

/// Where the parenthesis closes that was opened before this text. Texts in quotes do not count.
fn end(text: &str) -> usize {
    let (mut open, mut quoted, mut escaped) = (1_usize, false, false);
    for (at, c) in text.char_indices() {
        match c {
            _ if escaped => escaped = false,
            '\\' if quoted => escaped = true,
            '"' => quoted = !quoted,
            '(' if !quoted => open += 1,
            ')' if !quoted => open -= 1,
            _ => {}
        }
        if open == 0 {
            return at;
        }
    }
    text.len()
}

/// Does a log line print a value for debugging: `?value`, `name = ?value`, `{:?}`?
fn debugs(arguments: &str) -> bool {
    let sigil = arguments.match_indices('?').any(|(at, _)| {
        let before = arguments.get(..at).unwrap_or_default().trim_end();
        before.is_empty() || before.ends_with([',', '='])
    });
    sigil || arguments.contains(":?}") || arguments.contains(":#?}")
}

#[test]
fn no_log_line_prints_a_struct() {
    let mut checked = 0;
    for folder in ["src", "crates"] {
        for path in files(&root().join(folder), ".rs") {
            let name = path.strip_prefix(root()).unwrap_or(&path).to_string_lossy().into_owned();
            if name.contains("/tests") {
                continue;
            }
            for line in lines(&read(&path)) {
                checked += 1;
                assert!(!debugs(line), "{name} prints a value for debugging: tracing::…!({line})");
            }
        }
    }
    assert!(checked > 50, "only {checked} log lines are found");
}

/// Names of fields that mean what a word of the vocabulary means, each with that word: who filters lines types one name.
const OTHER_WORDS: [(&str, &str); 14] = [
    ("peer", "node"),
    ("member", "node"),
    ("block", "height"),
    ("block_height", "height"),
    ("tx", "transaction"),
    ("txid", "transaction"),
    ("transaction_id", "transaction"),
    ("user", "identity"),
    ("creator", "identity"),
    ("principal", "identity"),
    ("fault", "reason"),
    ("rejection", "reason"),
    ("refusal", "reason"),
    ("error_code", "code"),
];

/// The names of the fields of a log line: what stands before its text.
fn fields(arguments: &str) -> Vec<&str> {
    let (mut fields, mut begin, mut open, mut quoted) = (Vec::new(), 0, 0_i32, false);
    for (at, c) in arguments.char_indices() {
        match c {
            '"' => quoted = !quoted,
            '(' | '[' | '{' if !quoted => open += 1,
            ')' | ']' | '}' if !quoted => open -= 1,
            ',' if !quoted && open == 0 => {
                fields.push(arguments.get(begin..at).unwrap_or_default());
                begin = at + 1;
            }
            _ => {}
        }
    }
    let named = fields.into_iter().map(str::trim).take_while(|field| !field.starts_with('"'));
    named.map(|field| field.split('=').next().unwrap_or(field).trim().trim_start_matches(['%', '?'])).collect()
}

/// Does a line give a refusal as its reason?
fn has_refusal(arguments: &str) -> bool {
    let shown = arguments.split('"').next().unwrap_or(arguments);
    ["%reason", "reason = %", "reason = line("].iter().any(|form| shown.contains(form))
}

#[test]
fn log_lines_have_one_vocabulary_and_refusals_their_code() {
    let mut refusals = 0;
    for folder in ["src", "crates"] {
        for path in files(&root().join(folder), ".rs") {
            let name = path.strip_prefix(root()).unwrap_or(&path).to_string_lossy().into_owned();
            let text = read(&path);
            for line in lines(&text).into_iter().filter(|_| !name.contains("/tests")) {
                let fields = fields(line);
                for (other, word) in OTHER_WORDS {
                    assert!(
                        !fields.contains(&other),
                        "{name}: the field {other} is called {word}: tracing::…!({line})"
                    );
                }
                if has_refusal(line) {
                    refusals += 1;
                    assert!(fields.contains(&"code"), "{name}: a refusal without its code: tracing::…!({line})");
                }
            }
        }
    }
    assert!(refusals > 30, "only {refusals} refusals are found");
}

#[test]
fn fields_are_told_from_the_text_of_a_line() {
    let line = r#"service, code = refused.code.name(), reason = line(&refused, "a"), %error, "text, peer = {}", peer"#;
    assert_eq!(fields(line), ["service", "code", "reason", "error"]);
    assert!(has_refusal(line) && !has_refusal(r#"%error, "a %reason""#));
    assert!(fields(r#""only text""#).is_empty());
}

#[test]
fn debug_printing_is_told_from_other_question_marks() {
    let source = r#"tracing::info!(?error, "a"); tracing::warn!(%error, "what (now)?"); tracing::error!(x = ?f(), "b");
        tracing::debug!("{:?}", x); tracing::info!(name = read()?, "c"); other!(?d);"#;
    let found: Vec<_> = lines(source).into_iter().map(debugs).collect();
    assert_eq!(found, [true, false, true, true, false]);
}
