//! The speed that a command asks for: numbers that no robot can follow do not pass, and what is too fast is brought down to a limit.
//!
//! Known are `geometry_msgs/msg/Twist` and `TwistStamped`: two vectors of three `float64`, linear and angular. Known are also
//! `ackermann_msgs/msg/AckermannDrive` and `AckermannDriveStamped`: five `float32`, of which the third is the speed.
//!
//! ```text
//! Twist                  0                24               48
//!                        +----------------+----------------+
//!                        | linear x, y, z | angular x, y, z|
//!                        +----------------+----------------+
//! AckermannDrive         0           4           8       12            16     20
//!                        +-----------+-----------+-------+-------------+------+
//!                        | steering  | its       | speed | acceleration| jerk |
//!                        | angle     | velocity  |       |             |      |
//!                        +-----------+-----------+-------+-------------+------+
//! with a header          0             8            12           next multiple of the alignment
//!                        +-------------+------------+----------+----------------- - -
//!                        | sec, nanosec| length n   | n bytes  | as without it
//!                        +-------------+------------+----------+----------------- - -
//! ```
//!
//! The alignment of a `float64` is 8 in CDR and 4 in XCDR2. Nothing may be behind the last number: no middleware pads these types, and
//! a reader that places numbers elsewhere would find its numbers there.

use crate::sample::{CDR_BE, CDR_LE, Sample, XCDR2};

/// Bytes of a number of a vector.
const DOUBLE: usize = 8;
/// Bytes of a vector.
const VECTOR: usize = 3 * DOUBLE;
/// Bytes of a number of an Ackermann drive.
const FLOAT: usize = 4;
/// Numbers of an Ackermann drive, and which of them is the speed.
const FLOATS: usize = 5;
const SPEED: usize = 2;
/// Place of the length of `frame_id`.
const FRAME_LENGTH: usize = 8;
/// Place of `frame_id`.
const FRAME: usize = FRAME_LENGTH + 4;
/// Largest number that passes where no maximum is set: far above what robots do, far below what overflows on the way.
pub const NUMBER_MAX: f64 = 10_000.0;

/// The largest speeds that may pass; none = any up to [`NUMBER_MAX`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Speeds {
    /// Millimetres per second.
    pub linear_mm_s: Option<u64>,
    /// Thousandths of a radian per second.
    pub angular_mrad_s: Option<u64>,
}

impl Speeds {
    /// These and the others, each the smaller one.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let least = |one: Option<u64>, two: Option<u64>| one.into_iter().chain(two).min();
        Self {
            linear_mm_s: least(self.linear_mm_s, other.linear_mm_s),
            angular_mrad_s: least(self.angular_mrad_s, other.angular_mrad_s),
        }
    }

    /// Is any speed allowed?
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// A type of messages that ask for a speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    numbers: Numbers,
    is_stamped: bool,
}

/// The numbers of a type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Numbers {
    /// Two vectors of `float64`.
    Twist,
    /// Five `float32`.
    Ackermann,
}

/// The reason why a message cannot be brought down to a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It is not in an encoding of its type that can be read.
    Layout,
    /// A number is not finite.
    NotFinite,
    /// A number without a maximum is above [`NUMBER_MAX`].
    TooLarge,
}

impl Layout {
    /// The layout of a type by its name; none if messages of that type ask for no speed.
    pub fn of(type_name: &str) -> Option<Self> {
        let (numbers, is_stamped) = match type_name {
            "geometry_msgs/msg/Twist" => (Numbers::Twist, false),
            "geometry_msgs/msg/TwistStamped" => (Numbers::Twist, true),
            "ackermann_msgs/msg/AckermannDrive" => (Numbers::Ackermann, false),
            "ackermann_msgs/msg/AckermannDriveStamped" => (Numbers::Ackermann, true),
            _ => return None,
        };
        Some(Self { numbers, is_stamped })
    }

    /// Brings a message down to these speeds: a vector that is too long keeps its direction. None if it is slow enough as it is.
    ///
    /// Without a limit, a message that ends before its last number passes: no reader takes it for one of its type.
    ///
    /// # Errors
    /// [`Fault`].
    pub fn slow_down(self, sample: &Sample, most: Speeds) -> Result<Option<Sample>, Fault> {
        let body = sample.body();
        let encoding = Encoding::of(sample).ok_or(Fault::Layout)?;
        let Some(at) = self.place(&body, encoding) else {
            return if most.is_none() { Ok(None) } else { Err(Fault::Layout) };
        };
        if body.len() > at.saturating_add(self.numbers.bytes()) {
            return Err(Fault::Layout);
        }
        match self.numbers {
            Numbers::Twist => slower_twist(sample, &body, (at, encoding.order), most),
            Numbers::Ackermann => slower_drive(sample, &body, (at, encoding.order), most),
        }
    }

    /// The place of the first number; none if the body ends before its last one.
    fn place(self, body: &[u8], encoding: Encoding) -> Option<usize> {
        let at = if self.is_stamped {
            let length = usize::try_from(encoding.order.length(body, FRAME_LENGTH)?).ok()?;
            FRAME.checked_add(length)?.checked_next_multiple_of(self.numbers.alignment(encoding))?
        } else {
            0
        };
        (at.checked_add(self.numbers.bytes())? <= body.len()).then_some(at)
    }
}

impl Numbers {
    fn bytes(self) -> usize {
        match self {
            Self::Twist => 2 * VECTOR,
            Self::Ackermann => FLOATS * FLOAT,
        }
    }

    fn alignment(self, encoding: Encoding) -> usize {
        match self {
            Self::Twist => encoding.alignment,
            Self::Ackermann => FLOAT,
        }
    }
}

fn slower_twist(
    sample: &Sample,
    body: &[u8],
    (at, order): (usize, Order),
    most: Speeds,
) -> Result<Option<Sample>, Fault> {
    let mut slower = None;
    for (at, most) in [(at, most.linear_mm_s), (at + VECTOR, most.angular_mrad_s)] {
        let vector = order.vector(body, at).ok_or(Fault::Layout)?;
        check(&vector, most.is_some())?;
        if let Some(vector) = most.and_then(|most| brought_down(vector, most)) {
            let changed = slower.as_ref().unwrap_or(sample).with(at, &order.bytes(vector));
            slower = Some(changed.ok_or(Fault::Layout)?);
        }
    }
    Ok(slower)
}

/// The limit on linear speeds is the one of a drive. Its angles are no angular speed of the robot.
fn slower_drive(
    sample: &Sample,
    body: &[u8],
    (at, order): (usize, Order),
    most: Speeds,
) -> Result<Option<Sample>, Fault> {
    for number in 0..FLOATS {
        let value = order.float(body, at + number * FLOAT).ok_or(Fault::Layout)?;
        check(&[f64::from(value)], number == SPEED && most.linear_mm_s.is_some())?;
    }
    let Some(most) = most.linear_mm_s else { return Ok(None) };
    let at = at + SPEED * FLOAT;
    let speed = order.float(body, at).ok_or(Fault::Layout)?;
    let most = most as f64 / 1000.0;
    if f64::from(speed.abs()) <= most {
        return Ok(None);
    }
    // A little less, so that no rounding makes it more than the limit.
    let target = (most * (1.0 - 4.0 * f64::from(f32::EPSILON))) as f32;
    sample.with(at, &order.float_bytes(target.copysign(speed))).map(Some).ok_or(Fault::Layout)
}

/// May these numbers pass, or be brought down to a maximum if there is one?
fn check(numbers: &[f64], has_maximum: bool) -> Result<(), Fault> {
    if !numbers.iter().all(|number| number.is_finite()) {
        return Err(Fault::NotFinite);
    }
    if !has_maximum && numbers.iter().any(|number| number.abs() > NUMBER_MAX) {
        return Err(Fault::TooLarge);
    }
    Ok(())
}

/// The order of bytes, and the alignment of a `float64`, of an encoding that can be read: plain CDR and plain XCDR2.
#[derive(Clone, Copy, Debug)]
struct Encoding {
    order: Order,
    alignment: usize,
}

impl Encoding {
    fn of(sample: &Sample) -> Option<Self> {
        let [plain_be, plain_le, ..] = XCDR2;
        let (order, alignment) = match sample.representation_id() {
            CDR_BE => (Order::Big, DOUBLE),
            CDR_LE => (Order::Little, DOUBLE),
            id if id == plain_be => (Order::Big, DOUBLE / 2),
            id if id == plain_le => (Order::Little, DOUBLE / 2),
            _ => return None,
        };
        Some(Self { order, alignment })
    }
}

/// The order of the bytes of a number.
#[derive(Clone, Copy, Debug)]
enum Order {
    Big,
    Little,
}

impl Order {
    fn length(self, body: &[u8], at: usize) -> Option<u32> {
        let bytes = *body.get(at..)?.first_chunk()?;
        Some(match self {
            Self::Big => u32::from_be_bytes(bytes),
            Self::Little => u32::from_le_bytes(bytes),
        })
    }

    fn double(self, body: &[u8], at: usize) -> Option<f64> {
        let bytes = *body.get(at..)?.first_chunk()?;
        Some(match self {
            Self::Big => f64::from_be_bytes(bytes),
            Self::Little => f64::from_le_bytes(bytes),
        })
    }

    fn float(self, body: &[u8], at: usize) -> Option<f32> {
        let bytes = *body.get(at..)?.first_chunk()?;
        Some(match self {
            Self::Big => f32::from_be_bytes(bytes),
            Self::Little => f32::from_le_bytes(bytes),
        })
    }

    fn float_bytes(self, number: f32) -> [u8; FLOAT] {
        match self {
            Self::Big => number.to_be_bytes(),
            Self::Little => number.to_le_bytes(),
        }
    }

    fn vector(self, body: &[u8], at: usize) -> Option<[f64; 3]> {
        let double = |number: usize| self.double(body, at + number * DOUBLE);
        Some([double(0)?, double(1)?, double(2)?])
    }

    fn bytes(self, vector: [f64; 3]) -> Vec<u8> {
        let bytes = |number: f64| match self {
            Self::Big => number.to_be_bytes(),
            Self::Little => number.to_le_bytes(),
        };
        vector.into_iter().flat_map(bytes).collect()
    }
}

/// A finite vector that is longer than so many thousandths, brought down to that. None if it is short enough.
fn brought_down(vector: [f64; 3], most: u64) -> Option<[f64; 3]> {
    let most = most as f64 / 1000.0;
    if length(vector) <= most {
        return None;
    }
    let (_, direction) = split(vector);
    let unit = length(direction);
    // A little less, so that no rounding makes it more than the limit.
    let target = most * (1.0 - 4.0 * f64::EPSILON);
    Some(direction.map(|number| number / unit * target))
}

/// The length of a vector; infinite if no number is so large.
fn length(vector: [f64; 3]) -> f64 {
    let (largest, direction) = split(vector);
    largest * direction.iter().map(|number| number * number).sum::<f64>().sqrt()
}

/// The largest number of a vector, and the vector in units of that: no square of it overflows, and not all of them vanish.
fn split(vector: [f64; 3]) -> (f64, [f64; 3]) {
    let largest = vector.iter().fold(0.0, |largest: f64, number| largest.max(number.abs()));
    if largest > 0.0 { (largest, vector.map(|number| number / largest)) } else { (0.0, [0.0; 3]) }
}

#[cfg(test)]
mod tests;
