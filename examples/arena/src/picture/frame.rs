//! The common parts of all pictures: colours, letters, axes.

use crate::model::course::User;
use crate::model::record::{Driving, Record};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::prelude::*;
use plotters::style::FontDesc;
use std::fmt::Display;

/// A part of a picture.
pub(crate) type Area<B> = DrawingArea<B, Shift>;

/// Why something could not be drawn.
#[derive(Debug)]
pub(crate) struct Fault(pub(crate) String);

impl<E: Display> From<E> for Fault {
    fn from(error: E) -> Self {
        Self(error.to_string())
    }
}

/// Colours that people who see red and green alike can tell apart (Okabe and Ito).
pub(crate) const BLUE: RGBColor = RGBColor(0, 114, 178);
pub(crate) const ORANGE: RGBColor = RGBColor(213, 94, 0);
pub(crate) const GREEN: RGBColor = RGBColor(0, 140, 100);
pub(crate) const PURPLE: RGBColor = RGBColor(150, 70, 140);
pub(crate) const GREY: RGBColor = RGBColor(110, 110, 110);
pub(crate) const INK: RGBColor = RGBColor(40, 40, 40);

/// Heights of letters: titles, and all else.
pub(crate) const TITLE: u32 = 40;
pub(crate) const LETTER: u32 = 30;

/// The font of a size.
pub(crate) fn font(size: u32) -> FontDesc<'static> {
    (FontFamily::SansSerif, size).into_font()
}

/// The colour of a user.
pub(crate) fn of_user(user: User) -> RGBColor {
    match user {
        User::Salma => BLUE,
        User::Farhad => ORANGE,
    }
}

/// The colour of who may drive.
pub(crate) fn of(driving: Driving) -> RGBColor {
    match driving {
        Driving::Nobody => GREY,
        Driving::One(user) => of_user(user),
        Driving::Both => PURPLE,
    }
}

/// From when until when somebody may drive.
pub(crate) fn turns(record: &Record) -> Vec<(f64, f64, Driving)> {
    let ends = record.driving.iter().skip(1).map(|(at, _)| *at).chain([record.seconds()]);
    let turns = record.driving.iter().zip(ends).map(|((from, driving), to)| (*from, to, *driving));
    turns.filter(|(from, to, _)| to > from).collect()
}

/// Draws axes with their names.
pub(crate) fn axes<B, X, Y>(
    chart: &mut ChartContext<'_, B, Cartesian2d<X, Y>>,
    (x, y): (&str, &str),
    (x_labels, y_labels): (usize, usize),
) -> Result<(), Fault>
where
    B: DrawingBackend,
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .x_desc(x)
        .y_desc(y)
        .x_labels(x_labels)
        .y_labels(y_labels)
        .x_label_formatter(&plain)
        .y_label_formatter(&plain)
        .label_style(font(LETTER).color(&INK))
        .axis_desc_style(font(LETTER).color(&INK))
        .axis_style(INK.stroke_width(2))
        .bold_line_style(BLACK.mix(0.12).stroke_width(1))
        .light_line_style(TRANSPARENT)
        .draw()?;
    Ok(())
}

/// Draws the legend of a chart.
pub(crate) fn legend<'a, B, X, Y>(
    chart: &mut ChartContext<'a, B, Cartesian2d<X, Y>>,
    position: SeriesLabelPosition,
) -> Result<(), Fault>
where
    B: DrawingBackend + 'a,
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    chart
        .configure_series_labels()
        .position(position)
        .margin(16)
        .legend_area_size(70)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.2))
        .label_font(font(LETTER).color(&INK))
        .draw()?;
    Ok(())
}

/// A stroke of the legend.
pub(crate) fn stroke(style: impl Into<ShapeStyle>) -> impl Fn((i32, i32)) -> PathElement<(i32, i32)> {
    let style = style.into();
    move |(x, y)| PathElement::new(vec![(x + 4, y), (x + 56, y)], style)
}

/// Numbers without needless digits.
fn plain(value: &f64) -> String {
    let rounded = (value * 100.0).round() / 100.0;
    format!("{}", if rounded == 0.0 { 0.0 } else { rounded })
}
