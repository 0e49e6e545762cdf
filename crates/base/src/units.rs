//! Spans of time and sizes in units that people read.

/// Units of a span, from the largest on, with their microseconds.
const UNITS: [(u64, &str); 5] =
    [(86_400_000_000, "days"), (3_600_000_000, "h"), (60_000_000, "min"), (1_000_000, "s"), (1_000, "ms")];

/// A span in the largest unit that keeps at least two of it, rounded down.
pub fn span(micros: u64) -> String {
    for (size, name) in UNITS {
        if micros >= 2 * size || (micros >= size && micros.is_multiple_of(size)) {
            let count = micros / size;
            return if count == 1 && name == "days" { "1 day".to_owned() } else { format!("{count} {name}") };
        }
    }
    format!("{micros} µs")
}

/// A size in the largest binary unit that keeps at least one of it; below ten of it with one decimal.
pub fn size(bytes: u64) -> String {
    const UNITS: [(u64, &str); 3] = [(30, "GiB"), (20, "MiB"), (10, "KiB")];
    for (shift, unit) in UNITS {
        if bytes >> shift >= 10 {
            return format!("{} {unit}", bytes >> shift);
        }
        if bytes >> shift > 0 {
            let tenths = (bytes >> (shift - 10)) * 10 / 1024;
            return format!("{}.{} {unit}", tenths / 10, tenths % 10);
        }
    }
    format!("{bytes} bytes")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_use_the_largest_unit_that_says_enough() {
        for (micros, wanted) in [
            (0, "0 µs"),
            (999, "999 µs"),
            (1_000, "1 ms"),
            (1_500, "1500 µs"),
            (10_000_000, "10 s"),
            (90_000_000, "90 s"),
            (60_000_000, "1 min"),
            (150_000_000, "2 min"),
            (86_400_000_000, "1 day"),
            (365 * 86_400_000_000, "365 days"),
        ] {
            assert_eq!(span(micros), wanted, "{micros}");
        }
    }

    #[test]
    fn sizes_use_the_largest_unit_of_which_there_is_one() {
        let printed = [999, 2048, 1_600_000, 16 << 20, 3 << 30, 20 << 30].map(size);
        assert_eq!(printed, ["999 bytes", "2.0 KiB", "1.5 MiB", "16 MiB", "3.0 GiB", "20 GiB"]);
    }
}
