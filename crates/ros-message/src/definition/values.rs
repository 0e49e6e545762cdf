//! Defaults and constants: the text behind a name to the value for its type.
//!
//! rosidl has rules of its own for strings: quotes are optional, no escape means anything but a quote in the same quotes, and in an array
//! quotes are removed twice. They are followed with all that is odd about them, for a definition has one meaning.

use super::lines::trim;
use super::{Count, Kind, Primitive, numbers};
use crate::fault::quoted;
use crate::written::Written;

/// The value for a field.
pub(super) fn field(kind: &Kind, count: Count, text: &str) -> Result<Written, String> {
    if let Kind::Message(name) = kind {
        return Err(format!("a field of type {name} has no default of its own"));
    }
    let exact = match count {
        Count::One => return element(kind, text),
        Count::Array(count) => Some(count),
        Count::Sequence(_) => None,
    };
    let inner = text.strip_prefix('[').and_then(|text| text.strip_suffix(']'));
    let inner = inner.ok_or("the default of an array stands in [ ]")?;
    let texts: Vec<String> = match kind {
        Kind::Text(_) | Kind::Wide(_) => strings(inner)?,
        _ if inner.is_empty() => Vec::new(),
        _ => inner.split(',').map(str::to_owned).collect(),
    };
    if let Some(count) = exact.filter(|count| *count != texts.len()) {
        return Err(format!("the default has {} elements, and the array {count}", texts.len()));
    }
    if let Count::Sequence(Some(most)) = count
        && texts.len() > most
    {
        return Err(format!("the default has {} elements, and the sequence at most {most}", texts.len()));
    }
    texts.iter().map(|text| element(kind, trim(text))).collect::<Result<_, _>>().map(Written::List)
}

/// One value, as a text that means the same for every reader.
pub(super) fn element(kind: &Kind, text: &str) -> Result<Written, String> {
    let value = match kind {
        Kind::Primitive(primitive) => number(*primitive, text)?,
        Kind::Text(most) | Kind::Wide(most) => string(text, *most)?,
        Kind::Message(_) => return Err("a message is no value".to_owned()),
    };
    Ok(Written::Text(value))
}

fn number(primitive: Primitive, text: &str) -> Result<String, String> {
    let wrong = |wanted: &str| format!("{} is no {}, which is {wanted}", quoted(text), primitive.name());
    match primitive {
        Primitive::Bool => match text.to_lowercase().as_str() {
            "true" | "1" => Ok("true".to_owned()),
            "false" | "0" => Ok("false".to_owned()),
            _ => Err(wrong("true, 1, false or 0")),
        },
        Primitive::F32 | Primitive::F64 => {
            let value = numbers::float(text).ok_or_else(|| wrong("a number, inf or nan"))?;
            #[expect(
                clippy::cast_possible_truncation,
                reason = "compilers take a float32 beyond its bounds for infinite"
            )]
            let is_infinite = value.is_infinite() || (primitive == Primitive::F32 && (value as f32).is_infinite());
            Ok(match (value.is_nan(), is_infinite, value > 0.0) {
                (true, ..) => ".nan".to_owned(),
                (_, true, true) => ".inf".to_owned(),
                (_, true, false) => "-.inf".to_owned(),
                _ => format!("{value:?}"),
            })
        }
        _ => {
            let (least, most) = primitive.range();
            let value = numbers::whole(text).filter(|value| (least..=most).contains(value));
            value.map(|value| value.to_string()).ok_or_else(|| wrong(&format!("a whole number from {least} to {most}")))
        }
    }
}

fn string(text: &str, most: Option<usize>) -> Result<String, String> {
    let in_quotes = ['"', '\''].into_iter().find(|quote| text.starts_with(*quote) && text.ends_with(*quote));
    let value = match in_quotes {
        None => text.to_owned(),
        Some(quote) => {
            // A single quote is an empty text.
            let inner = text.strip_prefix(quote).and_then(|text| text.strip_suffix(quote)).unwrap_or_default();
            let escaped = format!("\\{quote}");
            if inner.replace(&escaped, "").contains(quote) {
                return Err(format!("a {quote} within {quote} has a \\ in front"));
            }
            inner.replace(&escaped, &quote.to_string())
        }
    };
    match most.filter(|most| value.chars().count() > *most) {
        Some(most) => Err(format!("the text has {} characters, and the string at most {most}", value.chars().count())),
        None => Ok(value),
    }
}

/// The texts of an array: in quotes up to the quote that ends them, others up to the next comma.
fn strings(inner: &str) -> Result<Vec<String>, String> {
    let chars: Vec<char> = inner.chars().collect();
    let mut rest = chars.as_slice();
    let mut texts = Vec::new();
    while !rest.is_empty() {
        rest = behind_spaces(rest);
        match rest.first() {
            None => return Err("an element is missing behind the last comma".to_owned()),
            Some(',') => return Err("an element is missing in front of a comma".to_owned()),
            Some(_) => {}
        }
        let mut is_quoted = false;
        for quote in ['"', '\''] {
            if rest.first() == Some(&quote) {
                is_quoted = true;
                let end = end_of_quotes(rest, quote).ok_or_else(|| format!("a text has no {quote} at its end"))?;
                let text: String = rest.iter().take(end + 1).skip(1).collect();
                texts.push(text.replace(&format!("\\{quote}"), &quote.to_string()));
                rest = rest.get(end + 2..).unwrap_or_default();
            }
        }
        if !is_quoted {
            let end = rest.iter().position(|c| *c == ',').unwrap_or(rest.len());
            let (text, behind) = rest.split_at_checked(end).unwrap_or((rest, &[]));
            texts.push(text.iter().collect());
            rest = behind;
        }
        rest = behind_spaces(rest);
        rest = rest.strip_prefix(&[',']).unwrap_or(rest);
    }
    Ok(texts)
}

fn behind_spaces(mut chars: &[char]) -> &[char] {
    while let Some(behind) = chars.strip_prefix(&[' ']) {
        chars = behind;
    }
    chars
}

/// The place in front of the quote that ends a text, as rosidl counts it: from behind the last but one escaped quote.
fn end_of_quotes(mut chars: &[char], quote: char) -> Option<usize> {
    let mut counted = 0;
    while !chars.is_empty() {
        let at = chars.iter().skip(1).position(|c| *c == quote)?;
        if chars.get(at) != Some(&'\\') {
            return Some(counted + at);
        }
        chars = chars.get(at + 2..).unwrap_or_default();
        counted = at + 2;
    }
    None
}
