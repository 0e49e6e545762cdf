//! The calls, and the settings of owners, in every combination that the ledger takes.

use crate::fleet::SECOND;
use crate::model::{Conflict, OWNER, PLACES, Settings, Wanted};
use proptest::prelude::*;

/// One call, or what happens otherwise.
#[derive(Clone, Debug)]
pub(super) enum Step {
    Acquire {
        at: usize,
        who: usize,
        less: i64,
        wait: Option<u64>,
    },
    AcquireAll {
        who: usize,
        services: Vec<usize>,
        less: i64,
    },
    Confirm {
        at: usize,
        by: usize,
        who: usize,
    },
    Renew {
        at: usize,
        who: usize,
    },
    Release {
        at: usize,
        who: usize,
    },
    Publish {
        at: usize,
        who: usize,
    },
    Delegate {
        at: usize,
        who: usize,
        to: usize,
        lasts: Option<u64>,
        may_delegate: bool,
    },
    HandOver {
        at: usize,
        who: usize,
        to: usize,
    },
    Recall {
        at: usize,
        who: usize,
    },
    /// The holder of a service passes it on, whoever that is.
    Lend {
        at: usize,
        to: usize,
        may_delegate: bool,
    },
    Submit {
        at: usize,
        who: usize,
        wanted: Wanted,
    },
    /// By somebody about the n-th newest task.
    Progress {
        by: By,
        back: u64,
        more: u64,
    },
    Fail {
        by: By,
        back: u64,
    },
    Cancel {
        by: By,
        back: u64,
    },
    Wait(u64),
    Revoke(usize),
    Take(usize),
    Stop(usize),
    Resume(usize),
    Set(usize, Settings),
    Forbid(Vec<usize>),
    Restart,
}

/// The one who reports about a task.
#[derive(Clone, Copy, Debug)]
pub(super) enum By {
    Submitter,
    Robot,
    Person(usize),
}

pub(super) fn settings(has_readers: bool) -> impl Strategy<Value = Settings> {
    let conflict = prop_oneof![1 => Just(Conflict::Deny), 2 => Just(Conflict::Queue), 2 => Just(Conflict::Preempt)];
    let spans = (1_u64..8, prop::option::of(1_u64..4), prop::option::of(1_u64..6), 1_u64..20);
    let readers = prop::option::of(1_usize..3).prop_map(move |readers| readers.filter(|_| has_readers));
    let gives = (prop::option::weighted(0.2, 1_usize..3), any::<bool>());
    let places = prop_oneof![3 => Just(1), 3 => Just(2), 1 => Just(usize::MAX)];
    (places, readers, conflict, 1_usize..5, any::<bool>(), spans, gives).prop_map(
        |(places, readers, conflict, line, lined, spans, gives)| {
            let has_line = conflict == Conflict::Queue || (conflict == Conflict::Preempt && lined);
            let confirm = gives.0.filter(|_| readers.is_none());
            Settings {
                // Where nobody's reading is limited, somebody's writing is.
                places: if places == usize::MAX && readers.is_none() { 1 } else { places },
                readers,
                conflict,
                line: if has_line { line } else { 0 },
                patience: if has_line { spans.0 * 3 * SECOND } else { 600 * SECOND },
                aging: spans.1.filter(|_| has_line).map(|aging| aging * SECOND),
                min_hold: spans.2.filter(|_| conflict == Conflict::Preempt).map_or(0, |hold| hold * SECOND),
                confirm,
                confirm_within: if confirm.is_some() { spans.3 * SECOND } else { 60 * SECOND },
                delegable: gives.1 && confirm.is_none(),
            }
        },
    )
}

/// The settings as the owner types them. Those that are not set get their defaults.
pub(super) fn json(settings: &Settings) -> String {
    let conflict = match settings.conflict {
        Conflict::Deny => "\"deny\"",
        Conflict::Queue => "\"queue\"",
        Conflict::Preempt => "\"preempt\"",
    };
    let mut sharing = vec![("on_conflict", conflict.to_owned())];
    let mut clear = Vec::new();
    let mut set = |key: &'static str, value: Option<String>| match value {
        Some(value) => sharing.push((key, value)),
        None => clear.push(key),
    };
    let (lined, fights) = (settings.line > 0, settings.conflict != Conflict::Deny);
    let limited = settings.places != 1 || settings.readers.is_some();
    let (ms, asks) = (|span: u64| (span / 1000).to_string(), settings.confirm.is_some());
    set("publishers", (limited && settings.places != usize::MAX).then(|| settings.places.to_string()));
    set("subscribers", settings.readers.map(|readers| readers.to_string()));
    set("queue_max", lined.then(|| settings.line.to_string()));
    set("queue_wait_max_ms", lined.then(|| ms(settings.patience)));
    set("aging_ms", settings.aging.map(ms));
    set("min_hold_ms", (settings.min_hold > 0).then(|| ms(settings.min_hold)));
    set("priority", fights.then(|| "\"attribute:rank\"".to_owned()));
    set("confirm", settings.confirm.map(|confirm| confirm.to_string()));
    set("confirm_within_ms", asks.then(|| ms(settings.confirm_within)));
    set("delegable", settings.delegable.then(|| "true".to_owned()));
    let mode = if limited { "limited" } else { "exclusive" };
    let sharing: Vec<String> = sharing.iter().map(|(key, value)| format!("\"{key}\":{value}")).collect();
    format!(r#"{{"mode":"{mode}","sharing":{{{}}},"clear":{clear:?}}}"#, sharing.join(","))
}

pub(super) fn step() -> impl Strategy<Value = Step> {
    let who = || 0..OWNER;
    let at = || prop_oneof![5 => Just(0_usize), 2 => Just(1), 3 => Just(PLACES)];
    let driven = || prop_oneof![3 => Just(0_usize), 2 => Just(1)];
    let wait = prop_oneof![3 => Just(None), 1 => Just(Some(0)), 3 => (1_u64..20).prop_map(|s| Some(s * SECOND))];
    let by = || prop_oneof![5 => Just(By::Submitter), 3 => Just(By::Robot), 1 => (0..=OWNER).prop_map(By::Person)];
    let lasts = || prop::option::weighted(0.4, (1_u64..60).prop_map(|tenths| tenths * SECOND / 10));
    let wanted =
        (1_u64..4, 0_i64..2, prop::option::weighted(0.3, 0..8 * SECOND), prop::option::weighted(0.3, 0..20 * SECOND));
    let wanted = (wanted, any::<bool>()).prop_map(|((points, less, not_before, deadline), requeue)| Wanted {
        points,
        less,
        not_before,
        deadline,
        requeue,
    });
    let services = prop::collection::vec(at(), 1..4);
    prop_oneof![
        14 => (at(), who(), 0_i64..2, wait).prop_map(|(at, who, less, wait)| Step::Acquire { at, who, less, wait }),
        3 => (who(), services, 0_i64..2).prop_map(|(who, services, less)| Step::AcquireAll { who, services, less }),
        6 => (driven(), 0..=OWNER, who()).prop_map(|(at, by, who)| Step::Confirm { at, by, who }),
        2 => (at(), who()).prop_map(|(at, who)| Step::Renew { at, who }),
        5 => (at(), 0..=OWNER).prop_map(|(at, who)| Step::Release { at, who }),
        4 => (driven(), who()).prop_map(|(at, who)| Step::Publish { at, who }),
        2 => (at(), who(), who(), lasts(), any::<bool>())
            .prop_map(|(at, who, to, lasts, may_delegate)| Step::Delegate { at, who, to, lasts, may_delegate }),
        1 => (at(), who(), who()).prop_map(|(at, who, to)| Step::HandOver { at, who, to }),
        4 => (at(), who(), any::<bool>()).prop_map(|(at, to, may_delegate)| Step::Lend { at, to, may_delegate }),
        3 => (at(), who()).prop_map(|(at, who)| Step::Recall { at, who }),
        8 => (at(), who(), wanted).prop_map(|(at, who, wanted)| Step::Submit { at, who, wanted }),
        8 => (by(), 0_u64..4, 0_u64..3).prop_map(|(by, back, more)| Step::Progress { by, back, more }),
        1 => (by(), 0_u64..4).prop_map(|(by, back)| Step::Fail { by, back }),
        2 => (by(), 0_u64..20).prop_map(|(by, back)| Step::Cancel { by, back }),
        10 => (0..12 * SECOND).prop_map(Step::Wait),
        1 => who().prop_map(Step::Revoke),
        1 => at().prop_map(Step::Take),
        1 => driven().prop_map(Step::Stop),
        3 => driven().prop_map(Step::Resume),
        3 => settings(true).prop_map(|settings| Step::Set(0, settings)),
        2 => settings(false).prop_map(|settings| Step::Set(1, settings)),
        1 => prop::collection::vec(who(), 0..2).prop_map(Step::Forbid),
        1 => Just(Step::Restart),
    ]
}
