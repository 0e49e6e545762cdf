//! docs/commands.md is what the programs say about themselves. `LEDGERD_REFERENCE=write ./test node::reference` makes it
//! anew; then read the difference.

use crate::support::programs;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

const PAGE: &str = "docs/commands.md";
const HEAD: &str = "# Commands\n\nA test generates this page from the output of `ledgerctl COMMAND --help` and `ledgerd COMMAND --help`. \
                    `ledgerctl` is for people and programs, on any machine; `ledgerd` is the node.\n";
/// Begins the options that every command has. They are shown with the program alone.
const EVERYWHERE: &str = "For every command:";

/// The help of a command, without what every command has.
fn help(program: &Path, command: &[String]) -> String {
    let done = Command::new(program).args(command).arg("--help").env_remove("LEDGERCTL_CONTEXT").output().unwrap();
    assert!(done.status.success(), "{command:?}: {done:?}");
    let text = String::from_utf8(done.stdout).unwrap();
    let lines: Vec<&str> = text.lines().map(str::trim_end).collect();
    lines.join("\n").trim().to_owned()
}

/// The help without the options that stand with the program.
fn own(text: &str) -> String {
    let Some((before, after)) = text.split_once(EVERYWHERE) else { return text.to_owned() };
    // What follows begins at the margin again.
    let rest = after.lines().skip(1).skip_while(|line| line.is_empty() || line.starts_with(' '));
    let rest = rest.collect::<Vec<_>>().join("\n");
    [before.trim_end(), rest.trim()].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n\n")
}

/// The commands below one, by its help.
fn below(text: &str) -> Vec<String> {
    let list = text.split_once("\nCommands:\n").map_or("", |(_, rest)| rest);
    let lines = list.lines().take_while(|line| line.starts_with("  "));
    let names = lines.filter(|line| !line.starts_with("   ")).filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

/// Appends the section of a command, and of those below it.
fn describe(page: &mut String, program: &Path, name: &str, command: &[String]) -> usize {
    let text = help(program, command);
    let title = [&[name.to_owned()], command].concat().join(" ");
    let (level, shown) = if command.is_empty() { ("##", text.clone()) } else { ("###", own(&text)) };
    page.push_str(&format!("\n{level} `{title}`\n\n```text\n{shown}\n```\n"));
    let described =
        |name: String| describe(page, program, title.split(' ').next().unwrap(), &[command, &[name]].concat());
    1 + below(&text).into_iter().map(described).sum::<usize>()
}

#[test]
fn the_page_about_commands_is_what_the_programs_say() {
    let mut page = HEAD.to_owned();
    let described = describe(&mut page, programs::ledgerctl(), "ledgerctl", &[])
        + describe(&mut page, programs::ledgerd(), "ledgerd", &[]);
    let path = programs::repository().join(PAGE);
    if std::env::var_os("LEDGERD_REFERENCE").is_some() {
        fs::write(&path, &page).unwrap();
    }
    let found = fs::read_to_string(&path).unwrap_or_default();
    let headings =
        |text: &str| text.lines().filter(|line| line.starts_with('#')).map(str::to_owned).collect::<BTreeSet<_>>();
    assert_eq!(headings(&found), headings(&page), "left: {PAGE}; right: the programs");
    assert!(found == page, "{PAGE} is not what the programs say: LEDGERD_REFERENCE=write ./test node::reference");
    println!("{described} commands are described");
}

#[test]
fn the_help_of_a_command_is_shown_without_what_every_command_has() {
    let text = "Do it\n\nOptions:\n  -h, --help\n\nFor every command:\n      --context <NAME>\n          Act\n\n  -o\n          table\n\n\
                Example:\n  ledgerctl do it";
    assert_eq!(own(text), "Do it\n\nOptions:\n  -h, --help\n\nExample:\n  ledgerctl do it");
    let group = "See\n\nCommands:\n  add   Register\n          and more\n  help  Print\n\nOptions:\n  -h";
    assert_eq!(below(group), ["add"]);
}
