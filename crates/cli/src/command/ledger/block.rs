//! `block`: one block of the chain.

use super::tx::{call, event_cells};
use crate::argument::number;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use crate::time;
use ledger_api::facts::BlockFacts;
use std::io::{self, Write};

/// Show a block with its transactions and verdicts.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl block 17")]
pub(crate) struct Block {
    /// Height of the block; 0 is the genesis
    #[arg(value_parser = number::height)]
    height: u64,
}

impl Block {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let block = Session::open(global).await?.client.block(self.height).await?;
        output.show(&BlockFacts::from(block))
    }
}

impl Facts for BlockFacts {
    fn omitted(&self) -> &'static [&'static str] {
        &["transactions.not_after", "transactions.not_after_utc"]
    }

    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("block", format!("{} ({})", self.height, self.kind));
        table.pair("hash", &self.hash);
        table.pair("previous", &self.previous_hash);
        table.pair("root", &self.root);
        table.pair("state digest", &self.state_digest);
        table.pair("term", self.term);
        table.pair("time", time::moment(self.time));
        table.write(out, 0)?;
        if !self.transactions.is_empty() {
            writeln!(out)?;
            let mut table = Table::new(["INDEX", "TRANSACTION", "CREATOR", "VERDICT", "CALL"]);
            for transaction in &self.transactions {
                table.row([
                    transaction.index.to_string(),
                    transaction.id.clone(),
                    transaction.creator.clone(),
                    transaction.code.clone(),
                    call(&transaction.call),
                ]);
            }
            table.write(out, 0)?;
        }
        let own = self.events.iter().map(|event| ("-".to_owned(), event));
        let caused = self
            .transactions
            .iter()
            .flat_map(|cause| cause.events.iter().map(|event| (cause.index.to_string(), event)));
        let mut events = own.chain(caused).peekable();
        if events.peek().is_some() {
            writeln!(out)?;
            let mut table = Table::new(["INDEX", "EVENT", "SUBJECT", "DETAILS"]);
            for (index, event) in events {
                let [name, subject, details] = event_cells(event);
                table.row([index, name, subject, details]);
            }
            table.write(out, 0)?;
        }
        Ok(())
    }
}
