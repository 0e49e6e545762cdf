//! README.md and docs/start.md as they stand: their blocks of commands are run, in order, by somebody with an empty home directory.
//!
//! The output in them is compared line by line. Times, ids, fingerprints and secrets differ from run to run: a word
//! of that kind may be another one of the same form. Where a later command of README names it, the real one is put
//! there. So README shows whole values, as a reader sees them.

mod page;
mod terminal;

use crate::network;
use page::{Block, Page};
use terminal::Terminal;

/// The shell that runs a block.
enum Run {
    /// This test.
    Here,
    /// Another one, or the test for which this block is the instruction.
    There(&'static str),
}

/// Three screens.
const LINES_MAX: usize = 150;

/// Every block of commands in README: its heading, its first command, who runs it. One that is missing here fails the test.
const BLOCKS: [(&str, &str, Run); 6] = [
    ("ledgerd", "cargo run --release -- demo", Run::There(".ci/run, and tests/repository for the first line")),
    ("Two minutes by hand", "cargo build --release && export PATH=$PWD/target/release:$PATH", Run::Here),
    ("Two minutes by hand", "ledgerctl --context dev-org1-admin identity register Salma", Run::Here),
    ("Two minutes by hand", "ledgerctl --context dev-org1-admin identity register Farhad", Run::Here),
    ("With ROS 2", "ledgerctl --context dev-org2-admin identity register Turtlebot4", Run::Here),
    ("A network of three", "ledgerd init", Run::There("tests/node/three.rs")),
];

#[test]
fn every_console_block_of_the_readme_is_run_by_a_test() {
    let page = Page::read("README.md");
    for block in &page.blocks {
        let known = BLOCKS.iter().any(|(heading, first, _)| is_block(block, heading, first));
        assert!(known, "no test runs the block under {:?} that begins with {:?}", block.heading, block.first_command());
    }
    assert_eq!(page.blocks.len(), BLOCKS.len(), "a block is gone from README");
    // What a reader sees: no fences, no rules below the headings of tables.
    let lines = page.text.lines().filter(|line| !line.starts_with("```") && !line.starts_with("|--")).count();
    assert!(lines <= LINES_MAX, "README.md shows {lines} lines, and three screens have {LINES_MAX}");
}

#[test]
fn the_console_blocks_of_the_readme_print_what_it_says() {
    if !network::isolated(&|| ()) {
        return;
    }
    let page = Page::read("README.md");
    let mut terminal = Terminal::open(&page.files);
    for block in &page.blocks {
        match BLOCKS.iter().find(|(heading, first, _)| is_block(block, heading, first)) {
            Some((_, _, Run::Here)) => run(&mut terminal, block),
            Some((heading, first, Run::There(who))) => println!("{heading}: {first}: run by {who}"),
            None => panic!("no test runs the block under {:?}", block.heading),
        }
    }
}

#[test]
fn the_console_blocks_of_the_first_chapter_print_what_it_says() {
    if !network::isolated(&|| ()) {
        return;
    }
    let page = Page::read("docs/start.md");
    assert!(page.files.is_empty() && page.blocks.len() > 5, "{} blocks", page.blocks.len());
    let mut terminal = Terminal::open(&[]);
    page.blocks.iter().for_each(|block| run(&mut terminal, block));
}

fn is_block(block: &Block, heading: &str, first: &str) -> bool {
    block.heading == heading && block.first_command().starts_with(first)
}

fn run(terminal: &mut Terminal, block: &Block) {
    for step in &block.steps {
        terminal.run(&step.command, &step.printed);
    }
}
