//! Rights of people, and how a change of policies changes them, in words.

use crate::command::grant::limits_text;
use crate::output::{Table, printable};
use ledger_contract::{Access, LimitChange, Limits, PolicyDiff, Right, RightOf, WouldEnd};
use std::collections::BTreeMap;
use std::io::{self, Write};

/// The differences that a set of policies makes for people.
pub(in crate::command) fn changes(out: &mut dyn Write, diff: &PolicyDiff) -> io::Result<()> {
    listed(out, "can do afterwards, and could not before:", &diff.gained)?;
    listed(out, "could do before, and cannot afterwards:", &diff.lost)?;
    if !diff.limited.is_empty() {
        writeln!(out, "have other limits afterwards:")?;
        let mut table = Table::pairs();
        for LimitChange { who, of, action, before, after } in &diff.limited {
            table.row([who.clone(), format!("{action} {of}"), words(before), "->".to_owned(), words(after)]);
        }
        table.write(out, 2)?;
    }
    ends(out, diff)?;
    if diff.incomplete {
        writeln!(out, "there are more identities or services than were evaluated: these are some of the differences")?;
    }
    if diff.gained.is_empty() && diff.lost.is_empty() && diff.limited.is_empty() && !diff.incomplete {
        writeln!(out, "no listed identity gains or loses permissions")?;
    }
    Ok(())
}

/// The grants that a set of policies ends.
pub(super) fn ends(out: &mut dyn Write, PolicyDiff { ends, unreachable, .. }: &PolicyDiff) -> io::Result<()> {
    for WouldEnd { service, holder, epoch, reason, .. } in ends {
        writeln!(
            out,
            "it ends the grant of {service} by {} (epoch {epoch}): {}",
            printable(holder),
            printable(reason)
        )?;
    }
    for robot in unreachable {
        writeln!(out, "no known identity could publish to {} any more", printable(robot))?;
    }
    Ok(())
}

fn listed(out: &mut dyn Write, title: &str, rights: &[RightOf]) -> io::Result<()> {
    if rights.is_empty() {
        return Ok(());
    }
    writeln!(out, "{title}")?;
    let mut rows = Rows::default();
    for RightOf { who, right } in rights {
        rows.add(who, right, false);
    }
    rows.write(out, 2)
}

/// The rights that people have, each with its reason.
pub(in crate::command) struct Holdings<'a>(pub(in crate::command) &'a [Access]);

impl Holdings<'_> {
    /// Writes a line for each person, object, reason and limit.
    pub(in crate::command) fn write(&self, out: &mut dyn Write, indent: usize) -> io::Result<()> {
        let mut rows = Rows::default();
        for Access { who, rights, .. } in self.0 {
            rights.iter().for_each(|right| rows.add(who, right, true));
        }
        rows.write(out, indent)
    }
}

/// Rights with the same person, object, reason and limits, and their actions.
#[derive(Default)]
struct Rows(BTreeMap<[String; 4], Vec<String>>);

impl Rows {
    fn add(&mut self, who: &str, right: &Right, with_reason: bool) {
        let Right { of, action, policies, rule, limits, closed } = right;
        let reason = match (with_reason, rule.is_empty()) {
            (false, _) => String::new(),
            (true, false) => format!("as {rule}"),
            (true, true) if policies.is_empty() => String::new(),
            (true, true) => format!("by policy {}", policies.join(", ")),
        };
        let bound = match closed.is_empty() {
            true if limits.is_none() => String::new(),
            true => limits_text(limits),
            false => format!("only within {}", closed.join(" or ")),
        };
        self.0.entry([who.to_owned(), of.clone(), reason, bound]).or_default().push(action.clone());
    }

    fn write(self, out: &mut dyn Write, indent: usize) -> io::Result<()> {
        let mut table = Table::pairs();
        for ([who, of, reason, bound], actions) in self.0 {
            table.row([who, of, actions.join(", "), bound, reason]);
        }
        table.write(out, indent)
    }
}

fn words(limits: &Limits) -> String {
    if limits.is_none() { "no limit".to_owned() } else { limits_text(limits) }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn right(of: &str, action: &str, limits: Limits) -> Right {
        let (of, action) = (of.into(), action.into());
        Right { of, action, policies: vec!["p".into()], rule: String::new(), limits, closed: vec![] }
    }

    #[test]
    fn a_change_says_who_gains_loses_and_is_limited() {
        let slow = Limits { max_linear_mm_s: Some(300), ..Limits::default() };
        let of =
            |who: &str, action: &str| RightOf { who: who.into(), right: right("Husky/cmd_vel", action, slow.clone()) };
        let limited = LimitChange {
            who: "Org1/Salma".into(),
            of: "Husky/cmd_vel".into(),
            action: "acquire".into(),
            before: Limits::default(),
            after: slow.clone(),
        };
        let gained = vec![of("Org1/Farhad", "acquire"), of("Org1/Farhad", "subscribe")];
        let diff = PolicyDiff { gained, limited: vec![limited], ..PolicyDiff::default() };
        let mut out = Vec::new();
        changes(&mut out, &diff).unwrap();
        let wanted = "can do afterwards, and could not before:\n  Org1/Farhad  Husky/cmd_vel  acquire, subscribe  0.3 m/s\n\
                      have other limits afterwards:\n  Org1/Salma  acquire Husky/cmd_vel  no limit  ->  0.3 m/s\n";
        assert_eq!(String::from_utf8(out).unwrap(), wanted);
        let mut out = Vec::new();
        changes(&mut out, &PolicyDiff::default()).unwrap();
        assert_eq!(String::from_utf8(out).unwrap(), "no listed identity gains or loses permissions\n");
    }

    #[test]
    fn those_who_may_still_are_listed_with_the_reason() {
        let by_rule = Right {
            policies: vec![],
            rule: "a holder of Husky/cmd_vel".into(),
            ..right("Husky", "stop", Limits::default())
        };
        let rights = vec![right("Husky/cmd_vel", "acquire", Limits::default()), by_rule];
        let mut out = Vec::new();
        Holdings(&[Access { who: "Org1/Salma".into(), role: "member".into(), rights }]).write(&mut out, 0).unwrap();
        let wanted = "Org1/Salma  Husky          stop       as a holder of Husky/cmd_vel\n\
                      Org1/Salma  Husky/cmd_vel  acquire    by policy p\n";
        assert_eq!(
            String::from_utf8(out).unwrap().split_whitespace().collect::<Vec<_>>(),
            wanted.split_whitespace().collect::<Vec<_>>()
        );
    }
}
