//! A page with blocks of commands, such as README.md, taken apart.

use crate::support::programs::repository;

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
            if let Some(title) = line.strip_prefix("# ").or(line.strip_prefix("## ")) {
                heading = title.to_owned();
            }
            let Some(language) = line.strip_prefix("```") else { continue };
            let inside: Vec<_> = lines.by_ref().take_while(|line| *line != "```").collect();
            match language {
                "sh" | "console" | "bash" | "shell" => {
                    blocks.push(Block { heading: heading.clone(), steps: steps(language, &inside) });
                }
                "toml" => {
                    let name = inside[0].trim_start_matches("# ").split(':').next().unwrap().to_owned();
                    files.push((name, inside.join("\n") + "\n"));
                }
                _ => {}
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

/// In a block `console` commands stand behind `$`, in others every line is one.
fn steps(language: &str, lines: &[&str]) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    for line in lines {
        match (line.strip_prefix("$ "), language) {
            (Some(command), "console") => steps.push(Step { command: command.to_owned(), printed: Vec::new() }),
            (None, "console") => steps.last_mut().expect("a command first").printed.push((*line).to_owned()),
            _ => steps.push(Step { command: (*line).to_owned(), printed: Vec::new() }),
        }
    }
    steps
}
