//! Certificates of people, renewed when they are used.

use crate::authority::Authority;
use crate::fake::Fake;
use ledger_api::context::RenewalRule;
use ledger_api::{Client, Context, Renewed};
use ledger_base::rejection::{Code, Rejection};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use tempfile::TempDir;

/// A context in the last third of its life, by a wide margin.
fn aged(authority: &Authority, node: &Fake) -> (TempDir, Context) {
    let home = TempDir::new().unwrap();
    authority.valid(&[node], (1970, 2040)).save(home.path()).unwrap();
    let context = Context::load(home.path(), None).unwrap();
    (home, context)
}

fn renewed(outcome: Renewed) -> Option<Context> {
    match outcome {
        Renewed::Yes(context) => Some(*context),
        Renewed::No | Renewed::Failed(_) => None,
    }
}

#[tokio::test]
async fn a_certificate_in_the_last_third_of_its_life_is_renewed_at_use_and_stored() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let (home, context) = aged(&authority, &node);
    let client = Client::connect(&context).await.unwrap();
    let renewed = renewed(context.renew_if_due(&client).await.unwrap()).unwrap();
    assert_ne!(renewed.chain, context.chain);
    let stored = Context::load(home.path(), None).unwrap();
    assert_eq!((&stored.chain, stored.key.to_pkcs8_der()), (&renewed.chain, renewed.key.to_pkcs8_der()));
    let client = Client::connect(&stored).await.unwrap();
    assert!(matches!(stored.renew_if_due(&client).await.unwrap(), Renewed::No), "it is young");
    assert_eq!(node.node.renewals.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn never_switches_it_off() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let (home, context) = aged(&authority, &node);
    let client = Client::connect(&context).await.unwrap();
    let set = |rule| {
        Context::change(home.path(), "Salma", |context| {
            context.renew = rule;
            Ok(())
        })
        .unwrap()
    };
    assert!(matches!(set(RenewalRule::Never).renew_if_due(&client).await.unwrap(), Renewed::No));
    let stored = Context::load(home.path(), None).unwrap();
    assert_eq!(stored.renew, RenewalRule::Never);
    // Whoever says so renews all the same.
    assert_ne!(stored.renew(&client).await.unwrap().chain, context.chain);
    assert_eq!(Context::load(home.path(), None).unwrap().renew, RenewalRule::Never);
}

#[tokio::test]
async fn of_many_commands_at_once_one_renews_and_all_have_the_same_certificate() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let (home, context) = aged(&authority, &node);
    let client = Client::connect(&context).await.unwrap();
    let mut commands = tokio::task::JoinSet::new();
    for _ in 0..8 {
        let (context, client) = (context.clone(), client.clone());
        commands.spawn(async move { context.renew_if_due(&client).await.unwrap() });
    }
    let outcomes = commands.join_all().await;
    let stored = Context::load(home.path(), None).unwrap();
    assert!(outcomes.into_iter().filter_map(renewed).all(|context| context.chain == stored.chain));
    assert_eq!(node.node.renewals.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn a_ca_that_refuses_is_told_once_and_left_in_peace_for_a_while() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let (home, context) = aged(&authority, &node);
    let client = Client::connect(&context).await.unwrap();
    let refusal = Rejection::new(Code::NotFound, "\"Salma\" is not registered");
    *node.node.no_renewal.lock().unwrap() = Some(refusal.clone());
    assert_eq!(context.renew_if_due(&client).await.unwrap_err(), refusal);
    let again = context.renew_if_due(&client).await.unwrap();
    assert!(matches!(&again, Renewed::Failed(reason) if *reason == refusal.message), "{again:?}");
    assert_eq!(node.node.renewals.load(Ordering::SeqCst), 1);
    assert_eq!(Context::load(home.path(), None).unwrap().chain, context.chain, "the present one stays in use");
    // Who asks for it is not put off.
    *node.node.no_renewal.lock().unwrap() = None;
    assert_ne!(context.renew(&client).await.unwrap().chain, context.chain);
}

#[tokio::test]
async fn readers_never_see_half_of_a_renewal() {
    let authority = Arc::new(Authority::new());
    let home = TempDir::new().unwrap();
    let (one, other) = (authority.stored(), authority.stored());
    one.save(home.path()).unwrap();
    let place = home.path().to_owned();
    let writer = std::thread::spawn(move || {
        for context in std::iter::repeat_n([&one, &other], 50).flatten() {
            context.save(&place).unwrap();
        }
    });
    while !writer.is_finished() {
        // Certificate and key of the same save: loading checks that they belong together.
        Context::load(home.path(), Some("Salma")).unwrap();
    }
    writer.join().unwrap();
}
