//! Every vector within its limit passes as it is; every other one is brought down to it, or its message is refused.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use proptest::prelude::*;

use super::*;
use crate::sample::{PL_CDR_BE, PL_CDR_LE, XCDR2};

const TWIST: &str = "geometry_msgs/msg/Twist";
/// The encodings that can be read.
const PLAIN: [[u8; 2]; 4] = [CDR_LE, CDR_BE, XCDR2[0], XCDR2[1]];
/// The encodings that no middleware uses for these types.
const OTHERS: [[u8; 2]; 6] = [PL_CDR_BE, PL_CDR_LE, XCDR2[2], XCDR2[3], XCDR2[4], XCDR2[5]];
const LIMITS: Speeds = Speeds { linear_mm_s: Some(500), angular_mrad_s: Some(1000) };

/// A message with these six numbers; with a header and a frame of so many bytes if it is stamped.
fn message(encoding: [u8; 2], frame: Option<usize>, numbers: [f64; 6]) -> Sample {
    let big = is_big(encoding);
    let alignment = if XCDR2.contains(&encoding) { 4 } else { DOUBLE };
    let mut body = Vec::new();
    if let Some(frame) = frame {
        body.extend([7; FRAME_LENGTH]);
        let length = u32::try_from(frame).unwrap();
        body.extend(if big { length.to_be_bytes() } else { length.to_le_bytes() });
        body.extend(vec![b'f'; frame]);
        body.resize(body.len().next_multiple_of(alignment), 0xee);
    }
    for number in numbers {
        body.extend(if big { number.to_be_bytes() } else { number.to_le_bytes() });
    }
    Sample::new(encoding, &body).unwrap()
}

fn is_big(encoding: [u8; 2]) -> bool {
    encoding == CDR_BE || encoding == XCDR2[0]
}

fn layout(frame: Option<usize>) -> Layout {
    Layout::of(if frame.is_some() { "geometry_msgs/msg/TwistStamped" } else { TWIST }).unwrap()
}

fn twist() -> Layout {
    layout(None)
}

/// An Ackermann drive with these five numbers; with a header and a frame of so many bytes if it is stamped.
fn drive(encoding: [u8; 2], frame: Option<usize>, numbers: [f32; FLOATS]) -> (Layout, Sample) {
    let big = is_big(encoding);
    let mut body = Vec::new();
    if let Some(frame) = frame {
        body.extend([7; FRAME_LENGTH]);
        let length = u32::try_from(frame).unwrap();
        body.extend(if big { length.to_be_bytes() } else { length.to_le_bytes() });
        body.extend(vec![b'f'; frame]);
        body.resize(body.len().next_multiple_of(FLOAT), 0xee);
    }
    for number in numbers {
        body.extend(if big { number.to_be_bytes() } else { number.to_le_bytes() });
    }
    let name =
        if frame.is_some() { "ackermann_msgs/msg/AckermannDriveStamped" } else { "ackermann_msgs/msg/AckermannDrive" };
    (Layout::of(name).unwrap(), Sample::new(encoding, &body).unwrap())
}

/// The six numbers at the end of a message.
fn numbers(sample: &Sample) -> [f64; 6] {
    let body = sample.body();
    let start = body.len() - 2 * VECTOR;
    let order = Encoding::of(sample).unwrap().order;
    std::array::from_fn(|number| order.double(&body, start + number * DOUBLE).unwrap())
}

fn linear(sample: &Sample) -> [f64; 3] {
    numbers(sample)[..3].try_into().unwrap()
}

fn angular(sample: &Sample) -> [f64; 3] {
    numbers(sample)[3..].try_into().unwrap()
}

/// All that a message may be: both orders and alignments, without and with a header of any length.
fn shapes() -> impl Iterator<Item = ([u8; 2], Option<usize>)> {
    let frames = [None].into_iter().chain((0..20).map(Some));
    frames.flat_map(|frame| PLAIN.map(|encoding| (encoding, frame)))
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
        let slower = twist().slow_down(&message(CDR_LE, None, [0.0, speed, 0.0, 5.0, 0.0, 0.0]), none);
        assert_eq!(numbers(&slower.unwrap().unwrap()), [0.0, 0.0, 0.0, 5.0, 0.0, 0.0]);
    }
}

#[test]
fn a_number_that_is_not_finite_is_refused_in_every_encoding_with_and_without_a_limit() {
    let only_linear = Speeds { angular_mrad_s: None, ..LIMITS };
    for bad in [f64::NAN, -f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for (encoding, frame) in shapes() {
            for place in 0..6 {
                let mut numbers = [0.0; 6];
                numbers[place] = bad;
                let sample = message(encoding, frame, numbers);
                for limits in [Speeds::default(), only_linear, LIMITS] {
                    assert_eq!(layout(frame).slow_down(&sample, limits), Err(Fault::NotFinite));
                }
            }
            for place in 0..FLOATS {
                let mut numbers = [0.0; FLOATS];
                numbers[place] = bad as f32;
                let (layout, sample) = drive(encoding, frame, numbers);
                for limits in [Speeds::default(), LIMITS] {
                    assert_eq!(layout.slow_down(&sample, limits), Err(Fault::NotFinite));
                }
            }
        }
    }
}

#[test]
fn a_number_above_ten_thousand_is_refused_where_no_maximum_is_set_and_else_brought_down() {
    let only_linear = Speeds { angular_mrad_s: None, ..LIMITS };
    for (encoding, frame) in shapes() {
        for (number, passes) in [(NUMBER_MAX, true), (-NUMBER_MAX, true), (10_000.1, false), (-1e300, false)] {
            for place in 0..6 {
                let mut numbers = [0.0; 6];
                numbers[place] = number;
                let slowed = layout(frame).slow_down(&message(encoding, frame, numbers), Speeds::default());
                assert_eq!(slowed, if passes { Ok(None) } else { Err(Fault::TooLarge) }, "{number} at {place}");
                let slowed = layout(frame).slow_down(&message(encoding, frame, numbers), only_linear);
                assert_eq!(slowed.is_ok(), passes || place < 3, "{number} at {place}");
                assert!(layout(frame).slow_down(&message(encoding, frame, numbers), LIMITS).unwrap().is_some());
            }
        }
        for place in 0..FLOATS {
            let mut numbers = [0.0; FLOATS];
            numbers[place] = -10_001.0;
            let (layout, sample) = drive(encoding, frame, numbers);
            assert_eq!(layout.slow_down(&sample, Speeds::default()), Err(Fault::TooLarge));
            assert_eq!(layout.slow_down(&sample, LIMITS).is_ok(), place == SPEED);
        }
    }
}

#[test]
fn an_ackermann_drive_keeps_to_the_limit_on_linear_speeds_and_all_else_of_it_stays() {
    for (encoding, frame) in shapes() {
        for (speed, most) in [(0.5, 0.5), (-0.5, 0.5), (9.0, 0.5), (-9000.0, 0.5)] {
            let (layout, sample) = drive(encoding, frame, [0.3, -4.0, speed, 7.0, -8.0]);
            let slower = layout.slow_down(&sample, LIMITS).unwrap();
            assert_eq!(slower.is_some(), speed.abs() > most);
            let passes = slower.unwrap_or_else(|| sample.clone());
            let (before, after) = (sample.body(), passes.body());
            let (order, at) = (Encoding::of(&sample).unwrap().order, before.len() - FLOATS * FLOAT);
            let float = |number: usize| order.float(&after, at + number * FLOAT).unwrap();
            assert!(float(SPEED).abs() <= most && float(SPEED).abs() > most - 0.001, "{}", float(SPEED));
            assert_eq!(float(SPEED).signum(), speed.signum());
            assert_eq!([0, 1, 3, 4].map(float), [0.3, -4.0, 7.0, -8.0]);
            assert_eq!(before[..at], after[..at], "header and frame");
        }
    }
}

#[test]
fn a_message_that_is_too_long_or_in_another_encoding_is_refused_and_one_that_is_cut_off_where_there_is_a_limit() {
    for (encoding, frame) in shapes() {
        let (drive_layout, drive) = drive(encoding, frame, [0.0; FLOATS]);
        for (layout, whole) in
            [(layout(frame), message(encoding, frame, [0.0; 6]).body()), (drive_layout, drive.body())]
        {
            for behind in [1, 4, 8, 48] {
                let longer = [&whole[..], &vec![0; behind]].concat();
                let sample = Sample::new(encoding, &longer).unwrap();
                for limits in [Speeds::default(), LIMITS] {
                    assert_eq!(layout.slow_down(&sample, limits), Err(Fault::Layout), "{} bytes", longer.len());
                }
            }
            for body in (0..whole.len()).map(|length| whole.slice(..length)) {
                let sample = Sample::new(encoding, &body).unwrap();
                assert_eq!(layout.slow_down(&sample, LIMITS), Err(Fault::Layout), "{} bytes", body.len());
                assert_eq!(layout.slow_down(&sample, Speeds::default()), Ok(None));
            }
            for other in OTHERS {
                let sample = Sample::new(other, &whole).unwrap();
                for limits in [Speeds::default(), LIMITS] {
                    assert_eq!(layout.slow_down(&sample, limits), Err(Fault::Layout));
                }
            }
        }
    }
    let mut endless = message(CDR_LE, Some(4), [0.0; 6]).body().to_vec();
    endless[FRAME_LENGTH..FRAME].fill(0xff);
    let endless = Sample::new(CDR_LE, &endless).unwrap();
    assert_eq!(layout(Some(4)).slow_down(&endless, LIMITS), Err(Fault::Layout));
}

#[test]
fn only_types_that_ask_for_a_speed_have_a_layout() {
    assert!(Layout::of(TWIST).is_some());
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
        encoding in prop::sample::select(&PLAIN[..]),
        linear_mm_s in any_limit(),
        angular_mrad_s in any_limit(),
    ) {
        let limits = Speeds { linear_mm_s, angular_mrad_s };
        let sample = message(encoding, frame, values);
        let layout = layout(frame);
        match layout.slow_down(&sample, limits) {
            Err(fault) => {
                let is_wrong = |number: &f64| match fault {
                    Fault::NotFinite => !number.is_finite(),
                    Fault::TooLarge => number.abs() > NUMBER_MAX && (linear_mm_s.is_none() || angular_mrad_s.is_none()),
                    Fault::Layout => false,
                };
                prop_assert!(values.iter().any(is_wrong), "{:?}", fault);
            }
            Ok(slower) => {
                let passes = slower.as_ref().unwrap_or(&sample);
                let (now, turned) = (linear(passes), angular(passes));
                prop_assert!(is_within(now, linear_mm_s) && is_within(turned, angular_mrad_s), "{now:?} {turned:?}");
                prop_assert!(now.iter().chain(&turned).all(|number| number.is_finite()));
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
        encoding in 0_u8..12,
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
        let drives = [None, Some(0)].map(|frame| drive(CDR_LE, frame, [0.0; FLOATS]).0);
        for layout in [twist(), layout(Some(0))].into_iter().chain(drives) {
            if let Ok(Some(slower)) = layout.slow_down(&sample, Speeds { linear_mm_s, angular_mrad_s }) {
                prop_assert_eq!(slower.wire().len(), sample.wire().len());
            }
        }
    }
}
