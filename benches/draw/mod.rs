//! Curves as SVG and in a page of HTML: latency against frequency, the paper's figure.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use crate::founding::bench_directory;
use std::fmt::Write as _;

const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 420.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 170.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 50.0;
const COLOURS: [&str; 8] = ["#1b6ca8", "#c8553d", "#3a7d44", "#8e5572", "#e09f3e", "#52489c", "#40798c", "#70524d"];

/// One curve: its name, and points in ascending order of x. Both axes are logarithmic, so nothing may be 0.
pub(crate) struct Curve {
    pub(crate) name: String,
    pub(crate) points: Vec<(f64, f64)>,
}

/// Writes `target/bench/NAME.svg` and `NAME.html`.
pub(crate) fn write(name: &str, title: &str, (x_name, y_name): (&str, &str), curves: &[Curve]) {
    let svg = svg(title, x_name, y_name, curves);
    let page = format!("<!doctype html><meta charset=utf-8><title>{title}</title>\n{svg}");
    for (ending, content) in [("svg", &svg), ("html", &page)] {
        let path = bench_directory().join(format!("{name}.{ending}"));
        std::fs::write(&path, content).unwrap();
        println!("written to {}", path.display());
    }
}

fn svg(title: &str, x_name: &str, y_name: &str, curves: &[Curve]) -> String {
    let all = || curves.iter().flat_map(|curve| &curve.points);
    let range = |values: &mut dyn Iterator<Item = f64>| {
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
        (low.log10().floor(), high.log10().ceil().max(low.log10().floor() + 1.0))
    };
    let (x_low, x_high) = range(&mut all().map(|point| point.0));
    let (y_low, y_high) = range(&mut all().map(|point| point.1));
    let x = |value: f64| LEFT + (value.log10() - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT);
    let y = |value: f64| HEIGHT - BOTTOM - (value.log10() - y_low) / (y_high - y_low) * (HEIGHT - TOP - BOTTOM);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" font-size=\"12\">\
         <rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"white\"/><text x=\"{LEFT}\" y=\"18\" font-size=\"14\">{title}</text>"
    );
    for power in (x_low as i32)..=(x_high as i32) {
        let (value, at) = (10f64.powi(power), x(10f64.powi(power)));
        let (top, bottom) = (TOP, HEIGHT - BOTTOM);
        let _ = write!(
            out,
            "<path d=\"M{at} {top}V{bottom}\" stroke=\"#ddd\"/><text x=\"{at}\" y=\"{}\" text-anchor=\"middle\">{value}</text>",
            bottom + 16.0
        );
    }
    for power in (y_low as i32)..=(y_high as i32) {
        let (value, at) = (10f64.powi(power), y(10f64.powi(power)));
        let _ = write!(
            out,
            "<path d=\"M{LEFT} {at}H{}\" stroke=\"#ddd\"/><text x=\"{}\" y=\"{}\" text-anchor=\"end\">{value}</text>",
            WIDTH - RIGHT,
            LEFT - 6.0,
            at + 4.0
        );
    }
    let _ = write!(
        out,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{x_name}</text>\
         <text transform=\"translate(16 {}) rotate(-90)\" text-anchor=\"middle\">{y_name}</text>",
        LEFT + (WIDTH - LEFT - RIGHT) / 2.0,
        HEIGHT - 12.0,
        TOP + (HEIGHT - TOP - BOTTOM) / 2.0
    );
    for (number, (curve, colour)) in curves.iter().zip(COLOURS.iter().cycle()).enumerate() {
        let points: Vec<_> = curve.points.iter().map(|(px, py)| format!("{:.1},{:.1}", x(*px), y(*py))).collect();
        let _ = write!(
            out,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            points.join(" ")
        );
        for (px, py) in &curve.points {
            let _ = write!(out, "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.5\" fill=\"{colour}\"/>", x(*px), y(*py));
        }
        let _ = write!(
            out,
            "<text x=\"{}\" y=\"{}\" fill=\"{colour}\">{}</text>",
            WIDTH - RIGHT + 10.0,
            TOP + 14.0 * (number as f64 + 1.0),
            curve.name
        );
    }
    out + "</svg>\n"
}
