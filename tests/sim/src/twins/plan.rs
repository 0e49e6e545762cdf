//! The decisions of a seed before anything happens.

use crate::clock::{MILLISECOND, SECOND};
use testkit::Random;

/// The numbers of voters that organisations have. Three cannot be strict; (2,2,1) and (3,3) bear no silence.
const SHAPES: [&[usize]; 10] = [
    &[1, 1, 1],
    &[1, 1, 1, 1],
    &[1, 1, 1, 1],
    &[1, 1, 1, 1, 1],
    &[1, 1, 1, 1, 1],
    &[2, 2, 1],
    &[2, 1, 1, 1],
    &[3, 3],
    &[1, 1, 1, 1, 1, 1, 1],
    &[2, 1, 1, 1, 1, 1],
];

/// The circumstances of one run. Times in microseconds.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The voters of each organisation.
    pub shape: Vec<usize>,
    /// The organisations that lie, by their place in the shape. More than one is more than anybody promises to bear.
    pub liars: Vec<usize>,
    /// Nobody runs twice, crashes or is cut off: liars only send what is forged, and withhold.
    pub calm: bool,
    /// In the end the liars are not gone: they go on with one story, and follow the rules.
    pub repents: bool,
    /// Liars leave control calls out while they lead.
    pub withholds: bool,
    /// Links between honest nodes of different parts are cut while the liars run twice.
    pub cuts: bool,
    /// Honest nodes crash.
    pub crashes: bool,
    /// Two robots are driven.
    pub robots: bool,
    /// When the liars begin.
    pub begins: u64,
    /// When they are gone.
    pub ends: u64,
    /// Average time between two changes of the parts.
    pub between_parts: u64,
    /// Average time between two forged messages.
    pub between_forged: u64,
    /// Longest way of a message.
    pub delay_max: u64,
    /// Out of a thousand messages, how many are lost.
    pub lose_per_mille: u64,
    /// Longest flush of a log.
    pub disk_max: u64,
    /// Average pause of a client.
    pub think: u64,
}

impl Plan {
    /// The plan of a seed.
    pub fn new(seed: u64) -> Self {
        let mut random = Random::new(seed, "twins");
        let shape = random.pick(&SHAPES).copied().unwrap_or(SHAPES[0]).to_vec();
        let calm = random.percent(25);
        let first = random.below(shape.len() as u64) as usize;
        let second = (shape.len() > 3 && !calm && random.percent(15)).then(|| (first + 1) % shape.len());
        let begins = 3 * SECOND;
        Self {
            liars: std::iter::once(first).chain(second).collect(),
            withholds: random.percent(if calm { 60 } else { 20 }),
            cuts: random.percent(70),
            crashes: !calm && random.percent(40),
            robots: random.percent(40),
            begins,
            ends: begins + if calm { 30 } else { random.between(10, 20) } * SECOND,
            repents: !calm && second.is_none() && random.percent(50),
            between_parts: random.between(500 * MILLISECOND, 5 * SECOND),
            between_forged: random.between(50, 500) * MILLISECOND,
            delay_max: random.between(500, 20 * MILLISECOND),
            lose_per_mille: if calm { 0 } else { random.below(3) * random.below(50) },
            disk_max: random.between(1, 20) * MILLISECOND,
            think: random.between(200, 900) * MILLISECOND,
            calm,
            shape,
        }
    }

    /// How many nodes vote.
    pub fn voters(&self) -> u64 {
        self.shape.iter().sum::<usize>() as u64
    }

    /// The organisation of a founding node, by its place in the shape: 1 and 2 of the first, 3 of the second, and so on.
    pub fn organisation_of(&self, node: u64) -> usize {
        let mut of = (0..self.shape.len()).flat_map(|place| std::iter::repeat_n(place, self.shape[place]));
        of.nth(node as usize - 1).unwrap_or_default()
    }

    /// Are there more honest voters than the largest organisation has? Then they can depose a leader.
    pub fn can_depose(&self) -> bool {
        let honest = |place: &usize| !self.lies(*place);
        let of = |place: usize| self.shape.get(place).copied().unwrap_or_default();
        let honest: usize = (0..self.shape.len()).filter(honest).map(of).sum();
        honest > self.shape.iter().copied().max().unwrap_or_default()
    }

    /// Would certificates be strict no more with a voter less of this organisation? Then it needs the others for that.
    pub fn ends_strict_without_one_of(&self, organisation: usize) -> bool {
        let without = |(place, voters): (usize, &usize)| voters - usize::from(place == organisation);
        let shape: Vec<usize> = self.shape.iter().enumerate().map(without).collect();
        let (voters, largest) = (shape.iter().sum::<usize>(), shape.iter().copied().max().unwrap_or_default());
        (voters + largest) / 2 + 1 >= voters
    }

    /// Does this organisation lie?
    pub fn lies(&self, organisation: usize) -> bool {
        self.liars.contains(&organisation)
    }
}
