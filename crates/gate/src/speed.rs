//! The speed that a command asks for, and how it is brought down to a limit.
//!
//! Known are `geometry_msgs/msg/Twist` and `TwistStamped`: two vectors of three `float64`, linear and angular.
//!
//! ```text
//! Twist         0                24               48
//!               +----------------+----------------+
//!               | linear x, y, z | angular x, y, z|
//!               +----------------+----------------+
//! TwistStamped  0             8            12           next multiple of 8
//!               +-------------+------------+----------+----------------- - -
//!               | sec, nanosec| length n   | n bytes  | as a Twist
//!               +-------------+------------+----------+----------------- - -
//! ```

use crate::sample::{CDR_BE, CDR_LE, Sample};

/// Bytes of a number of a vector.
const DOUBLE: usize = 8;
/// Bytes of a vector.
const VECTOR: usize = 3 * DOUBLE;
/// Place of the length of `frame_id`.
const FRAME_LENGTH: usize = 8;
/// Place of `frame_id`.
const FRAME: usize = FRAME_LENGTH + 4;

/// The largest speeds that may pass; none = any.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Speeds {
    /// Millimetres per second.
    pub linear_mm_s: Option<u64>,
    /// Thousandths of a radian per second.
    pub angular_mrad_s: Option<u64>,
}

/// A type of messages that ask for a speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// `geometry_msgs/msg/Twist`.
    Twist,
    /// `geometry_msgs/msg/TwistStamped`.
    TwistStamped,
}

/// The reason why a message cannot be brought down to a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It is no plain CDR of its type.
    Layout,
    /// A number of a vector with a limit is no finite number.
    NotFinite,
}

impl Layout {
    /// The layout of a type by its name; none if messages of that type ask for no speed.
    pub fn of(type_name: &str) -> Option<Self> {
        match type_name {
            "geometry_msgs/msg/Twist" => Some(Self::Twist),
            "geometry_msgs/msg/TwistStamped" => Some(Self::TwistStamped),
            _ => None,
        }
    }

    /// Brings a message down to these speeds: a vector that is too long keeps its direction. None if it is slow enough as it is.
    ///
    /// # Errors
    /// [`Fault`], where there is a limit. Without one every message is slow enough.
    pub fn slow_down(self, sample: &Sample, most: Speeds) -> Result<Option<Sample>, Fault> {
        if most == Speeds::default() {
            return Ok(None);
        }
        let body = sample.body();
        let order = Order::of(sample).ok_or(Fault::Layout)?;
        let linear = self.vectors(&body, order).ok_or(Fault::Layout)?;
        let mut slower = None;
        for (at, most) in [(linear, most.linear_mm_s), (linear + VECTOR, most.angular_mrad_s)] {
            let Some(most) = most else { continue };
            let vector = order.vector(&body, at).ok_or(Fault::Layout)?;
            if let Some(vector) = brought_down(vector, most)? {
                let changed = slower.as_ref().unwrap_or(sample).with(at, &order.bytes(vector));
                slower = Some(changed.ok_or(Fault::Layout)?);
            }
        }
        Ok(slower)
    }

    /// The place of the first vector in a body of exactly the right length.
    fn vectors(self, body: &[u8], order: Order) -> Option<usize> {
        let at = match self {
            Self::Twist => 0,
            Self::TwistStamped => {
                let length = usize::try_from(order.length(body, FRAME_LENGTH)?).ok()?;
                FRAME.checked_add(length)?.checked_next_multiple_of(DOUBLE)?
            }
        };
        (at.checked_add(2 * VECTOR)? == body.len()).then_some(at)
    }
}

/// The order of the bytes of a number.
#[derive(Clone, Copy, Debug)]
enum Order {
    Big,
    Little,
}

impl Order {
    /// That of a sample in plain CDR.
    fn of(sample: &Sample) -> Option<Self> {
        match sample.representation_id() {
            CDR_BE => Some(Self::Big),
            CDR_LE => Some(Self::Little),
            _ => None,
        }
    }

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

/// A vector that is longer than so many thousandths, brought down to that. None if it is short enough.
fn brought_down(vector: [f64; 3], most: u64) -> Result<Option<[f64; 3]>, Fault> {
    if !vector.iter().all(|number| number.is_finite()) {
        return Err(Fault::NotFinite);
    }
    let most = most as f64 / 1000.0;
    if length(vector) <= most {
        return Ok(None);
    }
    let (_, direction) = split(vector);
    let unit = length(direction);
    // A little less, so that no rounding makes it more than the limit.
    let target = most * (1.0 - 4.0 * f64::EPSILON);
    Ok(Some(direction.map(|number| number / unit * target)))
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
