//! Every vector within its limit passes as it is; every other one is brought down to it, or its message is refused.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use bytes::Bytes;
use proptest::prelude::*;

use super::*;
use crate::sample::{PL_CDR_BE, PL_CDR_LE, XCDR2};

const LIMITS: Speeds = Speeds { linear_mm_s: Some(500), angular_mrad_s: Some(1000) };

/// A message with these six numbers; with a header and a frame of so many bytes if it is stamped.
fn message(encoding: [u8; 2], frame: Option<usize>, numbers: [f64; 6]) -> Sample {
    let big = encoding == CDR_BE;
    let mut body = Vec::new();
    if let Some(frame) = frame {
        body.extend([7; FRAME_LENGTH]);
        let length = u32::try_from(frame).unwrap();
        body.extend(if big { length.to_be_bytes() } else { length.to_le_bytes() });
        body.extend(vec![b'f'; frame]);
        body.resize(body.len().next_multiple_of(DOUBLE), 0xee);
    }
    for number in numbers {
        body.extend(if big { number.to_be_bytes() } else { number.to_le_bytes() });
    }
    Sample::new(encoding, &body).unwrap()
}

fn layout(frame: Option<usize>) -> Layout {
    if frame.is_some() { Layout::TwistStamped } else { Layout::Twist }
}

/// The six numbers at the end of a message.
fn numbers(sample: &Sample) -> [f64; 6] {
    let body = sample.body();
    let start = body.len() - 2 * VECTOR;
    let order = Order::of(sample).unwrap();
    std::array::from_fn(|number| order.double(&body, start + number * DOUBLE).unwrap())
}

fn linear(sample: &Sample) -> [f64; 3] {
    numbers(sample)[..3].try_into().unwrap()
}

fn angular(sample: &Sample) -> [f64; 3] {
    numbers(sample)[3..].try_into().unwrap()
}

/// All that a message may be: both orders, without and with a header of any length.
fn shapes() -> impl Iterator<Item = ([u8; 2], Option<usize>)> {
    let frames = [None].into_iter().chain((0..20).map(Some));
    frames.flat_map(|frame| [(CDR_LE, frame), (CDR_BE, frame)])
}

#[test]
fn a_vector_that_is_too_long_is_brought_down_and_keeps_its_direction_and_all_else_stays() {
    for (encoding, frame) in shapes() {
        let fast = message(encoding, frame, [3.0, 0.0, 4.0, 0.1, 0.2, -0.3]);
        let slower = layout(frame).slow_down(&fast, LIMITS).unwrap().unwrap();
        let [x, y, z] = linear(&slower);
        assert!((x - 0.3).abs() < 1e-12 && y == 0.0 && (z - 0.4).abs() < 1e-12, "{frame:?} {x} {y} {z}");
        assert_eq!(angular(&slower), [0.1, 0.2, -0.3]);
        let place = fast.body().len() - 2 * VECTOR;
        assert_eq!(slower.wire()[..4 + place], fast.wire()[..4 + place], "header and frame");

        let both = message(encoding, frame, [-9.0, 0.0, 0.0, 0.0, 0.0, -9.0]);
        let slower = layout(frame).slow_down(&both, LIMITS).unwrap().unwrap();
        assert!((linear(&slower)[0] + 0.5).abs() < 1e-12 && (angular(&slower)[2] + 1.0).abs() < 1e-12);
    }
}

#[test]
fn a_message_within_its_limits_passes_as_it_is_also_at_the_limit_itself() {
    for (encoding, frame) in shapes() {
        for numbers in [[0.0; 6], [0.5, 0.0, -0.0, 0.0, -1.0, 0.0], [0.3, 0.4, 0.0, 0.6, 0.0, 0.8]] {
            assert_eq!(layout(frame).slow_down(&message(encoding, frame, numbers), LIMITS), Ok(None), "{numbers:?}");
        }
    }
}

#[test]
fn a_limit_of_zero_lets_no_motion_pass() {
    let none = Speeds { linear_mm_s: Some(0), angular_mrad_s: None };
    for speed in [1.0, -1.0, f64::MAX, f64::from_bits(1)] {
        let slower = Layout::Twist.slow_down(&message(CDR_LE, None, [0.0, speed, 0.0, 5.0, 0.0, 0.0]), none);
        assert_eq!(numbers(&slower.unwrap().unwrap()), [0.0, 0.0, 0.0, 5.0, 0.0, 0.0]);
    }
}

#[test]
fn a_number_that_is_none_is_refused_where_there_is_a_limit_and_only_there() {
    for bad in [f64::NAN, -f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for place in 0..6 {
            let mut numbers = [0.0; 6];
            numbers[place] = bad;
            let sample = message(CDR_LE, None, numbers);
            assert_eq!(Layout::Twist.slow_down(&sample, LIMITS), Err(Fault::NotFinite));
            let only_linear = Speeds { angular_mrad_s: None, ..LIMITS };
            assert_eq!(Layout::Twist.slow_down(&sample, only_linear).is_err(), place < 3);
        }
    }
}

#[test]
fn a_message_that_is_cut_off_or_too_long_or_in_another_encoding_is_refused_if_there_is_a_limit() {
    for (encoding, frame) in shapes() {
        let whole = message(encoding, frame, [0.0; 6]).body();
        let longer = [&whole[..], &[0]].concat();
        let cut = (0..whole.len()).map(|length| whole.slice(..length));
        for body in cut.chain([Bytes::from(longer)]) {
            let sample = Sample::new(encoding, &body).unwrap();
            assert_eq!(layout(frame).slow_down(&sample, LIMITS), Err(Fault::Layout), "{} bytes", body.len());
            assert_eq!(layout(frame).slow_down(&sample, Speeds::default()), Ok(None));
        }
        for other in [PL_CDR_BE, PL_CDR_LE].into_iter().chain(XCDR2) {
            let sample = Sample::new(other, &whole).unwrap();
            assert_eq!(layout(frame).slow_down(&sample, LIMITS), Err(Fault::Layout));
        }
    }
    let mut endless = message(CDR_LE, Some(4), [0.0; 6]).body().to_vec();
    endless[FRAME_LENGTH..FRAME].fill(0xff);
    let endless = Sample::new(CDR_LE, &endless).unwrap();
    assert_eq!(Layout::TwistStamped.slow_down(&endless, LIMITS), Err(Fault::Layout));
}

#[test]
fn only_types_that_ask_for_a_speed_have_a_layout() {
    assert_eq!(Layout::of("geometry_msgs/msg/Twist"), Some(Layout::Twist));
    assert_eq!(Layout::of("geometry_msgs/msg/TwistStamped"), Some(Layout::TwistStamped));
    for other in ["geometry_msgs/msg/Pose", "geometry_msgs/msg/TwistWithCovariance", "a/msg/Twist", ""] {
        assert_eq!(Layout::of(other), None);
    }
}

/// Any number, most of them of a size that robots know.
fn any_double() -> impl Strategy<Value = f64> {
    prop_oneof![any::<u64>().prop_map(f64::from_bits), -10.0..10.0_f64]
}

fn any_limit() -> impl Strategy<Value = Option<u64>> {
    proptest::option::of(prop_oneof![0..2000_u64, any::<u64>()])
}

/// Is a vector within its limit, by arithmetic that loses nothing of interest?
fn is_within(vector: [f64; 3], most: Option<u64>) -> bool {
    most.is_none_or(|most| vector[0].hypot(vector[1]).hypot(vector[2]) <= most as f64 / 1000.0)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn whatever_passes_is_within_its_limits_and_what_was_so_is_unchanged(
        values in proptest::array::uniform6(any_double()),
        frame in proptest::option::of(0_usize..40),
        big: bool,
        linear_mm_s in any_limit(),
        angular_mrad_s in any_limit(),
    ) {
        let limits = Speeds { linear_mm_s, angular_mrad_s };
        let sample = message(if big { CDR_BE } else { CDR_LE }, frame, values);
        let layout = layout(frame);
        match layout.slow_down(&sample, limits) {
            Err(fault) => {
                prop_assert_eq!(fault, Fault::NotFinite);
                prop_assert!(values.iter().any(|number| !number.is_finite()));
            }
            Ok(slower) => {
                let passes = slower.as_ref().unwrap_or(&sample);
                let (now, turned) = (linear(passes), angular(passes));
                prop_assert!(is_within(now, linear_mm_s) && is_within(turned, angular_mrad_s), "{now:?} {turned:?}");
                prop_assert_eq!(layout.slow_down(passes, limits), Ok(None), "a second time changes nothing");
                for (before, after) in values.iter().zip(numbers(passes)) {
                    // Numbers that are next to nothing have too few digits to be rounded well.
                    let is_slower = after.abs() <= before.abs() || after.abs() < 1e-290;
                    prop_assert!(is_slower || before.is_nan(), "{} became {}", before, after);
                    prop_assert!(after == 0.0 || before.is_nan() || after.signum() == before.signum());
                }
            }
        }
    }

    #[test]
    fn no_bytes_whatever_make_it_panic(
        encoding in 0_u8..4,
        body in proptest::collection::vec(any::<u8>(), 0..120),
        length in proptest::option::of(any::<u32>()),
        linear_mm_s in any_limit(),
        angular_mrad_s in any_limit(),
    ) {
        let mut body = body;
        if let (Some(length), Some(place)) = (length, body.get_mut(FRAME_LENGTH..FRAME)) {
            place.copy_from_slice(&length.to_le_bytes());
        }
        let sample = Sample::new([0, encoding], &body).unwrap();
        for layout in [Layout::Twist, Layout::TwistStamped] {
            if let Ok(Some(slower)) = layout.slow_down(&sample, Speeds { linear_mm_s, angular_mrad_s }) {
                prop_assert_eq!(slower.wire().len(), sample.wire().len());
            }
        }
    }
}
