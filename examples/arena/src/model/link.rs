//! The model of a link: delay, jitter and loss, as a TCP connection over Wi-Fi feels them.
//!
//! A connection delivers in order. A segment that is lost is sent again when the sender notices it, one round trip and three
//! segments later (RFC 5681, fast retransmit), and everything behind it waits. Loss is therefore a longer delay, for
//! more than the lost segment. Wi-Fi's own retransmissions are part of the jitter.

use crate::model::noise::Noise;
use serde::Serialize;

/// The time of three segments behind a lost one, at the rates of the experiment (seconds).
const NOTICED_AFTER: f64 = 0.06;

/// The setting of a link, one way. Both ways are alike.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Link {
    /// Delay of every segment (seconds).
    pub delay: f64,
    /// Mean of the exponentially distributed delay on top of it (seconds).
    pub jitter: f64,
    /// Share of the segments that are lost.
    pub loss: f64,
}

impl Link {
    /// A Wi-Fi with other users: some milliseconds, and one segment of a hundred lost.
    pub(crate) const WIFI: Self = Self { delay: 0.003, jitter: 0.004, loss: 0.01 };
    /// The paper's delays: a pose reaches the controller almost 300 ms later. It crosses two links.
    pub(crate) const PAPER: Self = Self { delay: 0.135, jitter: 0.01, loss: 0.001 };
}

/// One direction of a connection over a link.
#[derive(Clone, Debug)]
pub(crate) struct Direction {
    link: Link,
    noise: Noise,
    /// When the last segment is delivered: nothing overtakes it.
    delivered: f64,
}

impl Direction {
    /// A direction with a stream of random numbers of its own.
    pub(crate) fn new(link: Link, noise: Noise) -> Self {
        Self { link, noise, delivered: 0.0 }
    }

    /// When a segment that is sent now is delivered.
    pub(crate) fn deliver(&mut self, now: f64) -> f64 {
        let once = |noise: &mut Noise, link: Link| link.delay + noise.exponential(link.jitter);
        let mut at = now + once(&mut self.noise, self.link);
        // A segment that is sent again may be lost again.
        while self.noise.uniform() < self.link.loss.min(0.5) {
            at += 2.0 * self.link.delay + NOTICED_AFTER + once(&mut self.noise, self.link);
        }
        self.delivered = self.delivered.max(at);
        self.delivered
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn delays(link: Link, count: u32) -> Vec<f64> {
        let mut direction = Direction::new(link, Noise::new(5));
        (0..count).map(f64::from).map(|now| direction.deliver(now) - now).collect()
    }

    #[test]
    fn nothing_overtakes_what_was_sent_before() {
        let mut direction = Direction::new(Link { delay: 0.01, jitter: 0.05, loss: 0.1 }, Noise::new(1));
        let times: Vec<_> = (0..1000).map(|number| direction.deliver(f64::from(number) * 0.008)).collect();
        assert!(times.windows(2).all(|pair| pair[0] <= pair[1]));
    }

    #[test]
    fn every_segment_takes_the_delay_and_the_mean_jitter_on_top() {
        let delays = delays(Link { delay: 0.1, jitter: 0.02, loss: 0.0 }, 5000);
        assert!(delays.iter().all(|delay| *delay >= 0.1 - 1e-9));
        let mean = delays.iter().sum::<f64>() / 5000.0;
        assert!((mean - 0.12).abs() < 0.002, "{mean}");
    }

    #[test]
    fn a_lost_segment_takes_a_round_trip_more_and_as_many_are_lost_as_the_link_says() {
        let late =
            delays(Link { delay: 0.1, jitter: 0.0, loss: 0.05 }, 10_000).into_iter().filter(|delay| *delay > 0.35);
        let late = late.count();
        assert!((350..650).contains(&late), "{late} of 10000");
    }

    #[test]
    fn over_two_links_of_the_paper_a_pose_takes_almost_300_ms() {
        let two = 2.0 * (Link::PAPER.delay + Link::PAPER.jitter);
        assert!((0.28..0.3).contains(&two), "{two}");
    }
}
