//! How something grows with a number: the simplest law that the points keep.

use serde_json::{Value, json};

/// Points this close to their mean (root of the mean square, relative) count as flat: no machine is quieter.
const FLAT: f64 = 0.1;
/// Points farther than this from the best law keep none of them.
const UNCLEAR: f64 = 0.25;

/// The law behind the points.
#[derive(Clone, Debug)]
pub(crate) struct Law {
    growth: &'static str,
    /// The mean.
    mean: f64,
    /// The price of one more, by the straight line through all points.
    one_more: f64,
    /// The price of ten times as many, by the logarithmic curve.
    ten_times: f64,
    /// How far the points are from the law, relative to their mean.
    residual: f64,
}

/// The law of these points, of which there must be two at least. They are in ascending order of x, which is above 0.
pub(crate) fn law(points: &[(f64, f64)]) -> Law {
    let mean = points.iter().map(|point| point.1).sum::<f64>() / points.len() as f64;
    let (constant, _) = least_squares(points, |_| 0.0);
    let (linear, one_more) = least_squares(points, |x| x);
    let (logarithmic, ten_times) = least_squares(points, f64::log10);
    let (growth, residual) = match () {
        () if constant <= FLAT => ("flat", constant),
        // Two points lie on every curve.
        () if points.len() < 3 => ("unclear", constant),
        () if linear.min(logarithmic) > UNCLEAR => ("unclear", linear.min(logarithmic)),
        () if linear <= logarithmic => ("linear", linear),
        () => ("logarithmic", logarithmic),
    };
    Law { growth, mean, one_more, ten_times, residual }
}

/// Fits `y = a + b f(x)`: the root of the mean square of what is left, relative to the mean of y; and b.
fn least_squares(points: &[(f64, f64)], f: impl Fn(f64) -> f64) -> (f64, f64) {
    let count = points.len() as f64;
    let mean_f = points.iter().map(|(x, _)| f(*x)).sum::<f64>() / count;
    let mean_y = points.iter().map(|(_, y)| y).sum::<f64>() / count;
    let spread: f64 = points.iter().map(|(x, _)| (f(*x) - mean_f).powi(2)).sum();
    let together: f64 = points.iter().map(|(x, y)| (f(*x) - mean_f) * (y - mean_y)).sum();
    let slope = if spread > 0.0 { together / spread } else { 0.0 };
    let left: f64 = points.iter().map(|(x, y)| (y - mean_y - slope * (f(*x) - mean_f)).powi(2)).sum();
    ((left / count).sqrt() / mean_y.abs().max(f64::MIN_POSITIVE), slope)
}

impl Law {
    /// In words: `unit` is of the values, `one` what is counted.
    pub(crate) fn words(&self, unit: &str, one: &str) -> String {
        let Self { growth, mean, one_more, ten_times, residual } = self;
        let percent = residual * 100.0;
        match *growth {
            "flat" => format!("flat: {} {unit} (± {percent:.0} %)", short(*mean)),
            "linear" => format!("linear: {} {unit} for one more {one} (± {percent:.0} %)", signed(*one_more)),
            "logarithmic" => {
                format!("logarithmic: {} {unit} for ten times as many (± {percent:.0} %)", signed(*ten_times))
            }
            _ => format!(
                "unclear: around {} {unit}; a line through it says {} {unit} for one more {one}",
                short(*mean),
                signed(*one_more)
            ),
        }
    }

    /// For programs.
    pub(crate) fn json(&self) -> Value {
        let Self { growth, mean, one_more, ten_times, residual } = self;
        json!({
            "growth": growth, "mean": mean, "one_more": one_more, "ten_times": ten_times,
            "relative_residual": residual,
        })
    }
}

fn signed(value: f64) -> String {
    format!("{}{}", if value < 0.0 { "-" } else { "+" }, short(value.abs()))
}

/// Three digits that matter.
fn short(value: f64) -> String {
    let digits = if value > 0.0 { (2.0 - value.log10().floor()).clamp(0.0, 6.0) as usize } else { 0 };
    format!("{value:.digits$}")
}

/// The laws must be found in points of which they are known. There are no unit tests in a bench, so it begins with this.
pub(crate) fn self_check() {
    let with = |y: fn(f64) -> f64| [1.0, 10.0, 100.0, 1000.0].map(|x| (x, y(x)));
    assert_eq!(law(&with(|_| 5.0)).growth, "flat");
    assert_eq!(law(&with(|x| 5.0 + 0.01 * x)).growth, "linear");
    assert_eq!(law(&with(|x| 5.0 + 2.0 * x.log10())).growth, "logarithmic");
    assert!((law(&with(|x| 5.0 + 0.01 * x)).one_more - 0.01).abs() < 1e-9);
    assert_eq!(law(&[(1.0, 5.0), (10.0, 50.0), (100.0, 5.0), (1000.0, 50.0)]).growth, "unclear");
}
