//! Spans of time: `30s`, `500ms`, `2m`, `1h`, `30d`.

/// A span in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Milliseconds(pub(crate) u64);

impl std::fmt::Display for Milliseconds {
    /// As it is typed, in the largest unit that fits.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let units = [(86_400_000, "d"), (3_600_000, "h"), (60_000, "m"), (1_000, "s")];
        match units.into_iter().find(|(factor, _)| self.0 > 0 && self.0.is_multiple_of(*factor)) {
            Some((factor, unit)) => write!(f, "{}{unit}", self.0 / factor),
            None => write!(f, "{}ms", self.0),
        }
    }
}

impl std::str::FromStr for Milliseconds {
    type Err = String;

    /// A whole number and a unit: `ms`, `s`, `m` (or `min`), `h`, `d`. Zero is refused: nothing lasts that long.
    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = "a whole number and a unit, such as 500ms, 30s, 2m, 1h or 30d";
        let digits = text.len() - text.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let (number, unit) = text.split_at(digits);
        let factor = match unit {
            "ms" => 1,
            "s" => 1_000,
            "m" | "min" => 60_000,
            "h" => 3_600_000,
            "d" => 86_400_000,
            unit if unit.starts_with('-') => return Err(format!("a span has no sign; wanted {wanted}")),
            "" if digits > 0 => return Err(format!("the unit is missing; wanted {wanted} (did you mean {number}s?)")),
            _ => return Err(format!("wanted {wanted}")),
        };
        let millis = number.parse::<u64>().ok().and_then(|count| count.checked_mul(factor));
        match millis {
            Some(0) => Err(format!("a span of zero; wanted {wanted}")),
            Some(millis) => Ok(Self(millis)),
            None => Err(format!("wanted {wanted}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_a_number_and_a_unit() {
        for (text, millis) in [
            ("500ms", 500),
            ("30s", 30_000),
            ("2m", 120_000),
            ("2min", 120_000),
            ("1h", 3_600_000),
            ("30d", 2_592_000_000),
        ] {
            assert_eq!(text.parse(), Ok(Milliseconds(millis)), "{text}");
            assert_eq!(Milliseconds(millis).to_string(), text.replace("min", "m"));
        }
    }

    #[test]
    fn other_spans_are_refused_with_the_wanted_form() {
        for text in ["", "s", "0s", "-1s", "1.5s", "3 s", "10", "1w", "99999999999999999999s", "18446744073709551615h"]
        {
            let error = text.parse::<Milliseconds>().err().unwrap_or_default();
            assert!(error.contains("30s"), "{text:?}: {error}");
        }
        assert!("10".parse::<Milliseconds>().is_err_and(|error| error.contains("did you mean 10s?")));
    }
}
