//! Messages as people write them, and the definitions of their types.

use super::bytes;
use crate::output::Output;
use ledger_base::rejection::{Code, Rejection};
use ros_message::{Fault, Library, Message};
use std::path::Path;

/// Definitions of types that are not built in.
#[derive(Debug, Default, clap::Args)]
pub(crate) struct Definitions {
    /// Definition of a type that is not built in: a path that ends in package/msg/Name.msg, or package/msg/Name=FILE.
    /// May be given several times
    #[arg(long = "msg", value_name = "[TYPE=]FILE")]
    msg: Vec<String>,
}

impl Definitions {
    /// The built-in definitions and those of the files. A file that is not understood is named when its type is needed.
    ///
    /// # Errors
    /// [`Code::BadFile`] if a file cannot be read, or if the type that it defines has no possible name.
    pub(crate) fn library(&self) -> Result<Library, Rejection> {
        self.read().map(|(library, _)| library)
    }

    /// Reads the files once, before anything else is done, and names those that are not understood.
    ///
    /// # Errors
    /// As [`Self::library`].
    pub(crate) fn check(&self, output: &Output) -> Result<(), Rejection> {
        for (path, fault) in self.read()?.1 {
            output.note(&format!("the definition {path} is ignored: {} (found {})", fault.message, fault.found));
        }
        Ok(())
    }

    /// The definitions, and the files that are not understood.
    fn read(&self) -> Result<(Library, Vec<(String, Fault)>), Rejection> {
        let mut library = Library::builtin();
        let mut faulty = Vec::new();
        for argument in &self.msg {
            let (name, path) = match argument.split_once('=') {
                Some((name, path)) => (name.to_owned(), path),
                None => {
                    (Library::name_of_path(argument).map_err(|fault| unusable(argument, fault))?, argument.as_str())
                }
            };
            let name = Library::full_name(&name).map_err(|fault| unusable(argument, fault))?;
            let text = bytes::from_file(Path::new(path))?;
            let text = ledger_base::text::of_bytes(&text).map_err(|fault| {
                Rejection::new(Code::BadFile, format!("{path} is not a message definition"))
                    .found(fault.to_string())
                    .wanted("the text of a .msg file")
            })?;
            if let Err(fault) = library.add(&name, &text) {
                faulty.push((path.to_owned(), fault));
            }
        }
        Ok((library, faulty))
    }

    /// The type of this name.
    ///
    /// # Errors
    /// [`Code::BadMessage`] if it, or a type within it, is not defined, or not understood.
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
    Rejection::new(Code::BadFile, format!("the definition {path} is ignored: {message}"))
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
        std::fs::write(&path, "float32 force\n").unwrap();
        let unnamed = definitions(std::slice::from_ref(&path)).library().unwrap_err();
        assert_eq!(unnamed.code, Code::BadFile);
        assert!(unnamed.advice().contains("package/msg/Name=FILE"), "{unnamed:?}");
        let misnamed = definitions(&[format!("arm_msgs/msg/grip={path}")]).library().unwrap_err();
        assert_eq!(misnamed.code, Code::BadFile);
        let missing = definitions(&["a_msgs/msg/B=/nowhere/B.msg".to_owned()]).library().unwrap_err();
        assert_eq!(missing.code, Code::BadFile);
        let unknown = definitions(&[]).message("arm_msgs/msg/Grip").unwrap_err();
        assert_eq!(unknown.code, Code::BadMessage);
        assert!(unknown.advice().contains("--msg arm_msgs/msg/Grip=FILE.msg"), "{unknown:?}");
    }

    #[test]
    fn a_definition_that_is_not_understood_is_named_when_it_is_needed_and_harms_no_other() {
        let dir = tempfile::tempdir().unwrap();
        let file = |name: &str, text: &str| {
            let path = dir.path().join(name).display().to_string();
            std::fs::write(&path, text).unwrap();
            format!("arm_msgs/msg/{name}={path}")
        };
        let given = definitions(&[file("Bad", "float32\n"), file("Grip", "float32 force\n"), file("Arm", "Bad bad\n")]);
        assert_eq!(given.message("arm_msgs/msg/Grip").unwrap().shape(), "{force: 0.0}");
        for name in ["arm_msgs/msg/Bad", "arm_msgs/msg/Arm"] {
            let fault = given.message(name).unwrap_err();
            assert!(fault.message.contains("line 1 of the definition of arm_msgs/msg/Bad"), "{fault:?}");
            assert_eq!(fault.code, Code::BadMessage);
        }
    }
}
