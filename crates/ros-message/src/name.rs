//! Names of types and of what is in them: `geometry_msgs/msg/Twist`, `std_srvs/srv/SetBool_Request`.

use crate::fault::{Fault, quoted};

/// Longest name of a type, in bytes.
const NAME_BYTES_MAX: usize = 255;

/// The full name of a type that is written `package/msg/Name`, the same with `srv` or `action`, or `package/Name`. Types that are defined in
/// IDL only may have names that [`is_message`] does not admit.
///
/// # Errors
/// If it is none of these.
pub(crate) fn full(text: &str) -> Result<String, Fault> {
    let parts: Vec<&str> = text.split('/').collect();
    let (package, kind, name) = match parts.as_slice() {
        [package, kind @ ("msg" | "srv" | "action"), name] => (*package, *kind, *name),
        [package, name] => (*package, "msg", *name),
        _ => return Err(no_name(text)),
    };
    let full = format!("{package}/{kind}/{name}");
    if !is_name(package) || !is_name(name) || full.len() > NAME_BYTES_MAX { Err(no_name(text)) } else { Ok(full) }
}

/// Is this a full name that a definition can have?
///
/// # Errors
/// If it is not.
pub(crate) fn definable(full: &str) -> Result<(), Fault> {
    let mut parts = full.split('/');
    let (package, name) = (parts.next().unwrap_or_default(), parts.next_back().unwrap_or_default());
    if is_package(package) && is_message(name) {
        return Ok(());
    }
    Err(Fault::new("a definition cannot have this name")
        .found(quoted(full))
        .wanted("a package in lower case, and a name in CamelCase such as arm_msgs/msg/GripState"))
}

fn no_name(text: &str) -> Fault {
    Fault::new("this is not the name of a message type")
        .found(quoted(text))
        .wanted("package/msg/Name such as geometry_msgs/msg/Twist")
}

/// The package of a full name.
pub(crate) fn package(full: &str) -> &str {
    full.split('/').next().unwrap_or_default()
}

/// Letters, digits and `_`, beginning with a letter.
fn is_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

/// Is `_` in it only single, and not at its end?
fn is_parted(text: &str) -> bool {
    !text.contains("__") && !text.ends_with('_')
}

/// A package, as definitions name it.
pub(crate) fn is_package(text: &str) -> bool {
    is_field(text)
}

/// A field.
pub(crate) fn is_field(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_lowercase())
        && text.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_')
        && is_parted(text)
}

/// A constant.
pub(crate) fn is_constant(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_uppercase())
        && text.bytes().all(|b| b.is_ascii_uppercase() || b.is_ascii_digit() || b == b'_')
        && is_parted(text)
}

/// A message, without its package: also one of those that make up a service or an action.
pub(crate) fn is_message(text: &str) -> bool {
    let mut name = text.strip_prefix("Sample_").unwrap_or(text);
    for suffix in ["_Request", "_Response", "_Goal", "_Result", "_Feedback"] {
        name = name.strip_suffix(suffix).unwrap_or(name);
    }
    name.starts_with(|c: char| c.is_ascii_uppercase()) && name.bytes().all(|b| b.is_ascii_alphanumeric())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_as_people_write_them() {
        assert_eq!(full("geometry_msgs/msg/Twist").unwrap(), "geometry_msgs/msg/Twist");
        assert_eq!(full("geometry_msgs/Twist").unwrap(), "geometry_msgs/msg/Twist");
        assert_eq!(full("a/srv/B").unwrap(), "a/srv/B");
        for wrong in ["", "Vector3", "a/b/C", "a/idl/B", "1/msg/B", "a/msg/", "a/msg/B/c", "a b/msg/C"] {
            assert!(full(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_definition_has_a_name_that_rosidl_admits() {
        for name in ["arm_msgs/msg/Grip", "arm_msgs/srv/Grip_Request", "a1/action/Grip2_Feedback", "a/msg/Sample_B"] {
            assert!(definable(name).is_ok(), "{name}");
        }
        for name in ["Arm/msg/Grip", "arm__msgs/msg/Grip", "arm_/msg/Grip", "arm/msg/grip", "arm/msg/Left_Grip"] {
            assert!(definable(name).is_err(), "{name}");
        }
    }
}
