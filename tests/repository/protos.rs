//! The proto files as programmers in other languages expect them: the rules of `buf lint` (category STANDARD, and comments), by
//! its names. Names are part of the wire: where one cannot be changed any more, it is an exception with a reason.

use crate::sources::{files, read, root};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const PACKAGE: &str = "ledgerd.v1";
const GO_PACKAGE: &str = "ledgerd/v1;ledgerdv1";

/// An exception: the rule, the names that it excuses, and why.
type Exception = (&'static str, &'static [&'static str], &'static str);

const EXCEPTIONS: [Exception; 5] = [
    ("SERVICE_SUFFIX", &["Gateway", "Enrolment", "Peer"], "the name of a service is in the path of every call"),
    (
        "RPC_REQUEST_STANDARD_NAME",
        &["SubmitStream", "Messages"],
        "on a stream come the requests of Submit, or frames: a name for each would be a second name of one thing",
    ),
    (
        "RPC_RESPONSE_STANDARD_NAME",
        &[
            "SubmitStream",
            "Subscribe",
            "GetBlock",
            "GetTransaction",
            "Governance",
            "Renew",
            "Messages",
            "Blocks",
            "SnapshotChunks",
        ],
        "the answer is a thing that has a name, or one of several on a stream",
    ),
    (
        "RPC_REQUEST_RESPONSE_UNIQUE",
        &["SubmitRequest", "SubmitResponse", "EnrolResponse"],
        "a transaction is submitted alone or on a stream, and a certificate made first or anew: the answers are the same",
    ),
    ("COMMENT_RPC", &["SealCa", "TakeCa"], "the comment on OfferCa tells of all three steps"),
];

/// Something with a name in a proto file.
struct Named {
    /// The path and the line.
    place: String,
    name: String,
    /// Is there a comment above it?
    told: bool,
}

/// The content of the proto files, as far as the rules look.
#[derive(Default)]
struct Content {
    services: Vec<Named>,
    messages: Vec<Named>,
    /// Each with its request and its answer.
    calls: Vec<(Named, String, String)>,
    fields: Vec<Named>,
    enums: Vec<Named>,
    /// Each with the name of its enum, and its number.
    values: Vec<(Named, String, String)>,
}

impl Content {
    fn read(&mut self, path: &str, text: &str) {
        let (mut told, mut blocks) = (false, Vec::<(String, String)>::new());
        for (number, line) in (1..).zip(text.lines().map(str::trim)) {
            let code = line.split("//").next().unwrap_or_default().trim();
            let words: Vec<&str> = code.split_whitespace().collect();
            let named = |name: &str| Named { place: format!("{path}:{number}"), name: name.to_owned(), told };
            let inside = blocks.last().map(|(kind, name)| (kind.as_str(), name.clone()));
            match (words.as_slice(), inside) {
                (["service", name, ..], _) => self.services.push(named(name)),
                (["message", name, ..], _) => self.messages.push(named(name)),
                (["enum", name, ..], _) => self.enums.push(named(name)),
                (["rpc", ..], _) => {
                    let parts: Vec<_> = code.trim_start_matches("rpc").split(['(', ')']).map(str::trim).collect();
                    let part = |at: usize| parts.get(at).copied().unwrap_or_default().trim_start_matches("stream ");
                    self.calls.push((named(part(0)), part(1).to_owned(), part(3).to_owned()));
                }
                (["reserved", ..] | ["option", ..], _) => {}
                ([name, "=", value, ..], Some(("enum", owner))) => {
                    self.values.push((named(name), owner, value.trim_end_matches(';').to_owned()));
                }
                ([.., name, "=", _], Some(("message" | "oneof", _))) => self.fields.push(named(name)),
                _ => {}
            }
            if code.ends_with('{') {
                let word = |at: usize| words.get(at).copied().unwrap_or_default().to_owned();
                blocks.push((word(0), word(1)));
            }
            if code == "}" {
                blocks.pop();
            }
            told = line.starts_with("//");
        }
    }

    /// The names that break a rule, each with the name of the rule, and where it is.
    fn faults(&self) -> Vec<(&'static str, String, String)> {
        let mut faults = Vec::new();
        let mut fault = |rule, named: &Named, what: &str| {
            faults.push((rule, named.name.clone(), format!("{}: {what}", named.place)))
        };
        let in_calls: BTreeSet<_> = self.calls.iter().flat_map(|(_, asked, answer)| [asked, answer]).collect();
        for one in &self.services {
            if !one.name.ends_with("Service") {
                fault("SERVICE_SUFFIX", one, "the name of a service ends with Service");
            }
        }
        for one in self.services.iter().chain(&self.messages).chain(&self.enums) {
            if !is_pascal(&one.name) {
                fault("PASCAL_CASE", one, "names of services, messages and enums are in PascalCase");
            }
        }
        for one in &self.fields {
            if !is_snake(&one.name) {
                fault("FIELD_LOWER_SNAKE_CASE", one, "names of fields are in lower_snake_case");
            }
        }
        for (value, owner, number) in &self.values {
            if !value.name.starts_with(&(shout(owner) + "_")) {
                fault("ENUM_VALUE_PREFIX", value, "a value begins with the name of its enum");
            }
            if number == "0" && !value.name.ends_with("_UNSPECIFIED") {
                fault("ENUM_ZERO_VALUE_SUFFIX", value, "the value 0 says that nothing was said");
            }
        }
        let mut used = BTreeSet::new();
        for (call, asked, answer) in &self.calls {
            if *asked != format!("{}Request", call.name) {
                fault("RPC_REQUEST_STANDARD_NAME", call, "the request of CALL is CALLRequest");
            }
            if *answer != format!("{}Response", call.name) {
                fault("RPC_RESPONSE_STANDARD_NAME", call, "the answer to CALL is CALLResponse");
            }
            for message in [asked, answer] {
                if !used.insert(message) {
                    let twice = Named { place: call.place.clone(), name: message.clone(), told: true };
                    fault("RPC_REQUEST_RESPONSE_UNIQUE", &twice, "a message belongs to one call");
                }
            }
        }
        for one in self.calls.iter().map(|(call, ..)| call).filter(|call| !call.told) {
            fault("COMMENT_RPC", one, "a comment says what a call does");
        }
        // Requests and answers are told with their calls.
        for one in self.messages.iter().filter(|one| !one.told && !in_calls.contains(&one.name)) {
            fault("COMMENT_MESSAGE", one, "a comment says what it is");
        }
        faults
    }
}

fn is_pascal(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_uppercase()) && name.chars().all(|c| c.is_ascii_alphanumeric())
}

fn is_snake(name: &str) -> bool {
    let fits = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(fits)
        && !name.contains("__")
        && !name.ends_with('_')
}

/// `TwoWords` as `TWO_WORDS`.
fn shout(name: &str) -> String {
    let mut shouted = String::new();
    for c in name.chars() {
        if c.is_ascii_uppercase() && !shouted.is_empty() {
            shouted.push('_');
        }
        shouted.push(c.to_ascii_uppercase());
    }
    shouted
}

fn protos() -> Vec<PathBuf> {
    let found = files(&root().join("crates/api/proto"), ".proto");
    assert!(!found.is_empty(), "no proto file is found");
    found
}

#[test]
fn names_and_comments_of_the_proto_files_are_those_that_buf_wants() {
    let mut content = Content::default();
    for path in protos() {
        content.read(&path.to_string_lossy(), &read(&path));
    }
    assert!(content.services.len() == 3 && content.calls.len() > 20 && content.fields.len() > 100, "they were read");
    let mut unused: BTreeSet<_> = EXCEPTIONS
        .iter()
        .flat_map(|(rule, names, _)| names.iter().map(move |name| (*rule, (*name).to_owned())))
        .collect();
    let excused = unused.clone();
    let mut broken = Vec::new();
    for (rule, name, what) in content.faults() {
        unused.remove(&(rule, name.clone()));
        if !excused.contains(&(rule, name.clone())) {
            broken.push(format!("{rule}: {name}: {what}"));
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
    assert!(unused.is_empty(), "exceptions that excuse nothing: {unused:?}");
}

#[test]
fn files_of_a_package_lie_where_the_package_says_and_name_it_for_go() {
    for path in protos() {
        let text = read(&path);
        for line in
            ["syntax = \"proto3\";", &format!("package {PACKAGE};"), &format!("option go_package = \"{GO_PACKAGE}\";")]
        {
            assert!(text.lines().any(|found| found == line), "{}: no line {line}", path.display());
        }
        let below = path.strip_prefix(root().join("crates/api/proto")).unwrap_or(&path);
        assert_eq!(below.parent(), Some(Path::new("ledgerd/v1")), "{}", path.display());
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        assert!(is_snake(&name), "{}: names of files are in lower_snake_case", path.display());
        assert!(text.starts_with("// "), "{}: a comment at its head says what is in it", path.display());
        let imports = text.lines().filter_map(|line| line.strip_prefix("import \"")?.strip_suffix("\";"));
        for import in imports {
            let used = Path::new(import).file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let defines = read(&root().join("crates/api/proto").join(import));
            let names = defines.lines().filter_map(|line| line.strip_prefix("message ")?.split(' ').next());
            let is_used =
                names.into_iter().any(|name| text.lines().any(|line| line.trim().starts_with(&format!("{name} "))));
            assert!(is_used, "{}: nothing of {used} is used (IMPORT_USED)", path.display());
        }
    }
}

#[test]
fn a_name_or_a_comment_that_buf_does_not_want_is_found() {
    let mut content = Content::default();
    let text = "service Door {\n  rpc open(Key) returns (stream OpenResponse);\n}\nmessage key {\n  string Teeth = 1;\n}\n\
        // Told.\nenum TwoWords {\n  NONE = 0;\n  TWO_WORDS_ONE = 1;\n}\n";
    content.read("x", text);
    let found: BTreeSet<_> = content.faults().into_iter().map(|(rule, name, _)| format!("{rule} {name}")).collect();
    let wanted = [
        "COMMENT_MESSAGE key",
        "COMMENT_RPC open",
        "ENUM_VALUE_PREFIX NONE",
        "ENUM_ZERO_VALUE_SUFFIX NONE",
        "FIELD_LOWER_SNAKE_CASE Teeth",
        "PASCAL_CASE key",
        "RPC_REQUEST_STANDARD_NAME open",
        "RPC_RESPONSE_STANDARD_NAME open",
        "SERVICE_SUFFIX Door",
    ];
    assert_eq!(found, wanted.map(str::to_owned).into());
}

#[test]
fn every_message_of_the_proto_files_is_fuzzed() {
    let named = |line: &str| line.strip_prefix("message ").and_then(|rest| rest.split(' ').next().map(str::to_owned));
    let protos = files(&root().join("crates/api/proto"), ".proto");
    let messages: BTreeSet<_> =
        protos.iter().flat_map(|path| read(path).lines().filter_map(named).collect::<Vec<_>>()).collect();
    let text = read(&root().join("fuzz/src/messages.rs"));
    let quoted =
        |line: &str| line.trim().strip_prefix("(\"").and_then(|rest| rest.split('"').next().map(str::to_owned));
    let fuzzed: BTreeSet<_> = text.lines().filter_map(quoted).collect();
    assert!(messages.len() > 50, "{messages:?}");
    assert_eq!(fuzzed, messages);
}
