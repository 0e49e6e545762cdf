//! From the text of a person to CDR.

use crate::cdr::{ByteOrder, Writer};
use crate::definition::{Count, Primitive};
use crate::fault::Fault;
use crate::message::{Element, Field, Message, Structure};
use crate::written::Written;

/// Longest message that is written, in bytes, header included: a transaction holds no more.
pub const MESSAGE_BYTES_MAX: usize = 4 * 1024 * 1024;

/// The time that `now` stands for in a message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Time {
    /// Seconds since the UNIX epoch.
    pub sec: i32,
    /// Nanoseconds since that second.
    pub nanosec: u32,
}

impl Time {
    /// From microseconds since the UNIX epoch; the last second that a message can name, if it lies behind that.
    pub fn from_micros(micros: u64) -> Self {
        let nanosec = u32::try_from(micros % 1_000_000).unwrap_or_default().saturating_mul(1000);
        Self { sec: i32::try_from(micros / 1_000_000).unwrap_or(i32::MAX), nanosec }
    }
}

impl Message {
    /// Writes a message with its header. A missing field takes the default of the definition, and without one zero, an
    /// empty text or an empty sequence. As in `ros2 topic pub`, `now` for a `builtin_interfaces/msg/Time` is that time,
    /// and `auto` for a `std_msgs/msg/Header` one with that time.
    ///
    /// # Errors
    /// If a field is not the type's, or what is written for one cannot be its value; both with the field.
    pub fn encode(&self, written: &Written, order: ByteOrder, now: Time) -> Result<Vec<u8>, Fault> {
        let mut encoder = Encoder { writer: Writer::new(order, MESSAGE_BYTES_MAX), now };
        match written {
            Written::Map(_) | Written::Nothing => encoder.structure(&self.structure, written)?,
            other => {
                return Err(Fault::new(format!("this is no {}", self.name()))
                    .found(other.shown())
                    .wanted(self.shape())
                    .next("name the fields, in quotes for the shell"));
            }
        }
        Ok(encoder.writer.finish())
    }
}

struct Encoder {
    writer: Writer,
    now: Time,
}

impl Encoder {
    fn structure(&mut self, structure: &Structure, written: &Written) -> Result<(), Fault> {
        let given: &[(String, Written)] = match written {
            Written::Nothing => &[],
            Written::Map(given) => given,
            Written::Text(word) if structure.name == "builtin_interfaces/msg/Time" && word == "now" => {
                self.writer.number(4, self.now.sec.cast_unsigned().into())?;
                return self.writer.number(4, self.now.nanosec.into());
            }
            Written::Text(word) if structure.name == "std_msgs/msg/Header" && word == "auto" => {
                &[("stamp".to_owned(), Written::Text("now".to_owned()))]
            }
            other => {
                let wanted = Message::shape_of(structure);
                return Err(Fault::new(format!("this is no {}", structure.name)).found(other.shown()).wanted(wanted));
            }
        };
        if let Some((unknown, _)) = given.iter().find(|(name, _)| !structure.fields.iter().any(|f| *f.name == **name)) {
            let names = || structure.fields.iter().map(|field| &*field.name);
            // `x: 0,5` is a field x and a field 5.
            let next = if unknown.bytes().all(|byte| byte.is_ascii_digit()) {
                "write decimals with a point: 0.5".to_owned()
            } else {
                ledger_base::nearest::did_you_mean(unknown, names(), "")
            };
            return Err(Fault::new(format!("{} has no field {unknown}", structure.name))
                .found(crate::fault::quoted(unknown))
                .wanted(names().collect::<Vec<_>>().join(", "))
                .next(next));
        }
        if structure.fields.is_empty() {
            self.writer.number(1, 0)?;
        }
        for field in &structure.fields {
            let written = given.iter().find(|(name, _)| *field.name == **name).map(|(_, written)| written);
            let written = written.filter(|written| **written != Written::Nothing);
            let written = written.or(field.default.as_ref()).unwrap_or(&Written::Nothing);
            self.field(field, written).map_err(|fault| fault.within(&field.name))?;
        }
        Ok(())
    }

    fn field(&mut self, field: &Field, written: &Written) -> Result<(), Fault> {
        let (list, all) = match (field.count, written) {
            (Count::One, written) => return self.element(&field.element, written),
            (Count::Array(count), Written::Nothing) => {
                return (0..count).try_for_each(|_| self.element(&field.element, &Written::Nothing));
            }
            (Count::Sequence(_), Written::Nothing) => return self.writer.length(0),
            (Count::Array(count), Written::List(list)) => (list, (list.len() == count).then_some(count).ok_or(count)),
            (Count::Sequence(most), Written::List(list)) => {
                let most = most.unwrap_or(usize::MAX);
                (list, (list.len() <= most).then_some(most).ok_or(most))
            }
            (_, other) => {
                return Err(Fault::new(format!("a list of {} is wanted", field.element.name()))
                    .found(other.shown())
                    .wanted("a list such as [1, 2]"));
            }
        };
        if let Err(bound) = all {
            let exactly = if matches!(field.count, Count::Array(_)) { "" } else { "at most " };
            return Err(Fault::new("the list has the wrong length")
                .found(format!("{} elements", list.len()))
                .wanted(format!("{exactly}{bound}")));
        }
        if matches!(field.count, Count::Sequence(_)) {
            self.writer.length(list.len())?;
        }
        list.iter().try_for_each(|written| self.element(&field.element, written))
    }

    fn element(&mut self, element: &Element, written: &Written) -> Result<(), Fault> {
        match (element, written) {
            (Element::Message(structure), written) => self.structure(structure, written),
            (Element::Primitive(primitive), Written::Nothing) => self.writer.number(primitive.bytes(), 0),
            (Element::Text(_), Written::Nothing) => self.writer.text(""),
            (Element::Wide(_), Written::Nothing) => self.writer.wide(""),
            (Element::Primitive(primitive), Written::Text(text)) => {
                self.writer.number(primitive.bytes(), bits(*primitive, text)?)
            }
            (Element::Text(most), Written::Text(text)) => {
                if text.contains('\0') {
                    return Err(Fault::new("a string of ROS 2 ends at its first NUL").found(written.shown()));
                }
                if let Some(most) = most.filter(|most| text.len() > *most) {
                    return Err(Fault::new("the string is too long")
                        .found(format!("{} bytes", text.len()))
                        .wanted(format!("at most {most}")));
                }
                self.writer.text(text)
            }
            (Element::Wide(most), Written::Text(text)) => {
                let units = text.encode_utf16().count();
                if let Some(most) = most.filter(|most| units > *most) {
                    return Err(Fault::new("the string is too long")
                        .found(format!("{units} units of UTF-16"))
                        .wanted(format!("at most {most}")));
                }
                self.writer.wide(text)
            }
            (element, other) => Err(Fault::new(format!("a {} is wanted", element.name())).found(other.shown())),
        }
    }
}

impl Message {
    fn shape_of(structure: &Structure) -> String {
        let names: Vec<_> = structure.fields.iter().map(|field| format!("{}: …", field.name)).collect();
        format!("{{{}}}", names.join(", "))
    }
}

/// The bits of a number that somebody wrote.
fn bits(primitive: Primitive, text: &str) -> Result<u64, Fault> {
    let wrong = |wanted: String| {
        Fault::new(format!("this is no {}", primitive.name())).found(crate::fault::quoted(text)).wanted(wanted)
    };
    match primitive {
        Primitive::Bool => match text.to_ascii_lowercase().as_str() {
            "true" | "yes" | "on" | "1" => Ok(1),
            "false" | "no" | "off" | "0" => Ok(0),
            _ => Err(wrong("true or false".to_owned())),
        },
        Primitive::F32 => {
            let value = float(text).ok_or_else(|| wrong("a number".to_owned()))?;
            #[expect(clippy::cast_possible_truncation, reason = "the nearest float32 is what is meant")]
            let single = value as f32;
            if single.is_infinite() && value.is_finite() {
                return Err(wrong(format!("at most {:e}", f32::MAX)));
            }
            Ok(single.to_bits().into())
        }
        Primitive::F64 => {
            let value = float(text).ok_or_else(|| wrong("a number".to_owned()))?;
            let is_infinity = text.trim_start_matches(['+', '-', '.']).to_ascii_lowercase().starts_with('i');
            if value.is_infinite() && !is_infinity {
                Err(wrong(format!("at most {:e}", f64::MAX)))
            } else {
                Ok(value.to_bits())
            }
        }
        _ => {
            let (least, most) = primitive.range();
            let whole = whole(text).filter(|value| (least..=most).contains(value));
            // Two's complement: the low bits of the number are those of its type.
            whole
                .map(|value| (value & i128::from(u64::MAX)) as u64)
                .ok_or_else(|| wrong(format!("a whole number from {least} to {most}")))
        }
    }
}

/// A whole number as YAML has them: decimal, `0x`, `0o`, `0b`.
fn whole(text: &str) -> Option<i128> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (radix, digits) = match digits.get(..2) {
        Some("0x") => (16, digits.get(2..)?),
        Some("0o") => (8, digits.get(2..)?),
        Some("0b") => (2, digits.get(2..)?),
        _ => (10, digits),
    };
    // A second sign is no digit.
    let value = digits.starts_with(|c: char| c.is_digit(radix)).then(|| i128::from_str_radix(digits, radix).ok())??;
    Some(if negative { -value } else { value })
}

/// A number as YAML and JSON have them, and what [`Value`](crate::Value) writes for those that JSON does not know.
fn float(text: &str) -> Option<f64> {
    match text {
        ".nan" | ".NaN" | ".NAN" => return Some(f64::NAN),
        ".inf" | "+.inf" | ".Inf" | ".INF" => return Some(f64::INFINITY),
        "-.inf" | "-.Inf" | "-.INF" => return Some(f64::NEG_INFINITY),
        _ => {}
    }
    text.parse().ok().or_else(|| whole(text).map(|value| value as f64))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_by_the_type_of_their_field() {
        let read = |primitive, text: &str| bits(primitive, text).unwrap();
        assert_eq!(read(Primitive::I8, "-128"), u64::MAX - 127);
        assert_eq!(read(Primitive::U8, "0xff"), 255);
        assert_eq!(read(Primitive::U64, "18446744073709551615"), u64::MAX);
        assert_eq!(read(Primitive::I64, "-9223372036854775808"), 1 << 63);
        assert_eq!(read(Primitive::F64, "1"), 1.0_f64.to_bits());
        assert_eq!(read(Primitive::F64, "-1.5e3"), (-1500.0_f64).to_bits());
        assert_eq!(read(Primitive::F64, ".inf"), f64::INFINITY.to_bits());
        assert_eq!(read(Primitive::F64, "-Infinity"), f64::NEG_INFINITY.to_bits());
        assert_eq!(read(Primitive::F32, "0.1"), u64::from(0.1_f32.to_bits()));
        assert_eq!(read(Primitive::Bool, "True"), 1);
        for (primitive, text) in [
            (Primitive::U8, "256"),
            (Primitive::U8, "-1"),
            (Primitive::I8, "128"),
            (Primitive::I32, "1.0"),
            (Primitive::I32, "--1"),
            (Primitive::I32, "0x-1"),
            (Primitive::I64, "9223372036854775808"),
            (Primitive::F32, "1e39"),
            (Primitive::F64, "1e999"),
            (Primitive::F64, "fast"),
            (Primitive::Bool, "2"),
        ] {
            let fault = bits(primitive, text).unwrap_err();
            assert!(fault.found.contains(text) && !fault.wanted.is_empty(), "{text}: {fault:?}");
        }
    }

    #[test]
    fn time_is_split_as_messages_have_it() {
        assert_eq!(Time::from_micros(1_795_225_055_000_250), Time { sec: 1_795_225_055, nanosec: 250_000 });
        assert_eq!(Time::from_micros(u64::MAX).sec, i32::MAX);
    }
}
