//! The type of a field: `float64`, `string<=10`, `Vector3[]`, `geometry_msgs/Point[<=4]`.

use super::{Count, Kind, Primitive, numbers};
use crate::fault::quoted;
use crate::name;

/// Types that definitions in IDL have and `.msg` files have not, with what takes their place.
const IDL_ONLY: [(&str, &str); 14] = [
    ("any", "nothing"),
    ("boolean", "bool"),
    ("double", "float64"),
    ("fixed", "float64"),
    ("float", "float32"),
    ("long", "int32, int64, or float64 for long double"),
    ("octet", "byte"),
    ("sequence", "TYPE[]"),
    ("short", "int16"),
    ("struct", "a message of its own"),
    ("union", "a message of its own"),
    ("unsigned", "uint16, uint32 or uint64"),
    ("wchar", "uint16, or wstring"),
    ("float128", "float64"),
];
/// Types of ROS 1, whose definitions rosidl reads and cannot build.
const ROS_1_ONLY: [(&str, &str); 2] =
    [("duration", "builtin_interfaces/Duration"), ("time", "builtin_interfaces/Time")];

/// The type of a field of a message of `package`.
pub(super) fn field(text: &str, package: &str) -> Result<(Kind, Count), String> {
    let Some(array) = text.strip_suffix(']') else { return Ok((element(text, package)?, Count::One)) };
    let (kind, bound) = array.rsplit_once('[').ok_or("a type that ends with ] has a [ in front")?;
    let length = |digits: &str| length(digits).ok_or_else(|| format!("[{bound}] is no length above 0"));
    let count = match bound.strip_prefix("<=") {
        Some(most) => Count::Sequence(Some(length(most)?)),
        None if bound.is_empty() => Count::Sequence(None),
        None => Count::Array(length(bound)?),
    };
    Ok((element(kind, package)?, count))
}

/// The type of a constant: a primitive one or a string without bound.
pub(super) fn constant(text: &str) -> Result<Kind, String> {
    simple(text).ok_or_else(|| format!("{} is not the type of a constant", quoted(text)))
}

fn element(text: &str, package: &str) -> Result<Kind, String> {
    if let Some(kind) = simple(text) {
        return Ok(kind);
    }
    let bounded = |most: &str| length(most).ok_or_else(|| format!("<={most} is no length above 0"));
    if let Some(most) = text.strip_prefix("string<=") {
        return Ok(Kind::Text(Some(bounded(most)?)));
    }
    if let Some(most) = text.strip_prefix("wstring<=") {
        return Ok(Kind::Wide(Some(bounded(most)?)));
    }
    if let Some((_, instead)) = IDL_ONLY.iter().find(|(name, _)| *name == text) {
        return Err(format!("{text} is a type of IDL only; .msg files have {instead}"));
    }
    if let Some((_, instead)) = ROS_1_ONLY.iter().find(|(name, _)| *name == text) {
        return Err(format!("{text} is a type of ROS 1 only; ROS 2 has {instead}"));
    }
    let (of, name) = match text.split_once('/') {
        Some((of, name)) => (of, name),
        None => (package, text),
    };
    if name::is_package(of) && name::is_message(name) {
        Ok(Kind::Message(format!("{of}/msg/{name}")))
    } else {
        Err(format!("{} is neither a type nor the name of a message, such as Pose or geometry_msgs/Pose", quoted(text)))
    }
}

fn simple(text: &str) -> Option<Kind> {
    match text {
        "string" => Some(Kind::Text(None)),
        "wstring" => Some(Kind::Wide(None)),
        _ => Primitive::parse(text).map(Kind::Primitive),
    }
}

/// A length of an array or a string: above 0, as Python reads a decimal number.
fn length(digits: &str) -> Option<usize> {
    numbers::decimal(digits).filter(|length| *length > 0).and_then(|length| usize::try_from(length).ok())
}
