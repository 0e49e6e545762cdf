//! A holder is kept to the limits of its grant.

use super::*;
use crate::speed::Speeds;
use ledger_contract::Limits;

/// A grant of Salma in this epoch with limits.
fn limited(epoch: u64, limits: Limits) -> Grant {
    Grant { limits, ..grant("Org1/Salma", epoch) }
}

/// A Twist with these speeds forwards and to the left.
fn twist(forwards: f64, turning: f64) -> Bytes {
    let numbers = [forwards, 0.0, 0.0, 0.0, 0.0, turning];
    [0, 1, 0, 0].into_iter().chain(numbers.into_iter().flat_map(f64::to_le_bytes)).collect()
}

/// The samples that pass of a message, and how many are slower than they came.
fn passed(gate: &mut Gate, user: &User, transaction: &Transaction) -> Result<(Vec<Bytes>, usize), Refused> {
    let delivered = Delivered { block_time: NOW, transaction: transaction.encoded(), certificate: &user.certificate };
    let passed = gate.pass(delivered, now())?;
    Ok((passed.samples.iter().map(|sample| sample.wire().clone()).collect(), passed.clamped))
}

/// Delivers a message of an age in microseconds.
fn aged(gate: &mut Gate, user: &User, seq: u64, age: u64) -> Result<usize, Refused> {
    gate.signed_since = Bound::default();
    deliver_at(gate, user, &user.set(3, seq, &TWIST), NOW - age)
}

#[test]
fn more_messages_than_the_grant_allows_do_not_pass_and_time_makes_room_again() {
    let network = Network::default();
    let slow = Limits { max_rate_mhz: Some(2_000), ..Limits::default() };
    let mut gate = network.gate(&service("exclusive"), &[limited(3, slow)]);
    let salma = &network.salma;
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 1, &[TWIST[0].clone(), TWIST[0].clone()])), Ok(2));
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 3, &TWIST)), Err(Refused::TooFast));
    let later = now_at(NOW + SECOND / 2);
    let next = salma.set(3, 3, &TWIST);
    let delivered = Delivered { block_time: NOW, transaction: next.encoded(), certificate: &salma.certificate };
    assert!(gate.pass(delivered, later).is_ok(), "a refused one uses up no number");
    assert!(!Refused::TooFast.may_pass_later());
}

#[test]
fn neither_a_new_grant_nor_a_new_standing_is_a_way_around_the_rate() {
    let network = Network::default();
    let slow = Limits { max_rate_mhz: Some(3_000), ..Limits::default() };
    let held = [limited(3, slow.clone())];
    let mut gate = network.gate(&service("exclusive"), &held);
    let salma = &network.salma;
    for seq in 1..=3 {
        assert_eq!(deliver(&mut gate, salma, &salma.set(3, seq, &TWIST)), Ok(1));
    }
    learn(&mut gate, &network, &service("exclusive"), &held);
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 4, &TWIST)), Err(Refused::TooFast));
    learn(&mut gate, &network, &service("exclusive"), &[limited(4, slow)]);
    assert_eq!(deliver(&mut gate, salma, &salma.set(4, 1, &TWIST)), Err(Refused::TooFast));
    let faster = Limits { max_rate_mhz: Some(9_000), ..Limits::default() };
    learn(&mut gate, &network, &service("exclusive"), &[limited(5, faster)]);
    assert_eq!(deliver(&mut gate, salma, &salma.set(5, 1, &TWIST)), Err(Refused::TooFast));
    let farhads = Grant { limits: Limits { max_rate_mhz: Some(1), ..Limits::default() }, ..grant("Org1/Farhad", 6) };
    learn(&mut gate, &network, &service("exclusive"), &[farhads]);
    let farhad = &network.farhad;
    assert_eq!(deliver(&mut gate, farhad, &farhad.set(6, 1, &TWIST)), Ok(1), "another holder has a rate of its own");
}

#[test]
fn a_holder_that_sends_very_much_or_at_any_limit_overflows_nothing() {
    let network = Network::default();
    let salma = &network.salma;
    let many = vec![Bytes::from_static(&[0, 1, 0, 0]); 1000];
    for (rate, passes) in [(0, false), (1, false), (999_999, false), (1_000_000, true), (u64::MAX, true)] {
        let limits = Limits { max_rate_mhz: Some(rate), max_age_ms: Some(u64::MAX), ..Limits::default() };
        let mut gate = network.gate(&service("exclusive"), &[limited(3, limits)]);
        assert_eq!(deliver(&mut gate, salma, &salma.set(3, 1, &many)).is_ok(), passes, "{rate}");
    }
}

#[test]
fn the_least_of_the_three_ages_counts() {
    let network = Network::default();
    for (services_ms, own_ms, grants_ms, least_ms) in [
        (1000, None, Some(200), 200),
        (100, None, Some(200), 100),
        (1000, Some(50), Some(200), 50),
        (300, None, None, 300),
    ] {
        let service = Service { max_age_ms: services_ms, ..service("exclusive") };
        let limits = Limits { max_age_ms: grants_ms, ..Limits::default() };
        let mut gate = network.gate_with(&service, &[limited(3, limits)], own_ms);
        let least = least_ms * 1000;
        assert_eq!(aged(&mut gate, &network.salma, 1, least + 1), Err(Refused::TooOld), "{least_ms} ms");
        assert_eq!(aged(&mut gate, &network.salma, 1, least), Ok(1), "{least_ms} ms");
    }
}

#[test]
fn a_twist_that_is_too_fast_passes_slower_and_is_counted_and_another_one_passes_as_it_is() {
    let network = Network::default();
    let limits = Limits { max_linear_mm_s: Some(500), max_angular_mrad_s: Some(1000), ..Limits::default() };
    let mut gate = network.gate(&service("exclusive"), &[limited(3, limits)]);
    let salma = &network.salma;
    let (slow, fast) = (twist(0.5, -1.0), twist(-2.0, 0.25));
    let (samples, clamped) = passed(&mut gate, salma, &salma.set(3, 1, &[slow.clone(), fast])).unwrap();
    assert_eq!((samples.len(), clamped), (2, 1));
    assert_eq!(samples[0], slow);
    let speed = |at: usize| f64::from_le_bytes(samples[1][at..at + 8].try_into().unwrap());
    assert!((-0.5..-0.499_999).contains(&speed(4)), "{}", speed(4));
    assert_eq!(speed(44), 0.25);
}

#[test]
fn a_maximum_of_the_robots_own_holds_with_and_without_a_grant_and_no_policy_raises_it() {
    let network = Network::default();
    let salma = &network.salma;
    let own = Speeds { linear_mm_s: Some(300), angular_mrad_s: None };
    let speed = |samples: &[Bytes]| f64::from_le_bytes(samples[0][4..12].try_into().unwrap());
    for (mode, limits, epoch) in [
        ("exclusive", Limits { max_linear_mm_s: Some(500), ..Limits::default() }, 3),
        ("exclusive", Limits::default(), 3),
        ("open", Limits::default(), 0),
    ] {
        let grants = if mode == "open" { vec![] } else { vec![limited(3, limits)] };
        let mut gate = network.gate(&Service { speeds: own, ..service(mode) }, &grants);
        let (samples, clamped) = passed(&mut gate, salma, &salma.set(epoch, 1, &[twist(2.0, 5.0)])).unwrap();
        assert_eq!(clamped, 1, "{mode}");
        assert!((0.299_999..=0.3).contains(&speed(&samples)), "{mode}: {}", speed(&samples));
    }
    // A stricter policy counts as before.
    let limits = Limits { max_linear_mm_s: Some(100), ..Limits::default() };
    let mut gate = network.gate(&Service { speeds: own, ..service("exclusive") }, &[limited(3, limits)]);
    let (samples, _) = passed(&mut gate, salma, &salma.set(3, 1, &[twist(2.0, 0.0)])).unwrap();
    assert!(speed(&samples) <= 0.1, "{}", speed(&samples));
}

#[test]
fn a_twist_with_a_limit_has_to_be_one_and_its_numbers_finite() {
    let network = Network::default();
    let salma = &network.salma;
    let limits = Limits { max_angular_mrad_s: Some(1000), ..Limits::default() };
    let mut gate = network.gate(&service("exclusive"), &[limited(3, limits.clone())]);
    let bad = salma.set(3, 1, &[twist(0.0, 0.0), twist(0.0, f64::NAN)]);
    assert_eq!(deliver(&mut gate, salma, &bad), Err(Refused::BadSpeed), "one of them is enough");
    let whole = twist(0.0, 0.0);
    let parameters: Bytes = [0, 3, 0, 0].into_iter().chain(whole[4..].iter().copied()).collect();
    for bad in [whole.slice(..51), TWIST[0].clone(), parameters] {
        assert_eq!(deliver(&mut gate, salma, &salma.set(3, 1, &[bad])), Err(Refused::BadPayload));
    }
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 1, &[whole])), Ok(1));
    let arm = Service { type_name: "arm_msgs/msg/Grip".into(), ..service("exclusive") };
    let mut gate = network.gate(&arm, &[limited(3, limits)]);
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 1, &TWIST)), Ok(1), "other types have no speed");
}

#[test]
fn where_a_policy_is_enough_a_holder_is_kept_to_its_limits_also_without_naming_its_grant() {
    let network = Network::default();
    let (salma, farhad) = (&network.salma, &network.farhad);
    let limits = Limits { max_linear_mm_s: Some(500), ..Limits::default() };
    let mut gate = network.gate(&service("open"), &[limited(3, limits)]);
    let fast = [twist(9.0, 0.0)];
    assert_eq!(passed(&mut gate, salma, &salma.set(0, 1, &fast)).unwrap().1, 1);
    assert_eq!(passed(&mut gate, farhad, &farhad.set(0, 1, &fast)).unwrap().1, 0);
}

#[test]
fn commands_without_a_limit_ask_for_finite_speeds_up_to_ten_thousand_and_feeds_carry_any() {
    let network = Network::default();
    let (salma, robot) = (&network.salma, &network.robot);
    for (mode, epoch) in [("exclusive", 3), ("open", 0)] {
        let held = if epoch == 0 { Vec::new() } else { vec![grant("Org1/Salma", epoch)] };
        let mut gate = network.gate(&service(mode), &held);
        for bad in [f64::NAN, f64::NEG_INFINITY, 1e300, -10_000.5] {
            for payload in [twist(bad, 0.0), twist(0.0, bad)] {
                let signed = salma.set(epoch, 1, &[twist(0.0, 0.0), payload]);
                assert_eq!(deliver(&mut gate, salma, &signed), Err(Refused::BadSpeed), "{mode} {bad}");
                assert!(!gate.is_moving(), "it is no sign of life of a driver");
            }
        }
        assert_eq!(deliver(&mut gate, salma, &salma.set(epoch, 1, &[twist(10_000.0, -10_000.0)])), Ok(1));
    }
    let feed = Service { direction: Direction::Feed, ..service("open") };
    let mut gate = network.gate(&feed, &[]);
    assert_eq!(deliver(&mut gate, robot, &robot.set(0, 1, &[twist(f64::NAN, 1e300)])), Ok(1));
    let arm = Service { type_name: "arm_msgs/msg/Grip".into(), ..service("exclusive") };
    let mut gate = network.gate(&arm, &[grant("Org1/Salma", 3)]);
    assert_eq!(
        deliver(&mut gate, salma, &salma.set(3, 1, &[twist(f64::NAN, 0.0)])),
        Ok(1),
        "other types pass unchanged"
    );
}

#[test]
fn a_command_in_an_encoding_that_the_gate_cannot_read_does_not_pass() {
    let network = Network::default();
    let salma = &network.salma;
    for type_name in [
        "geometry_msgs/msg/Twist",
        "geometry_msgs/msg/TwistStamped",
        "ackermann_msgs/msg/AckermannDrive",
        "ackermann_msgs/msg/AckermannDriveStamped",
    ] {
        let service = Service { type_name: type_name.into(), ..service("exclusive") };
        let mut gate = network.gate(&service, &[grant("Org1/Salma", 3)]);
        for encoding in [2, 3, 8, 9, 10, 11] {
            let payload: Bytes = [0, encoding, 0, 0].into_iter().chain([0; 64]).collect();
            assert_eq!(deliver(&mut gate, salma, &salma.set(3, 1, &[payload])), Err(Refused::BadPayload), "{encoding}");
        }
    }
}

proptest! {
    #[test]
    fn no_payload_whatever_panics_or_passes_above_a_limit(
        stamped: bool,
        payload in proptest::collection::vec(any::<u8>(), 0..100),
        encoding in 0_u8..5,
        linear: u64,
        angular in 0..5_000_u64,
    ) {
        let network = crate::fixture::shared();
        let type_name = if stamped { "geometry_msgs/msg/TwistStamped" } else { "geometry_msgs/msg/Twist" };
        let service = Service { type_name: type_name.into(), ..service("exclusive") };
        let limits =
            Limits { max_linear_mm_s: Some(linear), max_angular_mrad_s: Some(angular), ..Limits::default() };
        let mut gate = network.gate(&service, &[limited(3, limits)]);
        let whole = [0, encoding, 0, 0].into_iter().chain(payload.iter().copied().cycle().take(48)).collect::<Bytes>();
        for (seq, bytes) in (1..).zip([whole, Bytes::from(payload)]) {
            let signed = network.salma.set(3, seq, &[bytes]);
            if let Ok((samples, _)) = passed(&mut gate, &network.salma, &signed) {
                let (is_big, body) = (samples[0][1] == 0, &samples[0][samples[0].len() - 24..]);
                let numbers: [f64; 3] = std::array::from_fn(|at| {
                    let bytes = body[at * 8..at * 8 + 8].try_into().unwrap();
                    if is_big { f64::from_be_bytes(bytes) } else { f64::from_le_bytes(bytes) }
                });
                let turning = numbers[0].hypot(numbers[1]).hypot(numbers[2]);
                prop_assert!(turning <= angular as f64 / 1000.0, "{turning}");
            }
        }
    }
}
