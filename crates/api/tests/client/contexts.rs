//! Contexts on disk.

use crate::authority::Authority;
use ledger_api::Context;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::{KeyKind, SigningKey};
use ring::rand::SystemRandom;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use tempfile::TempDir;

fn stored() -> (TempDir, Context) {
    let home = TempDir::new().unwrap();
    let context = Authority::new().stored();
    context.save(home.path()).unwrap();
    (home, context)
}

fn damaged(file: &str, content: &str) -> Rejection {
    let (home, _) = stored();
    let path = home.path().join("contexts/Salma").join(file);
    fs::write(&path, content).unwrap();
    let refused = Context::load(home.path(), Some("Salma")).unwrap_err();
    assert!(refused.message.contains(file), "names the file: {refused}");
    refused
}

fn names(directory: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_stored_context_reads_back_the_same() {
    let (home, context) = stored();
    // Named, and as the selected one: the first that is stored is selected.
    for name in [Some("Salma"), None] {
        let read = Context::load(home.path(), name).unwrap();
        assert_eq!(
            (&read.name, &read.organisation, read.network),
            (&context.name, &context.organisation, context.network)
        );
        assert_eq!((&read.label, &read.nodes, &read.chain), (&context.label, &context.nodes, &context.chain));
        assert_eq!(read.key.to_pkcs8_der(), context.key.to_pkcs8_der());
        assert_eq!(read.ca_fingerprint("Org1"), context.ca_fingerprint("Org1"));
        assert_eq!(read.certificate().unwrap().name().unwrap(), "Salma");
        read.credentials().unwrap();
    }
}

#[test]
fn nobody_else_can_read_the_key() {
    let (home, _) = stored();
    let mode = |path: &str| fs::metadata(home.path().join(path)).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode("contexts/Salma/key.pem"), 0o600);
    assert_eq!(mode("contexts/Salma"), 0o700);
}

#[test]
fn a_key_that_others_can_read_is_refused() {
    let (home, _) = stored();
    let key = home.path().join("contexts/Salma/key.pem");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o644)).unwrap();
    let refused = Context::load(home.path(), Some("Salma")).unwrap_err();
    assert_eq!(refused.code, Code::BadFile);
    assert!(refused.found.contains("0644") && refused.wanted.contains("0600"), "{refused}");
    assert!(refused.advice().contains("chmod 600"), "{refused}");
}

#[test]
fn an_unknown_name_is_answered_with_the_nearest_one() {
    let (home, mut context) = stored();
    context.name = "Farhad".into();
    context.save(home.path()).unwrap();
    let refused = Context::load(home.path(), Some("salam")).unwrap_err();
    assert_eq!(refused.code, Code::NoContext);
    assert_eq!(refused.advice(), "did you mean \"Salma\"?");
    assert!(refused.found.contains("Farhad, Salma"), "{refused}");
    assert_eq!(Context::load(home.path(), Some("Zq")).unwrap_err().advice(), "ledgerctl context list");
}

#[test]
fn without_any_context_the_way_to_get_one_is_shown() {
    let home = TempDir::new().unwrap();
    for name in [None, Some("Salma")] {
        let refused = Context::load(home.path(), name).unwrap_err();
        assert_eq!(refused.code, Code::NoContext);
        assert!(refused.advice().starts_with("ledgerctl enroll"), "{refused}");
    }
    assert!(Context::list(home.path()).unwrap().is_empty());
}

#[test]
fn names_cannot_leave_the_directory() {
    let (home, mut context) = stored();
    for name in ["", ".", "..", "../x", "a/b", "a\0b", "a\nb", "-o", ".hidden", &"x".repeat(65)] {
        assert_eq!(Context::load(home.path(), Some(name)).unwrap_err().code, Code::NoContext, "{name:?}");
        context.name = name.into();
        assert_eq!(context.save(home.path()).unwrap_err().code, Code::NoContext, "{name:?}");
    }
    assert_eq!(Context::list(home.path()).unwrap(), ["Salma"]);
}

#[test]
fn a_damaged_file_is_named_with_its_fault() {
    assert!(damaged("context.toml", "name = ").found.contains("line 1"));
    let typo = "name = \"Salma\"\norganisation = \"Org1\"\nnetwrok = \"00\"\nnodes = [\"a:1\"]\n";
    assert!(damaged("context.toml", typo).found.contains("netwrok"));
    assert_eq!(damaged("certificate.pem", "").code, Code::BadFile);
    assert_eq!(damaged("key.pem", "no key").code, Code::BadFile);
    assert!(damaged("msps.json", "[{}]").found.contains("organisation"));
}

#[test]
fn a_missing_key_is_named() {
    let (home, _) = stored();
    fs::remove_file(home.path().join("contexts/Salma/key.pem")).unwrap();
    let refused = Context::load(home.path(), Some("Salma")).unwrap_err();
    assert_eq!(refused.code, Code::BadFile);
    assert!(refused.message.contains("key.pem"), "{refused}");
}

#[test]
fn the_key_of_somebody_else_is_refused() {
    let (home, _) = stored();
    let other = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
    fs::write(home.path().join("contexts/Salma/key.pem"), other.to_pkcs8_pem()).unwrap();
    assert_eq!(Context::load(home.path(), Some("Salma")).unwrap_err().code, Code::BadFile);
}

#[test]
fn saving_again_replaces_all_of_it_and_leaves_nothing_behind() {
    let (home, mut context) = stored();
    context.network = Hash([8; 32]);
    context.save(home.path()).unwrap();
    assert_eq!(Context::load(home.path(), None).unwrap().network, Hash([8; 32]));
    assert_eq!(names(&home.path().join("contexts")), ["Salma"]);
    let files = ["certificate.pem", "context.toml", "key.pem", "msps.json"];
    assert_eq!(names(&home.path().join("contexts/Salma")), files);
}

#[test]
fn a_replacement_that_was_cut_off_leaves_the_old_context() {
    let (home, _) = stored();
    let contexts = home.path().join("contexts");
    fs::rename(contexts.join("Salma"), contexts.join(".Salma.old")).unwrap();
    fs::create_dir(contexts.join(".Salma.new")).unwrap();
    assert_eq!(Context::list(home.path()).unwrap(), ["Salma"]);
    Context::load(home.path(), Some("Salma")).unwrap();
    Authority::new().stored().save(home.path()).unwrap();
    assert_eq!(names(&contexts), ["Salma"]);
}

#[test]
fn one_context_is_selected_at_a_time_and_none_after_it_is_removed() {
    let (home, mut context) = stored();
    context.name = "Farhad".into();
    context.save(home.path()).unwrap();
    assert_eq!(Context::current(home.path()).unwrap().as_deref(), Some("Salma"));
    Context::select(home.path(), "Farhad").unwrap();
    assert_eq!(Context::load(home.path(), None).unwrap().name, "Farhad");
    assert_eq!(Context::select(home.path(), "Nobody").unwrap_err().code, Code::NoContext);
    Context::remove(home.path(), "Farhad").unwrap();
    assert_eq!(Context::list(home.path()).unwrap(), ["Salma"]);
    let refused = Context::load(home.path(), None).unwrap_err();
    assert!(refused.advice().contains("ledgerctl context use Salma"), "{refused}");
}
