//! Query strings and parts of paths. Unknown names are rejected: a filter that is mistyped must not answer with everything.

use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::Uri;
use ledger_base::hash::Hash;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use std::any::type_name;
use std::str::FromStr;

/// A part of a path, as axum gives it.
pub(super) type Part = Result<Path<String>, PathRejection>;

/// The parameters of a query string.
pub(super) struct Parameters {
    given: Vec<(String, String)>,
}

impl Parameters {
    /// Reads them; each has one of these names.
    ///
    /// # Errors
    /// [`Code::BadArgument`] for another name, and for text that is not UTF-8.
    pub(super) fn read(uri: &Uri, names: &[&str]) -> Result<Self, Rejection> {
        let pairs = uri.query().unwrap_or_default().split('&').filter(|pair| !pair.is_empty());
        let given = pairs.map(|pair| {
            let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
            let (name, value) = (decoded(name)?, decoded(value)?);
            if names.contains(&name.as_str()) {
                return Ok((name, value));
            }
            let known = if names.is_empty() { "no parameter".to_owned() } else { names.join(", ") };
            Err(Rejection::new(Code::BadArgument, "the endpoint has no such parameter")
                .found(format!("{name:?}"))
                .wanted(known)
                .next(did_you_mean(&name, names.iter().copied(), "omit it")))
        });
        Ok(Self { given: given.collect::<Result<_, _>>()? })
    }

    /// All values of this name.
    pub(super) fn all(&self, name: &str) -> Vec<String> {
        self.given.iter().filter(|(given, _)| given == name).map(|(_, value)| value.clone()).collect()
    }

    /// The value of this name, empty if it is not given.
    ///
    /// # Errors
    /// [`Code::BadArgument`] if it is given twice.
    pub(super) fn text(&self, name: &str) -> Result<String, Rejection> {
        let mut all = self.all(name);
        if all.len() > 1 {
            return Err(
                Rejection::new(Code::BadArgument, format!("{name} is given {} times", all.len())).wanted("once")
            );
        }
        Ok(all.pop().unwrap_or_default())
    }

    /// The number of this name, 0 if it is not given.
    ///
    /// # Errors
    /// [`Code::BadArgument`] if it is none.
    pub(super) fn number<T: FromStr + Default>(&self, name: &str) -> Result<T, Rejection> {
        let text = self.text(name)?;
        if text.is_empty() { Ok(T::default()) } else { number(name, &text) }
    }

    /// All numbers of this name.
    ///
    /// # Errors
    /// [`Code::BadArgument`] if one is none.
    pub(super) fn numbers<T: FromStr>(&self, name: &str) -> Result<Vec<T>, Rejection> {
        self.all(name).iter().map(|text| number(name, text)).collect()
    }

    /// Is this switched on? It is `true`, or `false`, or not given.
    ///
    /// # Errors
    /// [`Code::BadArgument`] for anything else.
    pub(super) fn is_on(&self, name: &str) -> Result<bool, Rejection> {
        match self.text(name)?.as_str() {
            "" | "false" => Ok(false),
            "true" => Ok(true),
            other => Err(Rejection::new(Code::BadArgument, format!("{name} is not a boolean"))
                .found(format!("{other:?}"))
                .wanted("true or false")),
        }
    }

    /// The bytes of this name, in hexadecimal digits.
    ///
    /// # Errors
    /// [`Code::BadArgument`] if they are none.
    pub(super) fn bytes(&self, name: &str) -> Result<Vec<u8>, Rejection> {
        let text = self.text(name)?;
        hex::decode(&text).map_err(|_| not_hex(name, &text, "hexadecimal digits"))
    }
}

/// A height in a path.
///
/// # Errors
/// [`Code::BadArgument`] if it is none.
pub(super) fn height(part: Part) -> Result<u64, Rejection> {
    number("height", &text(part)?)
}

/// The id of a transaction in a path.
///
/// # Errors
/// [`Code::BadArgument`] if it is none.
pub(super) fn id(part: Part) -> Result<Hash, Rejection> {
    let text = text(part)?;
    Hash::from_hex(&text).ok_or_else(|| not_hex("the id of a transaction", &text, "64 hexadecimal digits"))
}

fn text(part: Part) -> Result<String, Rejection> {
    let Path(text) = part.map_err(|error| {
        Rejection::new(Code::BadArgument, "the path cannot be read").found(error.to_string()).wanted("UTF-8")
    })?;
    Ok(text)
}

fn number<T: FromStr>(name: &str, text: &str) -> Result<T, Rejection> {
    text.parse().map_err(|_| {
        Rejection::new(Code::BadArgument, format!("{name} is not a number in this range"))
            .found(format!("{text:?}"))
            .wanted(format!("decimal digits ({})", type_name::<T>()))
    })
}

fn not_hex(name: &str, text: &str, wanted: &str) -> Rejection {
    Rejection::new(Code::BadArgument, format!("{name} cannot be read")).found(format!("{text:?}")).wanted(wanted)
}

/// The text behind `%` and two digits, and behind `+` for a space.
fn decoded(text: &str) -> Result<String, Rejection> {
    let wrong = || {
        Rejection::new(Code::BadArgument, "the query string cannot be read")
            .found(format!("{text:?}"))
            .wanted("UTF-8, with % and two hexadecimal digits for other bytes")
            .next("with curl: -G --data-urlencode 'NAME=VALUE'")
    };
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((first, after)) = rest.split_first() {
        rest = after;
        match first {
            b'+' => bytes.push(b' '),
            b'%' => {
                let (digits, after) = rest.split_first_chunk::<2>().ok_or_else(wrong)?;
                rest = after;
                let mut byte = [0];
                hex::decode_to_slice(digits, &mut byte).map_err(|_| wrong())?;
                bytes.extend(byte);
            }
            other => bytes.push(*other),
        }
    }
    String::from_utf8(bytes).map_err(|_| wrong())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const NAMES: [&str; 4] = ["subject", "limit", "early", "after"];

    fn read(query: &str) -> Result<Parameters, Rejection> {
        Parameters::read(&format!("/v1/events?{query}").parse().unwrap(), &NAMES)
    }

    #[test]
    fn parameters_are_texts_numbers_switches_and_bytes() {
        let read = read("subject=Rover%2Fcmd_vel&subject=a+b&limit=7&early=true&after=0aff&").unwrap();
        assert_eq!(read.all("subject"), ["Rover/cmd_vel", "a b"]);
        assert_eq!(read.number::<u32>("limit").unwrap(), 7);
        assert!(read.is_on("early").unwrap());
        assert_eq!(read.bytes("after").unwrap(), [0x0a, 0xff]);
        let none = Parameters::read(&"/v1/events".parse().unwrap(), &NAMES).unwrap();
        assert_eq!((none.number::<u64>("limit").unwrap(), none.is_on("early").unwrap()), (0, false));
    }

    #[test]
    fn parameters_that_mean_nothing_are_rejected_with_what_is_wanted() {
        let mistyped = read("subjct=Rover").err().unwrap();
        assert!(mistyped.advice().contains("subject") && mistyped.found.contains("subjct"), "{mistyped}");
        for query in ["subject=%zz", "subject=%f", "subject=%ff%fe", "unknown"] {
            assert_eq!(read(query).err().unwrap().code, Code::BadArgument, "{query}");
        }
        let wrong = read("limit=-1&limit=2&early=yes&after=0").unwrap();
        assert!(
            wrong.number::<u32>("limit").is_err() && wrong.is_on("early").is_err() && wrong.bytes("after").is_err()
        );
        assert!(read("limit=99999999999").unwrap().number::<u32>("limit").is_err());
    }
}
