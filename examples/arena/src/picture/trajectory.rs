//! The way of the robot, with its references.

use super::frame::{Area, Fault, GREY, INK, LETTER, TITLE, axes, font, of, of_user, turns};
use crate::model::claims::Runs;
use crate::model::course::{User, Waypoint};
use crate::model::geometry::Point;
use crate::model::record::{Record, Seen};
use crate::model::robot::RADIUS;
use plotters::prelude::*;

/// The part of the arena that is shown, at full scale (metres).
const SHOWN: f64 = 2.9;
/// The middle of it.
const MIDDLE: f64 = -0.35;
/// Every how many pictures of the cameras a point is drawn.
const EVERY: usize = 12;

/// All runs.
pub(crate) fn four<B: DrawingBackend>(area: &Area<B>, runs: &Runs<Record>) -> Result<(), Fault> {
    let titles = ["with access control", "without: both drive", "preemption and emergency stop", "over a delayed link"];
    let parts = area.split_evenly((2, 2));
    for ((part, (_, record)), title) in parts.iter().zip(runs.named()).zip(titles) {
        one(part, record, title)?;
    }
    Ok(())
}

/// One run.
pub(crate) fn one<B: DrawingBackend>(area: &Area<B>, record: &Record, title: &str) -> Result<(), Fault> {
    let start = record.course.start().at;
    // All of it is in the picture, also if the robot leaves the course.
    let reach = record.seen.iter().map(|seen| (seen.pose.at.y - MIDDLE).abs().max(seen.pose.at.x.abs()) + RADIUS);
    let shown = reach.fold(SHOWN * (start.y / -2.4), f64::max);
    let mut chart = ChartBuilder::on(area)
        .caption(title, font(TITLE).color(&INK))
        .margin(20)
        .margin_right(54)
        .x_label_area_size(72)
        .y_label_area_size(90)
        .build_cartesian_2d(-shown..shown, MIDDLE - shown..MIDDLE + shown)?;
    axes(&mut chart, ("x (m)", "y (m)"), (7, 7))?;

    for user in User::ALL {
        let line = [start].into_iter().chain(record.course.waypoints(user)).map(|point| (point.x, point.y));
        chart.draw_series(DashedLineSeries::new(line, 14, 10, of_user(user).mix(0.6).stroke_width(3)))?;
    }
    for (from, to, driving) in turns(record) {
        let points: Vec<&Seen> = record.seen.iter().filter(|seen| (from..=to).contains(&seen.at)).collect();
        // The last one is where the next driver's line begins.
        let line = points.iter().step_by(EVERY).chain(points.last()).map(|seen| (seen.pose.at.x, seen.pose.at.y));
        chart.draw_series(LineSeries::new(line, of(driving).stroke_width(5)))?;
        // Where it looks, once a second.
        let marks = points.iter().step_by(EVERY * 10).map(|seen| {
            let Point { x, y } = seen.pose.at;
            let end = (x + RADIUS * seen.pose.yaw.cos(), y + RADIUS * seen.pose.yaw.sin());
            PathElement::new(vec![(x, y), end], of(driving).mix(0.7).stroke_width(3))
        });
        chart.draw_series(marks)?;
    }
    for user in User::ALL {
        for index in 0..record.course.waypoints(user).len() {
            let waypoint = Waypoint { user, index };
            let reached = record.reached.iter().any(|reached| reached.waypoint == waypoint);
            mark(&mut chart, record.course.place(waypoint), &waypoint.name(), of_user(user), reached)?;
        }
    }
    mark(&mut chart, start, "Start", GREY, true)?;
    Ok(())
}

type Chart<'a, B> =
    ChartContext<'a, B, Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>>;

/// A place with its name; hollow if it was not reached.
fn mark<B: DrawingBackend>(
    chart: &mut Chart<'_, B>,
    at: Point,
    name: &str,
    color: RGBColor,
    reached: bool,
) -> Result<(), Fault> {
    let style = if reached { color.filled() } else { color.stroke_width(4) };
    let place = (at.x, at.y);
    chart.draw_series([Circle::new(place, 13, WHITE.filled())])?;
    chart.draw_series([Circle::new(place, 11, style)])?;
    let outwards = if at.x < 0.0 { (-66, -14) } else { (20, -14) };
    let label = EmptyElement::at(place) + Text::new(name.to_owned(), outwards, font(LETTER).color(&color));
    chart.draw_series([label])?;
    Ok(())
}
