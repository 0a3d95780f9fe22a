//! What the plots share: canvas, colours, fonts, legend, units.
//!
//! Sizes are in CSS pixels at full width; inside, everything is drawn `SCALE` times larger, because the
//! SVG backend places points on whole numbers. The five colours have the same meaning in every plot and
//! are distinguishable for colour-blind readers; a page may repaint ink and grid for a dark background
//! by their attribute values.

use std::ops::Range;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::{AtePoint, EvalError};

/// Drawing units per CSS pixel.
pub(super) const SCALE: i32 = 4;

/// Text and axes.
pub const INK: RGBColor = RGBColor(0x24, 0x29, 0x2f);
/// Grid lines.
pub const GRID: RGBColor = RGBColor(0xd8, 0xde, 0xe4);
/// Ground truth.
pub const TRUTH: RGBColor = RGBColor(0x8c, 0x95, 0x9f);
/// The estimate, and small errors.
pub const ESTIMATE: RGBColor = RGBColor(0x2a, 0x82, 0xc9);
/// Large errors, lost stretches.
pub const ALARM: RGBColor = RGBColor(0xe0, 0x6c, 0x1f);

pub(super) const FONT: &str = "system-ui, sans-serif";
pub(super) const TEXT_PX: i32 = 14;

pub(super) type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;

pub(super) fn failed<E: std::fmt::Display>(error: E) -> EvalError {
    EvalError::Plot(error.to_string())
}

/// Draws on a canvas of `width` x `height` CSS pixels; `label` is for screen readers.
pub(super) fn svg(
    width: u32,
    height: u32,
    label: &str,
    draw: impl FnOnce(&Canvas<'_>) -> Result<(), EvalError>,
) -> Result<String, EvalError> {
    let scale = SCALE.unsigned_abs();
    let (units_x, units_y) = (width * scale, height * scale);
    let mut text = String::new();
    {
        let canvas = SVGBackend::with_string(&mut text, (units_x, units_y)).into_drawing_area();
        draw(&canvas)?;
        canvas.present().map_err(failed)?;
    }
    // The page sets the size; the view box keeps the aspect ratio.
    let fixed_size = format!("width=\"{units_x}\" height=\"{units_y}\"");
    let label = maud::html! { (label) }.into_string();
    let flexible = format!("class=\"plot\" role=\"img\" aria-label=\"{label}\" width=\"{width}\"");
    Ok(text.replacen(&fixed_size, &flexible, 1))
}

pub(super) fn font(px: i32, color: &RGBColor) -> TextStyle<'static> {
    (FONT, px * SCALE).into_font().color(color)
}

/// An entry of the legend above a plot.
pub(super) enum Key {
    Line(RGBColor),
    Dot(RGBColor),
    Ring(RGBColor),
    Band(RGBColor),
}

/// One row of keys from left to right, centred on `y` (CSS pixels), outside the plot.
pub(super) fn legend(
    canvas: &Canvas<'_>,
    x: i32,
    y: i32,
    keys: &[(Key, String)],
) -> Result<(), EvalError> {
    let (mut x, y) = (x * SCALE, y * SCALE);
    let sample = 20 * SCALE;
    let style = font(TEXT_PX, &INK).pos(Pos::new(HPos::Left, VPos::Center));
    for (key, text) in keys {
        let (middle, half) = (x + sample / 2, 5 * SCALE);
        match key {
            Key::Line(color) => {
                let line = PathElement::new([(x, y), (x + sample, y)], stroke(color, 3));
                canvas.draw(&line)
            }
            Key::Dot(color) => canvas.draw(&Circle::new((middle, y), 4 * SCALE, color.filled())),
            Key::Ring(color) => canvas.draw(&Circle::new((middle, y), 6 * SCALE, stroke(color, 3))),
            Key::Band(color) => {
                let corners = [(x, y - half), (x + sample, y + half)];
                canvas.draw(&Rectangle::new(corners, color.mix(BAND_OPACITY).filled()))
            }
        }
        .map_err(failed)?;
        x += sample + 6 * SCALE;
        canvas.draw_text(text, &style, (x, y)).map_err(failed)?;
        // The width of text is unknown without font files: assume wide letters, so that keys never touch.
        let letters = i32::try_from(text.chars().count()).unwrap_or(0);
        x += letters * TEXT_PX * SCALE * 54 / 100 + 16 * SCALE;
    }
    Ok(())
}

pub(super) const BAND_OPACITY: f64 = 0.22;

/// Line width in half CSS pixels.
pub(super) fn stroke(color: &RGBColor, half_px: u32) -> ShapeStyle {
    color.stroke_width(half_px * SCALE.unsigned_abs() / 2)
}

/// A length unit that leaves numbers between 1 and 1000: (name, units per metre).
pub(super) fn length_unit(largest_m: f64) -> (&'static str, f64) {
    match largest_m {
        m if m < 0.01 => ("mm", 1000.0),
        m if m < 1.0 => ("cm", 100.0),
        _ => ("m", 1.0),
    }
}

/// Tick labels with as many digits as a range of this length needs.
pub(super) fn tick_format(range: f64) -> impl Fn(&f64) -> String {
    let digits = match range {
        r if r >= 8.0 => 0,
        r if r >= 0.8 => 1,
        r if r >= 0.08 => 2,
        _ => 3,
    };
    move |value: &f64| {
        let text = format!("{value:.digits$}");
        // "-0.0" is 0 with a rounding error.
        match text.strip_prefix('-') {
            Some(positive) if positive.chars().all(|c| c == '0' || c == '.') => positive.to_owned(),
            _ => text,
        }
    }
}

/// Number of ticks for an axis of this many CSS pixels.
pub(super) fn ticks(px: u32) -> usize {
    (px / 70).clamp(3, 12) as usize
}

/// Parts of a line: it is interrupted where there is no point for five usual intervals.
pub(super) fn unbroken(points: &[AtePoint]) -> Vec<Range<usize>> {
    let mut steps: Vec<f64> = points.windows(2).map(|w| w[1].t_s - w[0].t_s).collect();
    let cuts: Vec<usize> = {
        let all = steps.clone();
        steps.sort_by(f64::total_cmp);
        let usual = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        (0..all.len())
            .filter(|&i| all[i] > 5.0 * usual)
            .map(|i| i + 1)
            .collect()
    };
    let starts = std::iter::once(0).chain(cuts.iter().copied());
    let ends = cuts.iter().copied().chain(std::iter::once(points.len()));
    starts.zip(ends).map(|(start, end)| start..end).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_interrupt_the_line() {
        let point = |&t_s: &f64| AtePoint {
            t_s,
            ground_truth: nalgebra::Vector3::zeros(),
            estimate: nalgebra::Vector3::zeros(),
            error_m: 0.0,
        };
        let points: Vec<_> = [0.0, 0.1, 0.2, 0.9, 1.0, 1.1].iter().map(point).collect();
        assert_eq!(unbroken(&points), [0..3, 3..6], "one hole");
        assert_eq!(unbroken(&points[..1]), vec![0..1; 1], "one point");
    }

    #[test]
    fn units_and_ticks() {
        assert_eq!(length_unit(0.005).0, "mm", "5 mm");
        assert_eq!(length_unit(0.07).0, "cm", "7 cm");
        assert_eq!(length_unit(1.2).0, "m", "1.2 m");
        assert_eq!(tick_format(3.0)(&-1e-17), "0.0", "no negative zero");
        assert_eq!(tick_format(3.0)(&-0.5), "-0.5", "negative");
        assert_eq!(tick_format(20.0)(&15.0), "15", "whole");
    }

    #[test]
    fn svg_has_a_view_box_and_an_escaped_label() {
        let text = svg(100, 50, "a < \"b\"", |_| Ok(())).expect("an empty canvas");
        let head = text.lines().next().expect("a first line");
        assert!(head.contains("viewBox=\"0 0 400 200\""), "{head}");
        assert!(
            head.contains("aria-label=\"a &lt; &quot;b&quot;\""),
            "{head}"
        );
        assert!(
            head.contains("width=\"100\"") && !head.contains("height="),
            "{head}"
        );
    }
}
