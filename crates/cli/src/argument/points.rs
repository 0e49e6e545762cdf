//! Points of a task: `1,0;1,-2.5,1.570796`, in metres and radians. They are read digit by digit, so nothing is rounded.

use ledger_contract::{COORDINATE_UM_MAX, POINTS_MAX, Point, YAW_URAD_MAX};

/// Decimals of a metre or a radian that the ledger keeps.
const DECIMALS: usize = 6;
/// Millionths of one.
const ONE: u64 = 1_000_000;

/// The points of a task, in the order in which they are to be reached.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Points(pub(crate) Vec<Point>);

impl std::str::FromStr for Points {
    type Err = String;

    /// Points between semicolons. The chaincode has the same bounds; here they are told in metres and radians.
    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = "wanted x,y or x,y,yaw in metres and radians, a semicolon between points, such as 1,0;1,-2.5,1.57";
        if text.trim().is_empty() {
            return Err(format!("no points; {wanted}"));
        }
        let count = text.split(';').count();
        if count > POINTS_MAX {
            return Err(format!("{count} points; wanted at most {POINTS_MAX}"));
        }
        let read = |(index, text)| point(text).map_err(|fault| format!("point {}: {fault}; {wanted}", index + 1));
        Ok(Self(text.split(';').enumerate().map(read).collect::<Result<_, _>>()?))
    }
}

fn point(text: &str) -> Result<Point, String> {
    if text.trim().is_empty() {
        return Err("it is empty".to_owned());
    }
    let numbers: Vec<&str> = text.split(',').map(str::trim).collect();
    let (x, y, yaw) = match *numbers.as_slice() {
        [x, y] => (x, y, "0"),
        [x, y, yaw] => (x, y, yaw),
        ref others if others.len() < 2 => return Err("one number".to_owned()),
        ref others => return Err(format!("{} numbers", others.len())),
    };
    Ok(Point {
        x_um: bounded("x", x, COORDINATE_UM_MAX, "m")?,
        y_um: bounded("y", y, COORDINATE_UM_MAX, "m")?,
        yaw_urad: bounded("yaw", yaw, YAW_URAD_MAX, "rad")?,
    })
}

fn bounded(name: &str, text: &str, most: u64, unit: &str) -> Result<i64, String> {
    let number = millionths(text).map_err(|fault| format!("{name} {text:?} {fault}"))?;
    let most = i64::try_from(most).unwrap_or(i64::MAX);
    let number = number.filter(|number| (-most..=most).contains(number));
    number.ok_or_else(|| format!("{name} {text:?} is not within -{0} to {0} {unit}", decimal(most)))
}

/// The millionths of a decimal number; none if they are too many for any bound.
fn millionths(text: &str) -> Result<Option<i64>, String> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    if ["nan", "inf", "infinity"].iter().any(|word| digits.eq_ignore_ascii_case(word)) {
        return Err("is not finite".to_owned());
    }
    let (whole, part) = digits.split_once('.').unwrap_or((digits, ""));
    let is_number = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    if whole.len() + part.len() == 0 || !is_number(whole) || !is_number(part) {
        return Err("is not a decimal number such as -2.5".to_owned());
    }
    if part.len() > DECIMALS {
        return Err(format!("has {} decimals, but at most {DECIMALS} are possible", part.len()));
    }
    let size = format!("{whole}{part:0<DECIMALS$}").parse::<i64>().ok();
    Ok(size.map(|size| if negative { -size } else { size }))
}

/// Millionths as the decimal number that they stand for, such as `-2.5`.
pub(crate) fn decimal(millionths: i64) -> String {
    let size = millionths.unsigned_abs();
    let sign = if millionths < 0 { "-" } else { "" };
    let text = format!("{sign}{}.{:06}", size / ONE, size % ONE);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    fn read(text: &str) -> Vec<[i64; 3]> {
        let Points(points) = text.parse().unwrap();
        points.iter().map(|point| [point.x_um, point.y_um, point.yaw_urad]).collect()
    }

    #[test]
    fn points_are_two_or_three_exact_numbers() {
        assert_eq!(read("1,0"), [[1_000_000, 0, 0]]);
        assert_eq!(read(" 1 , -2.5 ; +.1,0.000001,-1.570796"), [[1_000_000, -2_500_000, 0], [100_000, 1, -1_570_796]]);
        // A floating-point number would be 1 less or more.
        assert_eq!(read("0.29,4.35,1.1;-0.000001,1.,0"), [[290_000, 4_350_000, 1_100_000], [-1, 1_000_000, 0]]);
        assert_eq!(read("1000000,-1000000,6.283186")[0], [1_000_000_000_000, -1_000_000_000_000, 6_283_186]);
    }

    #[test]
    fn slips_are_refused_with_the_point_and_the_wanted_form() {
        for (text, part) in [
            ("", "no points"),
            (" ", "no points"),
            (";", "point 1: it is empty"),
            ("1,0;", "point 2: it is empty"),
            ("1,0;;2,0", "point 2: it is empty"),
            ("1", "point 1: one number"),
            ("1,2;1,2,3,4", "point 2: 4 numbers"),
            ("1,", "point 1: y \"\" is not a decimal number"),
            ("NaN,0", "x \"NaN\" is not finite"),
            ("0,-inf", "y \"-inf\" is not finite"),
            ("0,0,Infinity", "yaw \"Infinity\" is not finite"),
            ("1e3,0", "x \"1e3\" is not a decimal number"),
            ("1.2.3,0", "not a decimal number"),
            ("--1,0", "not a decimal number"),
            ("-,0", "not a decimal number"),
            (".,0", "not a decimal number"),
            ("١,0", "not a decimal number"),
            ("0.1234567,0", "has 7 decimals, but at most 6 are possible"),
            ("1000000.000001,0", "is not within -1000000 to 1000000 m"),
            ("0,99999999999999999999", "is not within -1000000 to 1000000 m"),
            ("0,0,-6.3", "is not within -6.283186 to 6.283186 rad"),
        ] {
            let error = text.parse::<Points>().unwrap_err();
            assert!(error.contains(part) && error.contains("wanted x,y or x,y,yaw"), "{text:?}: {error}");
        }
    }

    #[test]
    fn a_task_has_1024_points_at_most() {
        let points = |count| vec!["1,0"; count].join(";").parse::<Points>();
        assert_eq!(points(1024).unwrap().0.len(), 1024);
        assert_eq!(points(1025).unwrap_err(), "1025 points; wanted at most 1024");
    }

    #[test]
    fn millionths_are_told_as_they_were_typed() {
        for text in ["0", "1", "-2.5", "0.000001", "-0.1", "1000000", "10"] {
            assert_eq!(decimal(millionths(text).unwrap().unwrap()), text);
        }
    }
}
