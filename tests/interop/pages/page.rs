//! A page with blocks of commands, such as README.md, taken apart.

use crate::support::programs::repository;

/// Languages of blocks that are typed.
const SHELLS: [&str; 4] = ["sh", "console", "bash", "shell"];
/// Languages of files that a page shows, and how their comments begin.
const FILES: [(&str, &str); 3] = [("toml", "# "), ("cedar", "// "), ("yaml", "# ")];

/// The parts of a page that a test needs.
pub(super) struct Page {
    pub(super) text: String,
    /// Blocks of commands in their order.
    pub(super) blocks: Vec<Block>,
    /// Files that it shows: name, from the comment on their first line, and content.
    pub(super) files: Vec<(String, String)>,
}

/// A block of commands.
pub(super) struct Block {
    /// The heading above it.
    pub(super) heading: String,
    pub(super) steps: Vec<Step>,
}

/// A command and what it prints.
pub(super) struct Step {
    pub(super) command: String,
    pub(super) printed: Vec<String>,
}

impl Page {
    /// Reads it.
    pub(super) fn read(name: &str) -> Self {
        let text = std::fs::read_to_string(repository().join(name)).unwrap();
        let (mut blocks, mut files) = (Vec::new(), Vec::new());
        let mut heading = String::new();
        let mut lines = text.lines();
        while let Some(line) = lines.next() {
            if line.starts_with('#') {
                line.trim_start_matches('#').trim().clone_into(&mut heading);
            }
            let Some(language) = line.strip_prefix("```") else { continue };
            let inside: Vec<_> = lines.by_ref().take_while(|line| *line != "```").collect();
            if SHELLS.contains(&language) {
                blocks.push(Block { heading: heading.clone(), steps: steps(language, &inside) });
            } else if inside.iter().any(|line| line.starts_with("$ ")) {
                panic!("{name}: under {heading:?} a block of {language:?} has commands: call it console");
            }
            let comment = FILES.iter().find(|(known, _)| *known == language).map(|(_, comment)| *comment);
            if let Some(file) = comment.and_then(|comment| file_name(inside.first()?, comment)) {
                files.push((file, inside.join("\n") + "\n"));
            }
        }
        Self { text, blocks, files }
    }
}

impl Block {
    /// Its first command, which names it.
    pub(super) fn first_command(&self) -> &str {
        &self.steps[0].command
    }
}

/// The name of a file in the comment on its first line: `# salma.toml: her bridge`.
fn file_name(line: &str, comment: &str) -> Option<String> {
    let name = line.strip_prefix(comment)?.split([':', ' ']).next()?;
    let is_name = name.contains('.') && name.chars().all(|c| c.is_ascii_alphanumeric() || "._-".contains(c));
    is_name.then(|| name.to_owned())
}

/// In a block `console` commands stand behind `$`, in others every line is one. A line that ends with `\` goes on.
fn steps(language: &str, lines: &[&str]) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    let mut goes_on = false;
    for line in lines {
        let begun = match (line.strip_prefix("$ "), language) {
            _ if goes_on => None,
            (Some(command), "console") => Some(command),
            (None, "console") => None,
            _ if line.trim().is_empty() => continue,
            _ => Some(*line),
        };
        match begun {
            Some(command) => steps.push(Step { command: command.to_owned(), printed: Vec::new() }),
            None if goes_on => {
                let command = &mut steps.last_mut().expect("its beginning").command;
                command.truncate(command.len() - 1);
                command.push_str(line.trim_start());
            }
            None => steps.last_mut().expect("a command first").printed.push((*line).to_owned()),
        }
        goes_on = line.ends_with('\\') && (begun.is_some() || goes_on);
    }
    steps
}
