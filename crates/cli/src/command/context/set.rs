//! `context set`: what a context does by itself.

use super::Done;
use crate::failure::Failure;
use crate::output::Output;
use ledger_api::Context;
use ledger_api::context::RenewalRule;
use std::path::Path;

/// Change a setting of a context: renew=auto or renew=never.
///
/// With renew=auto, the default, the certificate is renewed when it is used in the last third of its validity.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl context set Salma renew=never")]
pub(crate) struct Set {
    /// Name of the context
    name: String,
    /// renew=auto or renew=never
    #[arg(value_name = "SETTING=VALUE", value_parser = setting)]
    setting: RenewalRule,
}

fn setting(text: &str) -> Result<RenewalRule, String> {
    match text.split_once('=') {
        Some(("renew", value)) => rule(value),
        Some((name, _)) => Err(format!("there is no setting {name:?}; wanted renew=auto or renew=never")),
        None => Err("wanted renew=auto or renew=never".to_owned()),
    }
}

/// When a certificate is renewed, by its word.
pub(crate) fn rule(text: &str) -> Result<RenewalRule, String> {
    let mut known = [RenewalRule::Auto, RenewalRule::Never].into_iter();
    known.find(|rule| rule.as_str() == text).ok_or_else(|| "wanted auto or never".to_owned())
}

impl Set {
    pub(super) fn run(self, home: &Path, output: &mut Output) -> Result<(), Failure> {
        Context::change(home, &self.name, |context| {
            context.renew = self.setting;
            Ok(())
        })?;
        let done = match self.setting {
            RenewalRule::Auto => "set to renew=auto",
            RenewalRule::Never => "set to renew=never",
        };
        output.show(&Done { context: self.name, done })
    }
}
