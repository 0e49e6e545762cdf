//! Messages as people write them, and the definitions of their types.

use super::bytes;
use ledger_base::rejection::{Code, Rejection};
use ros_message::{Fault, Library, Message};
use std::path::Path;

/// Definitions of types that are not built in.
#[derive(Debug, Default, clap::Args)]
pub(crate) struct Definitions {
    /// Definition of a type that is not built in; the path ends with package/msg/Name.msg, or the name stands before it.
    /// May be given several times
    #[arg(long = "msg", value_name = "[TYPE=]FILE")]
    msg: Vec<String>,
}

impl Definitions {
    /// The built-in definitions and those of the files.
    ///
    /// # Errors
    /// [`Code::BadFile`] if one cannot be read or understood.
    pub(crate) fn library(&self) -> Result<Library, Rejection> {
        let mut library = Library::builtin();
        for argument in &self.msg {
            let (name, path) = match argument.split_once('=') {
                Some((name, path)) => (name.to_owned(), path),
                None => {
                    (Library::name_of_path(argument).map_err(|fault| unusable(argument, fault))?, argument.as_str())
                }
            };
            let text = bytes::from_file(Path::new(path))?;
            let text = ledger_base::text::of_bytes(&text).map_err(|fault| {
                Rejection::new(Code::BadFile, format!("{path} is no definition of a message"))
                    .found(fault.to_string())
                    .wanted("the text of a .msg file")
            })?;
            library.add(&name, &text).map_err(|fault| unusable(path, fault))?;
        }
        Ok(library)
    }

    /// The type of this name.
    ///
    /// # Errors
    /// [`Code::BadMessage`] if it, or a type within it, is not defined.
    pub(crate) fn message(&self, type_name: &str) -> Result<Message, Rejection> {
        self.library()?.message(type_name).map_err(|fault| {
            let unknown = refused(fault);
            let file = format!("--msg {type_name}=FILE.msg for its definition, or --hex for its bytes");
            if unknown.advice().is_empty() { unknown.next(file) } else { unknown }
        })
    }
}

fn unusable(path: &str, fault: Fault) -> Rejection {
    let Fault { message, found, wanted, next } = fault;
    Rejection::new(Code::BadFile, format!("the definition {path} cannot be used: {message}"))
        .found(found)
        .wanted(wanted)
        .next(if next.is_empty() { "compare with: ros2 interface show TYPE".to_owned() } else { next })
}

/// The refusal of a message that its type does not admit.
pub(crate) fn refused(fault: Fault) -> Rejection {
    let Fault { message, found, wanted, next } = fault;
    Rejection::new(Code::BadMessage, message).found(found).wanted(wanted).next(next)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn definitions(msg: &[String]) -> Definitions {
        Definitions { msg: msg.to_vec() }
    }

    #[test]
    fn files_are_named_by_their_path_or_by_the_argument() {
        let dir = tempfile::tempdir().unwrap();
        let package = dir.path().join("arm_msgs/msg");
        std::fs::create_dir_all(&package).unwrap();
        let by_path = package.join("Grip.msg").display().to_string();
        std::fs::write(&by_path, "float32 force\n").unwrap();
        let other = dir.path().join("other").display().to_string();
        std::fs::write(&other, "arm_msgs/Grip left\n").unwrap();
        // In any order: what contains another may come first.
        let given = definitions(&[format!("arm_msgs/msg/Arm={other}"), by_path]);
        assert_eq!(given.message("arm_msgs/msg/Arm").unwrap().shape(), "{left: {force: 0.0}}");
        assert_eq!(given.message("geometry_msgs/msg/Point").unwrap().shape(), "{x: 0.0, y: 0.0, z: 0.0}");
    }

    #[test]
    fn a_file_that_is_no_definition_and_a_type_without_one_are_told() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("Grip.msg").display().to_string();
        std::fs::write(&path, "float32\n").unwrap();
        let unnamed = definitions(std::slice::from_ref(&path)).library().unwrap_err();
        assert_eq!(unnamed.code, Code::BadFile);
        assert!(unnamed.advice().contains("package/msg/Name=FILE"), "{unnamed:?}");
        let broken = definitions(&[format!("arm_msgs/msg/Grip={path}")]).library().unwrap_err();
        assert!(broken.message.contains("line 1") && broken.code == Code::BadFile, "{broken:?}");
        let missing = definitions(&["a_msgs/msg/B=/nowhere/B.msg".to_owned()]).library().unwrap_err();
        assert_eq!(missing.code, Code::BadFile);
        let unknown = definitions(&[]).message("arm_msgs/msg/Grip").unwrap_err();
        assert_eq!(unknown.code, Code::BadMessage);
        assert!(unknown.advice().contains("--msg arm_msgs/msg/Grip=FILE.msg"), "{unknown:?}");
    }
}
