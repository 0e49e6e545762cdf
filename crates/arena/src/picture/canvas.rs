//! A drawing surface for PNG: pixels, and letters from the font of the crate.

use super::frame::Fault;
use ab_glyph::{Font, FontRef, Glyph, PxScale, ScaleFont, point};
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind};
use std::convert::Infallible;

const FONT: &[u8] = include_bytes!("roboto-regular-subset.ttf");
/// A size of plotters is that of a line, as its SVG assumes: so much of an em.
const LINE: f64 = 1.24;
/// Drawn so many times larger in each direction, and then averaged: smooth edges.
const SHRINK: usize = 2;

/// The pixels, white at first.
pub(super) struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    pub(super) fn new((width, height): (u32, u32)) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self { width, height, pixels: vec![[255; 3]; width * height] }
    }

    /// To draw on it.
    pub(super) fn backend(&mut self) -> Surface<'_> {
        Surface { canvas: self, font: FontRef::try_from_slice(FONT).ok() }
    }

    fn blend(&mut self, x: i32, y: i32, color: BackendColor, cover: f64) {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return };
        if x >= self.width || y >= self.height {
            return;
        }
        let Some(pixel) = self.pixels.get_mut(y * self.width + x) else { return };
        let alpha = (color.alpha * cover).clamp(0.0, 1.0);
        let (red, green, blue) = color.rgb;
        for (channel, new) in pixel.iter_mut().zip([red, green, blue]) {
            *channel = (f64::from(*channel) * (1.0 - alpha) + f64::from(new) * alpha).round() as u8;
        }
    }

    /// As a PNG of half its width and height.
    pub(super) fn png(&self) -> Result<Vec<u8>, Fault> {
        let (width, height) = (self.width / SHRINK, self.height / SHRINK);
        let mut bytes = Vec::with_capacity(width * height * 3);
        for y in 0..height {
            for x in 0..width {
                for channel in 0..3 {
                    bytes.push(self.mean(x * SHRINK, y * SHRINK, channel));
                }
            }
        }
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, width as u32, height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&bytes)?;
        writer.finish()?;
        Ok(file)
    }

    fn mean(&self, x: usize, y: usize, channel: usize) -> u8 {
        let rows = (y..y + SHRINK).filter_map(|y| self.pixels.get(y * self.width + x..y * self.width + x + SHRINK));
        let sum: usize = rows.flatten().filter_map(|pixel| pixel.get(channel)).map(|value| usize::from(*value)).sum();
        u8::try_from(sum / (SHRINK * SHRINK)).unwrap_or(u8::MAX)
    }
}

/// The canvas as plotters draws on it.
pub(super) struct Surface<'a> {
    canvas: &'a mut Canvas,
    font: Option<FontRef<'static>>,
}

/// A line of letters.
struct Line {
    /// The letters with their places.
    glyphs: Vec<Glyph>,
    width: f32,
    /// Its height above the base line.
    ascent: f32,
    height: f32,
}

impl Surface<'_> {
    fn line(&self, text: &str, size: f64) -> Option<Line> {
        let font = self.font.as_ref()?;
        let em = font.units_per_em()?;
        let line_of_font = font.ascent_unscaled() - font.descent_unscaled();
        let scale = PxScale::from((size / LINE) as f32 * line_of_font / em);
        let scaled = font.as_scaled(scale);
        let (mut x, mut before, mut glyphs) = (0.0, None, Vec::new());
        for letter in text.chars() {
            let id = scaled.glyph_id(letter);
            if let Some(before) = before {
                x += scaled.kern(before, id);
            }
            glyphs.push(id.with_scale_and_position(scale, point(x, 0.0)));
            x += scaled.h_advance(id);
            before = Some(id);
        }
        Some(Line { glyphs, width: x, ascent: scaled.ascent(), height: scaled.ascent() - scaled.descent() })
    }
}

impl DrawingBackend for Surface<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        (self.canvas.width as u32, self.canvas.height as u32)
    }

    fn ensure_prepared(&mut self) -> Result<(), DrawingErrorKind<Infallible>> {
        Ok(())
    }

    fn present(&mut self) -> Result<(), DrawingErrorKind<Infallible>> {
        Ok(())
    }

    fn draw_pixel(&mut self, (x, y): BackendCoord, color: BackendColor) -> Result<(), DrawingErrorKind<Infallible>> {
        self.canvas.blend(x, y, color, 1.0);
        Ok(())
    }

    fn draw_text<S: BackendTextStyle>(
        &mut self,
        text: &str,
        style: &S,
        (left, top): BackendCoord,
    ) -> Result<(), DrawingErrorKind<Infallible>> {
        let (Some(line), Some(font)) = (self.line(text, style.size()), &self.font) else { return Ok(()) };
        let Line { glyphs, width, ascent, height } = line;
        let anchor = style.anchor();
        let dx = match anchor.h_pos {
            HPos::Left => 0.0,
            HPos::Center => -width / 2.0,
            HPos::Right => -width,
        };
        let dy = match anchor.v_pos {
            VPos::Top => 0.0,
            VPos::Center => -height / 2.0,
            VPos::Bottom => -height,
        };
        let mut covered = Vec::new();
        for outlined in glyphs.into_iter().filter_map(|glyph| font.outline_glyph(glyph)) {
            let bounds = outlined.px_bounds();
            outlined.draw(|x, y, cover| {
                let at = (bounds.min.x + x as f32 + dx, bounds.min.y + y as f32 + ascent + dy);
                covered.push((at, cover));
            });
        }
        for ((x, y), cover) in covered {
            let (x, y) = style.transform().transform(x.round() as i32, y.round() as i32);
            self.canvas.blend(left + x, top + y, style.color(), f64::from(cover));
        }
        Ok(())
    }

    fn estimate_text_size<S: BackendTextStyle>(
        &self,
        text: &str,
        style: &S,
    ) -> Result<(u32, u32), DrawingErrorKind<Infallible>> {
        let line = self.line(text, style.size());
        Ok(line.map_or((0, 0), |line| (line.width.ceil() as u32, line.height.ceil() as u32)))
    }

    fn draw_circle<S: BackendStyle>(
        &mut self,
        (x, y): BackendCoord,
        radius: u32,
        style: &S,
        fill: bool,
    ) -> Result<(), DrawingErrorKind<Infallible>> {
        let (reach, stroke) = (f64::from(radius), f64::from(style.stroke_width().max(1)));
        let outer = if fill { reach } else { reach + stroke / 2.0 };
        let border = outer.ceil() as i32 + 1;
        for dy in -border..=border {
            for dx in -border..=border {
                let distance = f64::from(dx).hypot(f64::from(dy));
                let inner = if fill { 1.0 } else { (distance - (reach - stroke / 2.0) + 0.5).clamp(0.0, 1.0) };
                self.canvas.blend(x + dx, y + dy, style.color(), (outer - distance + 0.5).clamp(0.0, 1.0) * inner);
            }
        }
        Ok(())
    }
}
