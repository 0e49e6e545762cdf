//! Pictures over time: yaw, received frequency, latency.

use super::frame::{
    Area, BLUE, Fault, GREY, INK, LETTER, ORANGE, TITLE, axes, font, legend, of, of_user, stroke, turns,
};
use crate::model::baseline::PAPER_OPEN_HZ;
use crate::model::claims::Runs;
use crate::model::controller::HZ;
use crate::model::record::Record;
use plotters::prelude::*;

/// Every how many pictures of the cameras a point of the yaw is drawn.
const EVERY: usize = 6;
/// Length of the windows in which commands are counted (seconds).
const WINDOW: f64 = 0.5;
/// The frequency up to which the picture goes (Hz): there is room for a legend above what both users publish.
const FREQUENCY_MAX: f64 = 180.0;
/// Latencies below are drawn as this (milliseconds): an axis with powers of ten has no zero.
const LATENCY_MIN_MS: f64 = 0.5;

/// The yaw of all runs, one below the other.
pub(crate) fn yaws<B: DrawingBackend>(area: &Area<B>, runs: &Runs<Record>) -> Result<(), Fault> {
    let titles = ["with access control", "without: both drive", "preemption and emergency stop", "over a delayed link"];
    let parts = area.split_evenly((4, 1));
    for ((part, (_, record)), title) in parts.iter().zip(runs.named()).zip(titles) {
        yaw(part, record, title, yaw_range([record]))?;
    }
    Ok(())
}

/// The range of the yaw in these runs.
pub(crate) fn yaw_range<const COUNT: usize>(records: [&Record; COUNT]) -> (f64, f64) {
    let yaws = records.iter().flat_map(|record| record.unwrapped_yaw()).map(|(_, yaw)| yaw);
    let (low, high) = yaws.fold((0.0_f64, 2.0_f64), |(low, high), yaw| (low.min(yaw), high.max(yaw)));
    (low - 0.4, high + 0.4 + 0.2 * (high - low))
}

/// The yaw of one run.
pub(crate) fn yaw<B: DrawingBackend>(
    area: &Area<B>,
    record: &Record,
    title: &str,
    (low, high): (f64, f64),
) -> Result<(), Fault> {
    let mut builder = ChartBuilder::on(area);
    if !title.is_empty() {
        builder.caption(title, font(TITLE).color(&INK));
    }
    let mut chart = builder
        .margin(16)
        .margin_right(30)
        .x_label_area_size(72)
        .y_label_area_size(90)
        .build_cartesian_2d(0.0..record.seconds().max(1.0), low..high)?;
    axes(&mut chart, ("time (s)", "yaw (rad)"), (8, 5))?;
    for (from, to, driving) in turns(record) {
        chart.draw_series([Rectangle::new([(from, low), (to, high)], of(driving).mix(0.13).filled())])?;
    }
    for reached in &record.reached {
        let color = of_user(reached.waypoint.user);
        chart.draw_series([PathElement::new(
            vec![(reached.at, low), (reached.at, high)],
            color.mix(0.6).stroke_width(2),
        )])?;
        let label = EmptyElement::at((reached.at, high))
            + Text::new(reached.waypoint.name(), (-40, 6), font(LETTER).color(&color));
        chart.draw_series([label])?;
    }
    if let Some(emergency) = record.emergency {
        let middle = (emergency.asked + emergency.resumed) / 2.0;
        let label = EmptyElement::at((middle, low)) + Text::new("stop", (-24, -40), font(LETTER).color(&INK));
        chart.draw_series([label])?;
    }
    let line = record.unwrapped_yaw().into_iter().step_by(EVERY);
    chart.draw_series(LineSeries::new(line, INK.stroke_width(4)))?;
    Ok(())
}

/// Commands a second that reach the robot.
pub(crate) fn frequency<B: DrawingBackend>(area: &Area<B>, runs: &Runs<Record>) -> Result<(), Fault> {
    let both = [("with access control", &runs.controlled, BLUE), ("without: both drive", &runs.open, ORANGE)];
    let seconds = both.iter().map(|(_, record, _)| record.seconds()).fold(1.0, f64::max);
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .margin_right(30)
        .x_label_area_size(72)
        .y_label_area_size(100)
        .build_cartesian_2d(0.0..seconds, 0.0..FREQUENCY_MAX)?;
    axes(&mut chart, ("time (s)", "commands received (Hz)"), (8, 7))?;
    for hz in [f64::from(HZ), f64::from(2 * HZ)] {
        chart.draw_series(DashedLineSeries::new([(0.0, hz), (seconds, hz)], 8, 8, GREY.mix(0.7).stroke_width(2)))?;
    }
    let paper = ORANGE.mix(0.6).stroke_width(3);
    chart
        .draw_series(DashedLineSeries::new([(0.0, PAPER_OPEN_HZ), (seconds, PAPER_OPEN_HZ)], 4, 10, paper))?
        .label("the paper, without: about 70 Hz")
        .legend(stroke(paper));
    for (name, record, color) in both {
        chart
            .draw_series(LineSeries::new(record.received_hz(WINDOW), color.stroke_width(5)))?
            .label(name)
            .legend(stroke(color.stroke_width(5)));
    }
    legend(&mut chart, SeriesLabelPosition::UpperRight)
}

/// How long commands take to the robot.
pub(crate) fn latency<B: DrawingBackend>(area: &Area<B>, runs: &Runs<Record>) -> Result<(), Fault> {
    let both = [("with access control", &runs.controlled, BLUE), ("without: both drive", &runs.open, ORANGE)];
    let seconds = both.iter().map(|(_, record, _)| record.seconds()).fold(1.0, f64::max);
    let slowest = both.iter().flat_map(|(_, record, _)| record.latencies()).map(|(_, latency)| latency * 1000.0);
    let most = slowest.fold(10.0, f64::max) * 30.0;
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .margin_right(30)
        .x_label_area_size(72)
        .y_label_area_size(110)
        .build_cartesian_2d(0.0..seconds, (LATENCY_MIN_MS..most).log_scale())?;
    axes(&mut chart, ("time (s)", "latency (ms)"), (8, 6))?;
    for (name, record, color) in both {
        let windows = windows(record);
        let middle = windows.iter().map(|(at, median, _)| (*at, *median));
        chart
            .draw_series(LineSeries::new(middle, color.stroke_width(5)))?
            .label(format!("{name}, median"))
            .legend(stroke(color.stroke_width(5)));
        let slowest = windows.iter().map(|(at, _, slowest)| (*at, *slowest));
        chart
            .draw_series(LineSeries::new(slowest, color.mix(0.45).stroke_width(2)))?
            .label(format!("{name}, slowest"))
            .legend(stroke(color.mix(0.45).stroke_width(2)));
    }
    legend(&mut chart, SeriesLabelPosition::UpperRight)
}

/// Median and slowest of each window that has any, in milliseconds.
fn windows(record: &Record) -> Vec<(f64, f64, f64)> {
    let latencies = record.latencies();
    let count = (record.seconds() / WINDOW).ceil() as usize;
    let window = |number: usize| {
        let from = number as f64 * WINDOW;
        let mut within: Vec<f64> = latencies
            .iter()
            .filter(|(at, _)| (from..from + WINDOW).contains(at))
            .map(|(_, latency)| (latency * 1000.0).max(LATENCY_MIN_MS))
            .collect();
        within.sort_by(f64::total_cmp);
        Some((from + WINDOW / 2.0, *within.get(within.len() / 2)?, *within.last()?))
    };
    (0..count).filter_map(window).collect()
}
