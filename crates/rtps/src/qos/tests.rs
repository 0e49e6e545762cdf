use super::*;

fn qos(change: impl FnOnce(&mut Qos)) -> Qos {
    let mut qos = Qos::default();
    change(&mut qos);
    qos
}

/// Offered, requested, what does not fit.
fn check(offered: impl FnOnce(&mut Qos), requested: impl FnOnce(&mut Qos), expected: &[Policy]) {
    let (offered, requested) = (qos(offered), qos(requested));
    assert_eq!(offered.mismatches(&requested), expected, "{offered:?} {requested:?}");
}

fn nothing(_: &mut Qos) {}

#[test]
fn a_reader_may_request_at_most_what_its_writer_offers() {
    check(nothing, nothing, &[]);
    for (offered, requested, fits) in [
        (Reliability::Reliable, Reliability::BestEffort, true),
        (Reliability::Reliable, Reliability::Reliable, true),
        (Reliability::BestEffort, Reliability::Reliable, false),
    ] {
        let expected = if fits { &[][..] } else { &[Policy::Reliability] };
        check(|q| q.reliability = offered, |q| q.reliability = requested, expected);
    }
    let durabilities =
        [Durability::Volatile, Durability::TransientLocal, Durability::Transient, Durability::Persistent];
    for (offered_rank, offered) in durabilities.into_iter().enumerate() {
        for (requested_rank, requested) in durabilities.into_iter().enumerate() {
            let expected = if offered_rank >= requested_rank { &[][..] } else { &[Policy::Durability] };
            check(|q| q.durability = offered, |q| q.durability = requested, expected);
        }
    }
}

#[test]
fn a_writer_may_not_promise_longer_times_than_its_reader_requests() {
    let (short, long) = (Ticks::from_micros(1), Ticks::from_micros(2));
    for (offered, requested, fits) in [
        (short, short, true),
        (short, long, true),
        (long, short, false),
        (short, Ticks::INFINITE, true),
        (Ticks::INFINITE, long, false),
    ] {
        let unless = |policy| if fits { vec![] } else { vec![policy] };
        check(|q| q.deadline = offered, |q| q.deadline = requested, &unless(Policy::Deadline));
        check(|q| q.latency_budget = offered, |q| q.latency_budget = requested, &unless(Policy::LatencyBudget));
        check(|q| q.liveliness_lease = offered, |q| q.liveliness_lease = requested, &unless(Policy::Liveliness));
        check(|q| q.lifespan = offered, |q| q.lifespan = requested, &[]);
    }
}

#[test]
fn liveliness_by_topic_fits_all_kinds_and_automatic_fits_only_itself() {
    let kinds = [LivelinessKind::Automatic, LivelinessKind::ManualByParticipant, LivelinessKind::ManualByTopic];
    for (offered_rank, offered) in kinds.into_iter().enumerate() {
        for (requested_rank, requested) in kinds.into_iter().enumerate() {
            let expected = if offered_rank >= requested_rank { &[][..] } else { &[Policy::Liveliness] };
            check(|q| q.liveliness = offered, |q| q.liveliness = requested, expected);
        }
    }
}

#[test]
fn ownership_is_the_same_on_both_sides() {
    check(|q| q.ownership = Ownership::Exclusive, |q| q.ownership = Ownership::Exclusive, &[]);
    check(nothing, |q| q.ownership = Ownership::Exclusive, &[Policy::Ownership]);
    check(|q| q.ownership = Ownership::Exclusive, nothing, &[Policy::Ownership]);
}

#[test]
fn the_first_representation_of_a_writer_is_one_of_its_reader_and_xcdr1_where_none_is_named() {
    use Representation as R;
    for (offered, requested, fits) in [
        (&[][..], &[][..], true),
        (&[], &[R::XCDR1], true),
        (&[R::XCDR1], &[], true),
        (&[R::XCDR2], &[], false),
        (&[], &[R::XCDR2], false),
        (&[R::XCDR2], &[R::XCDR1, R::XCDR2], true),
        (&[R::XCDR2, R::XCDR1], &[R::XCDR1], false),
        (&[R::XML], &[R::XCDR1, R::XCDR2], false),
    ] {
        let expected = if fits { &[][..] } else { &[Policy::Representation] };
        check(|q| q.representations = offered.to_vec(), |q| q.representations = requested.to_vec(), expected);
    }
}

#[test]
fn everything_that_does_not_fit_is_named() {
    check(
        |q| q.partitions = vec!["a".to_owned()],
        |q| {
            q.reliability = Reliability::Reliable;
            q.durability = Durability::TransientLocal;
        },
        &[Policy::Reliability, Policy::Durability, Policy::Partition],
    );
    check(|q| q.history = History::KeepAll, |q| q.history = History::KeepLast(5), &[]);
}
