//! Names of message types: `geometry_msgs/msg/Twist`.

use crate::fault::{Fault, quoted};

/// Longest name of a type, in bytes.
const NAME_BYTES_MAX: usize = 255;

/// The full name of a type that is written `package/msg/Name`, `package/Name`, or, in a definition of `package`, `Name`.
///
/// # Errors
/// If it is none of these.
pub(crate) fn full(text: &str, package: Option<&str>) -> Result<String, Fault> {
    let parts: Vec<&str> = text.split('/').collect();
    let name = match (parts.as_slice(), package) {
        ([package, "msg", name], _) | ([package, name], _) if is_name(package) && is_name(name) => (*package, *name),
        ([name], Some(package)) if is_name(name) => (package, *name),
        _ => return Err(no_name(text)),
    };
    let full = format!("{}/msg/{}", name.0, name.1);
    if full.len() > NAME_BYTES_MAX { Err(no_name(text)) } else { Ok(full) }
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
pub(crate) fn is_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_as_definitions_write_them() {
        assert_eq!(full("geometry_msgs/msg/Twist", None).unwrap(), "geometry_msgs/msg/Twist");
        assert_eq!(full("geometry_msgs/Twist", None).unwrap(), "geometry_msgs/msg/Twist");
        assert_eq!(full("Vector3", Some("geometry_msgs")).unwrap(), "geometry_msgs/msg/Vector3");
        for wrong in ["", "Vector3", "a/b/C", "a/srv/B", "1/msg/B", "a/msg/", "a/msg/B/c", "a b/msg/C"] {
            assert!(full(wrong, None).is_err(), "{wrong}");
        }
    }
}
