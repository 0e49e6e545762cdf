//! Latency against frequency, beside others.

use super::Rate;
use super::frame::{Area, BLUE, Fault, GREEN, GREY, ORANGE, PURPLE, axes, legend, stroke};
use crate::model::baseline::{FABRIC, PAPER_FEEDBACK_MS};
use plotters::prelude::*;

/// The frequencies that are shown (Hz).
const FREQUENCIES: (f64, f64) = (1.0, 500.0);
/// The latencies that are shown (milliseconds).
const LATENCIES: (f64, f64) = (0.3, 20_000.0);

/// Draws the curves.
pub(crate) fn draw<B: DrawingBackend>(area: &Area<B>, rates: &[Rate]) -> Result<(), Fault> {
    let (from, to) = FREQUENCIES;
    let (least, most) = LATENCIES;
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .margin_right(30)
        .x_label_area_size(72)
        .y_label_area_size(110)
        .build_cartesian_2d((from..to).log_scale(), (least..most).log_scale())?;
    axes(&mut chart, ("frequency (Hz)", "latency (ms)"), (8, 8))?;
    let paper = GREY.stroke_width(3);
    chart
        .draw_series(DashedLineSeries::new([(from, PAPER_FEEDBACK_MS), (to, PAPER_FEEDBACK_MS)], 6, 10, paper))?
        .label("the paper: a pose reaches the controller after almost 300 ms")
        .legend(stroke(paper));
    for (curve, color) in FABRIC.iter().zip([PURPLE, ORANGE, GREEN]) {
        let style = color.stroke_width(4);
        chart
            .draw_series(LineSeries::new(curve.points.iter().copied(), style))?
            .label(format!("{}, commit", curve.name))
            .legend(stroke(style));
        chart.draw_series(curve.points.iter().map(|point| Circle::new(*point, 9, color.filled())))?;
    }
    // A frequency at which nothing arrived has no latency.
    let measured: Vec<&Rate> = rates.iter().filter(|rate| rate.received > 0).collect();
    let ours = BLUE.stroke_width(6);
    let median = || measured.iter().map(|rate| (rate.hz, rate.p50_ms));
    chart.draw_series(LineSeries::new(median(), ours))?.label("ledgerd, ROS 2 to ROS 2, median").legend(stroke(ours));
    chart.draw_series(median().map(|point| Circle::new(point, 10, BLUE.filled())))?;
    let high = BLUE.mix(0.45).stroke_width(3);
    chart
        .draw_series(LineSeries::new(measured.iter().map(|rate| (rate.hz, rate.p99_ms)), high))?
        .label("ledgerd, p99")
        .legend(stroke(high));
    legend(&mut chart, SeriesLabelPosition::UpperRight)
}
