//! Refusals of a chaincode in the words of whoever typed a command: the chaincode knows its arguments as `LEASE_MS` and
//! `PAYLOAD`, people have typed `--for` and `--hex`.

use crate::time;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;

/// The words of the command line for the arguments of a function.
pub(crate) struct Words {
    /// The name of an argument on the ledger, and what it is on the command line.
    pub(crate) arguments: &'static [(&'static str, &'static str)],
    /// The command that explains itself.
    pub(crate) help: &'static str,
}

/// Of every command that names a service.
const ALWAYS: [(&str, &str); 1] = [("SERVICE", "the service")];

impl Words {
    /// The refusal as it is told to people. One that is not about an argument stays as it is.
    pub(crate) fn told(&self, mut refused: Rejection) -> Rejection {
        let about = refused.message.strip_prefix("argument ").and_then(|rest| rest.split_once(" ("));
        let about = about.and_then(|(_, rest)| rest.split_once(") is not usable"));
        let Some((name, "")) = about.filter(|_| refused.code == Code::BadArgument) else { return refused };
        let typed = self.arguments.iter().chain(&ALWAYS).find(|(known, _)| *known == name).map(|(_, typed)| *typed);
        if let Some(typed) = typed {
            refused.message = format!("{typed} is not usable");
            refused.found = spans(&refused.found);
            refused.wanted = spans(&refused.wanted);
            // Advice of the case is better than how to call the function or the command.
            if refused.own_advice().is_empty() || refused.own_advice().starts_with("call it as: ") {
                refused = refused.next(format!("{} --help", self.help));
            }
        }
        refused
    }
}

/// The text as one word of a shell.
pub(crate) fn shell_word(text: &str) -> String {
    shell::word(text).into_owned()
}

/// Thousandths as a decimal number.
pub(crate) fn decimal(thousandths: u64) -> String {
    let text = format!("{}.{:03}", thousandths / 1000, thousandths % 1000);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The text with `10 min` for `600000 ms`, also in `100 to 600000 ms`.
pub(crate) fn spans(text: &str) -> String {
    let words: Vec<&str> = text.split(' ').collect();
    let (mut told, mut rest) = (Vec::new(), words.as_slice());
    let span = |ms: &str| ms.parse::<u64>().ok().map(|ms| time::span(ms.saturating_mul(1000)));
    loop {
        (rest, _) = match rest {
            [] => break,
            [ms, "ms", after @ ..] if span(ms).is_some() => (after, told.extend(span(ms))),
            [from, "to", to, "ms", after @ ..] if span(from).is_some() && span(to).is_some() => {
                (after, told.extend([span(from), Some("to".to_owned()), span(to)].into_iter().flatten()))
            }
            [word, after @ ..] => (after, told.push((*word).to_owned())),
        };
    }
    told.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    const WORDS: Words = Words { arguments: &[("LEASE_MS", "--for")], help: "ledgerctl acquire" };

    #[test]
    fn an_argument_is_called_what_people_typed() {
        let refused = Rejection::new(Code::BadArgument, "argument 2 (LEASE_MS) is not usable").found("5 ms");
        let told = WORDS.told(refused.clone().next("call it as: acquire …"));
        assert_eq!((told.message.as_str(), told.found.as_str()), ("--for is not usable", "5 ms"));
        assert_eq!(told.advice(), "ledgerctl acquire --help");
        assert_eq!(WORDS.told(refused.next("ask the owner")).advice(), "ask the owner", "advice of the case stays");
        let service = WORDS.told(Rejection::new(Code::BadArgument, "argument 1 (SERVICE) is not usable"));
        assert_eq!(service.message, "the service is not usable");
    }

    #[test]
    fn spans_are_told_in_units_that_people_use() {
        assert_eq!(spans("172800000 ms"), "2 days");
        assert_eq!(spans("100 to 600000 ms for Turtlebot4/cmd_vel"), "100 ms to 10 min for Turtlebot4/cmd_vel");
        assert_eq!(spans("1 to 64 letters"), "1 to 64 letters");
    }

    #[test]
    fn what_is_no_refusal_of_an_argument_is_told_as_it_is() {
        for refused in [
            Rejection::new(Code::Held, "argument 2 (LEASE_MS) is not usable"),
            Rejection::new(Code::BadArgument, "argument 2 (COLOUR) is not usable").next("paint COLOUR"),
            Rejection::new(Code::BadArgument, "too few arguments").next("acquire SERVICE [LEASE_MS]"),
        ] {
            assert_eq!(WORDS.told(refused.clone()), refused);
        }
    }
}
