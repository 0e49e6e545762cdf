//! Windows of time in which a policy permits: `08:00-18:00 Mon-Fri +02:00`.
//!
//! Offsets are fixed. Data of time zones differs between versions, and would divide nodes.

/// The form of a window.
pub(super) const WANTED: &str = "HH:MM-HH:MM [DAYS] OFFSET, e.g. 08:00-18:00 Mon-Fri +02:00 or 22:00-06:00 Mon,Sat Z";

const DAYS: [&str; 7] = ["Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun"];
const MINUTE_MS: i64 = 60_000;
const DAY_MS: i64 = 24 * 60 * MINUTE_MS;
/// The UNIX epoch was a Thursday.
const DAY_OF_EPOCH: i64 = 3;
/// Largest offset from UTC: what ISO 8601 allows is less than a day, what exists is at most this (milliseconds).
const OFFSET_MS_MAX: i64 = 14 * 60 * MINUTE_MS;

/// A window: from a time of the day on, on some days of the week.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    /// Start and end since midnight (milliseconds); the end may lie on the next day.
    from: i64,
    to: i64,
    /// The days on which it starts, Monday first.
    days: [bool; 7],
    /// The offset from UTC (milliseconds).
    offset: i64,
}

/// The state of a window at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    Closed,
    /// Open until then (milliseconds since the UNIX epoch); for ever without an end.
    Open(Option<i64>),
}

impl Window {
    /// Reads a window; none if the text is no window.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let parts: Vec<&str> = text.split(' ').collect();
        let (hours, days, offset) = match *parts.as_slice() {
            [hours, offset] => (hours, [true; 7], offset),
            [hours, days, offset] => (hours, days_of(days)?, offset),
            _ => return None,
        };
        let (from, to) = hours.split_once('-')?;
        let (from, to) = (time_of_day(from)?, time_of_day(to)?);
        if from == to || from >= DAY_MS {
            return None;
        }
        let to = if to > from { to } else { to + DAY_MS };
        Some(Self { from, to, days, offset: offset_of(offset)? })
    }

    /// Is it open at this time (milliseconds since the UNIX epoch), and until when?
    pub(super) fn at(&self, time_ms: i64) -> State {
        let local = time_ms.saturating_add(self.offset);
        let today = local.div_euclid(DAY_MS);
        // What starts today, or started yesterday and goes on after midnight.
        let open = [today, today - 1]
            .into_iter()
            .filter_map(|day| self.on(day))
            .find(|(from, to)| *from <= local && local < *to);
        let Some((_, mut end)) = open else { return State::Closed };
        // A window that begins where the last one ends goes on with it; after a week of them it has no end.
        for day in today..=today + 8 {
            if let Some((from, to)) = self.on(day)
                && from <= end
            {
                end = end.max(to);
            }
        }
        let lasts_for_ever = end > local + 7 * DAY_MS;
        State::Open((!lasts_for_ever).then_some(end - self.offset))
    }

    /// Start and end of the window that starts on that day, in local time.
    fn on(&self, day: i64) -> Option<(i64, i64)> {
        let weekday = usize::try_from((day + DAY_OF_EPOCH).rem_euclid(7)).ok()?;
        let is_on = self.days.get(weekday).copied().unwrap_or(false);
        is_on.then_some((day * DAY_MS + self.from, day * DAY_MS + self.to))
    }
}

/// Two digits.
fn two(text: &str) -> Option<i64> {
    (text.len() == 2 && text.bytes().all(|byte| byte.is_ascii_digit())).then(|| text.parse().ok()).flatten()
}

/// `HH:MM`, to 24:00.
fn time_of_day(text: &str) -> Option<i64> {
    let (hours, minutes) = text.split_once(':')?;
    let time = (two(hours)? * 60 + two(minutes).filter(|minutes| *minutes < 60)?) * MINUTE_MS;
    (time <= DAY_MS).then_some(time)
}

/// `Z`, `+HH:MM` or `-HH:MM`.
fn offset_of(text: &str) -> Option<i64> {
    if text == "Z" {
        return Some(0);
    }
    let (sign, rest) =
        text.strip_prefix('+').map(|rest| (1, rest)).or(text.strip_prefix('-').map(|rest| (-1, rest)))?;
    time_of_day(rest).filter(|offset| *offset <= OFFSET_MS_MAX).map(|offset| sign * offset)
}

/// `Mon`, `Mon-Fri`, `Mon,Wed-Fri`.
fn days_of(text: &str) -> Option<[bool; 7]> {
    let day = |name: &str| DAYS.iter().position(|day| *day == name);
    let mut days = [false; 7];
    for part in text.split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let (mut at, last) = (day(first)?, day(last)?);
        // `Sat-Mon` goes over the end of the week.
        loop {
            *days.get_mut(at)? = true;
            if at == last {
                break;
            }
            at = (at + 1) % 7;
        }
    }
    Some(days)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// 2026-11-23, a Monday, 00:00 UTC.
    const MONDAY: i64 = 1_795_392_000_000;
    const HOUR: i64 = 60 * MINUTE_MS;

    fn at(window: &str, time: i64) -> State {
        Window::parse(window).unwrap().at(time)
    }

    #[test]
    fn a_window_opens_and_closes_by_its_own_offset() {
        let work = "08:00-18:00 Mon-Fri +02:00";
        assert_eq!(at(work, MONDAY + 6 * HOUR - 1), State::Closed);
        assert_eq!(at(work, MONDAY + 6 * HOUR), State::Open(Some(MONDAY + 16 * HOUR)));
        assert_eq!(at(work, MONDAY + 16 * HOUR - 1), State::Open(Some(MONDAY + 16 * HOUR)));
        assert_eq!(at(work, MONDAY + 16 * HOUR), State::Closed);
        assert_eq!(at(work, MONDAY - 24 * HOUR + 10 * HOUR), State::Closed, "a Sunday");
    }

    #[test]
    fn a_window_over_midnight_belongs_to_the_day_on_which_it_starts() {
        let night = "22:00-06:00 Mon Z";
        assert_eq!(at(night, MONDAY + 3 * HOUR), State::Closed);
        assert_eq!(at(night, MONDAY + 27 * HOUR), State::Open(Some(MONDAY + 30 * HOUR)));
        assert_eq!(at(night, MONDAY + 51 * HOUR), State::Closed);
    }

    #[test]
    fn windows_that_meet_are_one_and_those_of_every_day_have_no_end() {
        assert_eq!(at("00:00-24:00 Mon-Tue Z", MONDAY + HOUR), State::Open(Some(MONDAY + 48 * HOUR)));
        assert_eq!(at("00:00-24:00 Sat-Mon Z", MONDAY - HOUR), State::Open(Some(MONDAY + 24 * HOUR)));
        assert_eq!(at("00:00-24:00 -03:30", MONDAY), State::Open(None));
        assert_eq!(at("00:00-23:59 Z", MONDAY), State::Open(Some(MONDAY + 24 * HOUR - MINUTE_MS)));
    }

    #[test]
    fn what_is_no_window_is_not_read() {
        for bad in [
            "",
            "08:00-18:00",
            "8:00-18:00 Z",
            "08:00-08:00 Z",
            "08:60-18:00 Z",
            "24:00-06:00 Z",
            "08:00-24:01 Z",
            "08:00-18:00 Mo Z",
            "08:00-18:00 Mon-Fri",
            "08:00-18:00 Mon- Z",
            "08:00-18:00 +14:01",
            "08:00-18:00 02:00",
            "08:00-18:00  Z",
            "08:00–18:00 Z",
        ] {
            assert_eq!(Window::parse(bad), None, "{bad}");
        }
    }

    #[test]
    fn any_time_has_a_state() {
        for time in [i64::MIN, i64::MIN + DAY_MS * 20, i64::MAX - DAY_MS * 20, i64::MAX / 2] {
            let _ = at("22:00-06:00 Mon-Fri +02:00", time.clamp(i64::MIN / 4, i64::MAX / 4));
        }
    }
}
