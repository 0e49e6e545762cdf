//! Pictures of the runs, as SVG. Letters are text: the viewer's font draws them.

mod frame;
mod over_time;
mod page;
mod rates;
mod trajectory;

pub(crate) use page::{Facts, page};

use crate::model::claims::Runs;
use crate::model::record::Record;
use frame::{Area, Fault};
use plotters::prelude::{DrawingBackend, IntoDrawingArea, SVGBackend, WHITE};
use serde::Serialize;

/// Latency at one frequency.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Rate {
    /// The frequency (Hz).
    pub hz: f64,
    /// Messages that were published.
    pub published: usize,
    /// Messages that the robot received.
    pub received: usize,
    /// Half of them took less (milliseconds).
    pub p50_ms: f64,
    /// The 99th percentile, milliseconds.
    pub p99_ms: f64,
}

/// A picture.
#[derive(Clone, Debug)]
pub(crate) struct Picture {
    /// The name of its files, without an ending.
    pub name: &'static str,
    /// Its contents, in words.
    pub caption: &'static str,
    /// The picture as SVG.
    pub svg: String,
}

/// The pictures, by name.
#[derive(Clone, Copy)]
enum Kind {
    Overview,
    Trajectory,
    Orientation,
    Frequency,
    Latency,
    Rates,
}

impl Kind {
    const ALL: [Self; 6] =
        [Self::Overview, Self::Trajectory, Self::Orientation, Self::Frequency, Self::Latency, Self::Rates];

    fn name(self) -> &'static str {
        match self {
            Self::Overview => "overview",
            Self::Trajectory => "trajectory",
            Self::Orientation => "orientation",
            Self::Frequency => "frequency",
            Self::Latency => "latency",
            Self::Rates => "latency-frequency",
        }
    }

    fn caption(self) -> &'static str {
        match self {
            Self::Overview => {
                "The way of the robot, and its yaw, with access control and without. A hollow waypoint was not reached."
            }
            Self::Trajectory => {
                "The way of the robot, with a mark of its heading every second; references are dashed, and a hollow waypoint was not reached."
            }
            Self::Orientation => "Yaw over time. Colours show who may drive; letters, when a waypoint was reached.",
            Self::Frequency => "Commands a second that the robot receives while both users command at 50 Hz.",
            Self::Latency => {
                "From the publication of a command to the robot, ROS 2 to ROS 2: median and slowest of each half second."
            }
            Self::Rates => {
                "Latency against frequency, beside the figures of Fabric and of the paper. Ours is ROS 2 to ROS 2; Fabric's is commit alone."
            }
        }
    }

    /// Width and height in the units of the drawing: twice those of the page.
    fn size(self) -> (u32, u32) {
        match self {
            Self::Overview => (2000, 1560),
            Self::Trajectory => (2000, 2080),
            Self::Orientation => (2000, 1720),
            Self::Frequency | Self::Latency => (2000, 900),
            Self::Rates => (2000, 1100),
        }
    }

    fn draw<B: DrawingBackend>(self, area: &Area<B>, runs: &Runs<Record>, rates: &[Rate]) -> Result<(), Fault> {
        match self {
            Self::Overview => overview(area, runs),
            Self::Trajectory => trajectory::four(area, runs),
            Self::Orientation => over_time::yaws(area, runs),
            Self::Frequency => over_time::frequency(area, runs),
            Self::Latency => over_time::latency(area, runs),
            Self::Rates => rates::draw(area, rates),
        }
    }
}

/// Draws all pictures.
///
/// # Errors
/// The fault in a drawing, in words.
pub(crate) fn draw(runs: &Runs<Record>, rates: &[Rate]) -> Result<Vec<Picture>, String> {
    Kind::ALL.into_iter().map(|kind| one(kind, runs, rates).map_err(|Fault(fault)| fault)).collect()
}

fn one(kind: Kind, runs: &Runs<Record>, rates: &[Rate]) -> Result<Picture, Fault> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, kind.size()).into_drawing_area();
        area.fill(&WHITE)?;
        kind.draw(&area, runs, rates)?;
        area.present()?;
    }
    Ok(Picture { name: kind.name(), caption: kind.caption(), svg: scalable(&svg, kind.size()) })
}

/// A picture that takes the width of the page that shows it.
fn scalable(svg: &str, (width, height): (u32, u32)) -> String {
    let fixed = format!("<svg width=\"{width}\" height=\"{height}\"");
    svg.replacen(&fixed, &format!("<svg width=\"{}\" height=\"{}\"", width / 2, height / 2), 1)
}

/// The picture for a quick look: with and without, the way above the yaw.
fn overview<B: DrawingBackend>(area: &Area<B>, runs: &Runs<Record>) -> Result<(), Fault> {
    let (ways, yaws) = area.split_vertically(1000);
    let (left, right) = ways.split_horizontally(1000);
    trajectory::one(&left, &runs.controlled, "with access control")?;
    trajectory::one(&right, &runs.open, "without: both drive")?;
    let (left, right) = yaws.split_horizontally(1000);
    let range = over_time::yaw_range([&runs.controlled, &runs.open]);
    over_time::yaw(&left, &runs.controlled, "", range)?;
    over_time::yaw(&right, &runs.open, "", range)
}

#[cfg(test)]
mod tests;
