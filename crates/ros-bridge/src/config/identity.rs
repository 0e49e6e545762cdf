//! The identity of a bridge towards the ledger.

use std::path::{Path, PathBuf};

use ledger_api::{Context, home};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::settings::Section;

/// Where the identity of a bridge comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum IdentitySource {
    /// The context that `ledgerctl` has selected.
    Selected,
    /// A context of this user, by name.
    Context(String),
    /// The directory of a context, `<home>/contexts/<NAME>`.
    Directory(PathBuf),
}

impl IdentitySource {
    /// Reads `context` and `context_dir`; `directory` is where a relative path starts.
    pub(super) fn read(section: &mut Section<'_, '_>, directory: &Path) -> Self {
        let (mut context, mut context_dir) = (None, None);
        section.text("context", "the name of a context", &mut context, |name| Some(Some(name.to_owned())));
        section.text("context_dir", "the directory of a context", &mut context_dir, |path| {
            Some(Some(directory.join(path)))
        });
        match (context, context_dir) {
            (None, None) => Self::Selected,
            (Some(name), None) => Self::Context(name),
            (None, Some(path)) => Self::Directory(path),
            (Some(name), Some(path)) => {
                let found = format!("{name:?} and {:?}", path.display().to_string());
                section.conflict(["context", "context_dir"], found, "one of them".to_owned());
                Self::Directory(path)
            }
        }
    }

    /// Loads its context.
    ///
    /// # Errors
    /// As [`Context::load`].
    pub(super) fn context(&self) -> Result<Context, Rejection> {
        match self {
            Self::Selected => Context::load(&home()?, None),
            Self::Context(name) => Context::load(&home()?, Some(name)),
            Self::Directory(path) => {
                let contexts = path.parent();
                let name = path.file_name().and_then(|name| name.to_str());
                match (name, contexts, contexts.and_then(Path::parent)) {
                    (Some(name), Some(contexts), Some(home)) if contexts.ends_with("contexts") => {
                        Context::load(home, Some(name))
                    }
                    _ => Err(Rejection::new(Code::BadConfiguration, "context_dir is not usable")
                        .found(path.display().to_string())
                        .wanted("the directory of a context: <home>/contexts/<NAME>")
                        .next("ledgerctl enroll makes one below LEDGERD_HOME")),
                }
            }
        }
    }
}
