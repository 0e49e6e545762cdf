//! This machine: the context, its disk, its certificate.

use super::acting;
use super::finding::Finding;
use crate::context;
use crate::global::Global;
use crate::health::{certificate_text, is_ending, own_certificate};
use ledger_api::Context;
use ledger_base::units::size;
use std::path::Path;

/// The disk of the contexts needs so many bytes for a renewed certificate: one MiB.
const FREE_MIN: u64 = 1 << 20;

/// The context to act as, if it can be used.
pub(super) fn context(global: &Global, findings: &mut Vec<Finding>) -> Option<Context> {
    let home = match context::home() {
        Ok(home) => home,
        Err(refused) => {
            findings.push(Finding::refused("context", &refused));
            return None;
        }
    };
    findings.push(room(&home));
    let found = match context::selected(global) {
        Ok(found) => found,
        Err(refused) => {
            findings.push(Finding::refused("context", &refused));
            return None;
        }
    };
    let chosen = match context::name_in_use(global, &home) {
        Ok(Some(_)) if acting(&found).is_empty() => String::new(),
        _ => ", by --context or LEDGERCTL_CONTEXT".to_owned(),
    };
    match context::identity(&found) {
        Ok(identity) => {
            let network = if found.label.is_empty() { found.network.to_string() } else { found.label.clone() };
            let message = format!("{} is {} of network {network}{chosen}", found.name, identity.id());
            findings.push(Finding::ok("context", message));
        }
        Err(refused) => findings.push(Finding::refused("context", &refused)),
    }
    Some(found)
}

/// The room for contexts, which change when certificates are renewed.
fn room(home: &Path) -> Finding {
    // Before anybody has enrolled it is not there yet.
    let there = home.ancestors().find(|path| path.exists()).unwrap_or(home);
    match rustix::fs::statvfs(there) {
        Ok(disk) => judged(home, disk.f_bavail.saturating_mul(disk.f_frsize), disk.f_files > 0 && disk.f_favail == 0),
        Err(error) => {
            Finding::unknown("own disk", format!("{}: {error}", home.display()), "check the path and the rights on it")
        }
    }
}

fn judged(home: &Path, free: u64, no_names: bool) -> Finding {
    let text = format!("{} free for contexts in {}", size(free), home.display());
    match free < FREE_MIN || no_names {
        true => Finding::wrong("own disk", text, "free disk space: without it, certificates cannot be renewed"),
        false => Finding::ok("own disk", text),
    }
}

/// The own certificate.
pub(super) fn certificate(context: &Context, now: u64, findings: &mut Vec<Finding>) {
    let Ok(identity) = context::identity(context) else { return };
    let own = own_certificate(&identity);
    let renew = || format!("ledgerctl identity renew{}", acting(context));
    findings.push(match certificate_text(&own, now) {
        text if now < identity.not_before => Finding::wrong(
            "certificate",
            format!("{text} is not valid yet"),
            "set the clock of this machine: timedatectl set-ntp true",
        ),
        text if now > identity.not_after => Finding::wrong("certificate", text, context.way_back()),
        text if is_ending(&own, now) => Finding::advice("certificate", text, renew()),
        text => Finding::ok("certificate", text),
    });
}

#[cfg(test)]
mod tests {
    use super::super::finding::State;
    use super::*;

    #[test]
    fn a_disk_without_room_for_a_certificate_is_wrong() {
        let state = |free, no_names| judged(Path::new("/home"), free, no_names).state;
        assert_eq!(
            [state(FREE_MIN, false), state(FREE_MIN - 1, false), state(u64::MAX, true)],
            [State::Ok, State::Wrong, State::Wrong]
        );
    }
}
