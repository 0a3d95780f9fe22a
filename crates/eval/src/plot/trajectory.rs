//! True and estimated trajectory, seen along one axis.

use nalgebra::Vector3;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::style::{
    ALARM, Canvas, ESTIMATE, GRID, INK, Key, SCALE, TEXT_PX, TRUTH, failed, font, legend,
    length_unit, stroke, svg, tick_format, ticks, unbroken,
};
use crate::{AtePoint, EvalError};

/// Two axes of the world of the ground truth, drawn to the right and up (0, 1, 2 = x, y, z).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Plane {
    /// Axis drawn to the right.
    pub right: usize,
    /// Axis drawn up.
    pub up: usize,
}

const AXES: [&str; 3] = ["x", "y", "z"];
const WIDTH: u32 = 440;
const HEIGHT: u32 = 400;
/// Shades of error; runs of one shade become one line.
const SHADES: u8 = 12;

/// The two planes in which the true path is longest: the axis of the largest extent with each of
/// the other two, the wider first. z, usually up, is never drawn to the right.
#[must_use]
pub fn widest_planes(points: &[AtePoint]) -> [Plane; 2] {
    let extent = |axis: usize| {
        let (low, high) = range(points.iter().map(|p| p.ground_truth[axis]));
        high - low
    };
    let mut axes = [0, 1, 2];
    axes.sort_by(|&a, &b| extent(b).total_cmp(&extent(a)));
    [1, 2].map(|second| Plane {
        right: axes[0].min(axes[second]),
        up: axes[0].max(axes[second]),
    })
}

/// SVG of ground truth (grey) and aligned estimate (blue to orange with growing error); both axes have
/// one scale. Keyframes are dots, the first pose a ring.
///
/// `keyframes_s`: times of keyframes; those without a pair are not drawn.
///
/// # Errors
/// [`EvalError::TooFew`] without points, [`EvalError::Plot`] if drawing fails.
pub fn trajectory_panel(
    points: &[AtePoint],
    plane: Plane,
    keyframes_s: &[f64],
) -> Result<String, EvalError> {
    if points.is_empty() {
        return Err(EvalError::TooFew {
            what: "points to draw",
            got: 0,
            needed: 1,
        });
    }
    let Plane { right, up } = plane;
    let label = format!("trajectory in the {}-{} plane", AXES[right], AXES[up]);
    svg(WIDTH, HEIGHT, &label, |canvas| {
        let (left, bottom, top, margin) = (56, 42, 52, 12);
        let plot_px = (WIDTH - left - margin, HEIGHT - bottom - top);
        let flat = |p: &Vector3<f64>| (p[right], p[up]);
        let both = || points.iter().flat_map(|p| [p.ground_truth, p.estimate]);
        let (x_range, y_range) = one_scale(
            range(both().map(|p| p[right])),
            range(both().map(|p| p[up])),
            plot_px,
        );
        let scale = SCALE.unsigned_abs();
        let mut chart = ChartBuilder::on(canvas)
            .margin_top(top * scale)
            .margin_right(margin * scale)
            .x_label_area_size(bottom * scale)
            .y_label_area_size(left * scale)
            .build_cartesian_2d(x_range.0..x_range.1, y_range.0..y_range.1)
            .map_err(failed)?;
        let format = tick_format(x_range.1 - x_range.0);
        chart
            .configure_mesh()
            .x_labels(ticks(plot_px.0))
            .y_labels(ticks(plot_px.1))
            .x_label_formatter(&format)
            .y_label_formatter(&format)
            .x_desc(format!("{} (m)", AXES[right]))
            .y_desc(format!("{} (m)", AXES[up]))
            .label_style(font(TEXT_PX - 1, &INK))
            .axis_desc_style(font(TEXT_PX, &INK))
            .bold_line_style(stroke(&GRID, 2))
            .light_line_style(TRANSPARENT)
            .axis_style(stroke(&TRUTH, 2))
            .draw()
            .map_err(failed)?;

        let stretches = unbroken(points);
        for stretch in &stretches {
            let truth = points[stretch.clone()]
                .iter()
                .map(|p| flat(&p.ground_truth));
            let line = PathElement::new(truth.collect::<Vec<_>>(), stroke(&TRUTH, 5));
            chart.draw_series([line]).map_err(failed)?;
        }
        let largest_m = points.iter().fold(0.0, |m: f64, p| m.max(p.error_m));
        let stretches = stretches.into_iter().map(|stretch| &points[stretch]);
        for (shade, run) in stretches.flat_map(|stretch| runs(stretch, largest_m)) {
            let path: Vec<_> = run.iter().map(|p| flat(&p.estimate)).collect();
            let line = PathElement::new(path, stroke(&shade_color(shade), 4));
            chart.draw_series([line]).map_err(failed)?;
        }
        let dot = |p: &AtePoint| {
            let color = shade_color(shade_of(p.error_m, largest_m));
            Circle::new(flat(&p.estimate), 5 * SCALE / 2, color.filled())
        };
        let keyframes = points.iter().filter(|p| keyframes_s.contains(&p.t_s));
        chart.draw_series(keyframes.map(dot)).map_err(failed)?;
        let start = flat(&points[0].ground_truth);
        let ring = Circle::new(start, 6 * SCALE, stroke(&INK, 3));
        chart.draw_series([ring]).map_err(failed)?;

        let keys = [
            (Key::Line(TRUTH), "ground truth".to_owned()),
            (Key::Line(ESTIMATE), "estimate".to_owned()),
            (Key::Dot(ESTIMATE), "keyframe".to_owned()),
            (Key::Ring(INK), "start".to_owned()),
        ];
        legend(canvas, 14, 12, &keys)?;
        error_scale(canvas, 14, 36, largest_m)
    })
}

/// "error 0", the shades, "7.3 cm".
fn error_scale(canvas: &Canvas<'_>, x: i32, y: i32, largest_m: f64) -> Result<(), EvalError> {
    let (unit, per_m) = length_unit(largest_m);
    let style = font(TEXT_PX, &INK).pos(Pos::new(HPos::Left, VPos::Center));
    let (x, y) = (x * SCALE, y * SCALE);
    canvas
        .draw_text("error 0", &style, (x, y))
        .map_err(failed)?;
    let (first, step) = (x + 54 * SCALE, 8 * SCALE);
    for shade in 0..SHADES {
        let left = first + i32::from(shade) * step;
        // One unit of overlap hides the seams.
        let corners = [(left, y - 4 * SCALE), (left + step + 1, y + 4 * SCALE)];
        let patch = Rectangle::new(corners, shade_color(shade).filled());
        canvas.draw(&patch).map_err(failed)?;
    }
    let text = format!("{:.1} {unit}", largest_m * per_m);
    let end = first + i32::from(SHADES) * step + 6 * SCALE;
    canvas.draw_text(&text, &style, (end, y)).map_err(failed)
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    })
}

/// Both ranges widened about their centres to one scale, with a margin of 5 %.
fn one_scale(
    x: (f64, f64),
    y: (f64, f64),
    (width_px, height_px): (u32, u32),
) -> ((f64, f64), (f64, f64)) {
    let (width_px, height_px) = (f64::from(width_px), f64::from(height_px));
    let m_per_px = ((x.1 - x.0) / width_px).max((y.1 - y.0) / height_px);
    let m_per_px = 1.1 * m_per_px.max(1e-6);
    let widen = |(low, high): (f64, f64), px: f64| {
        let (middle, half) = (0.5 * (low + high), 0.5 * m_per_px * px);
        (middle - half, middle + half)
    };
    (widen(x, width_px), widen(y, height_px))
}

fn shade_of(error_m: f64, largest_m: f64) -> u8 {
    let share = if largest_m > 0.0 {
        error_m / largest_m
    } else {
        0.0
    };
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "share is in [0, 1]"
    )]
    let shade = (share * f64::from(SHADES)) as u8;
    shade.min(SHADES - 1)
}

/// From [`ESTIMATE`] to [`ALARM`] over purple, which differs from the grey of the ground truth.
fn shade_color(shade: u8) -> RGBColor {
    const MIDDLE: RGBColor = RGBColor(0x9c, 0x5f, 0xa8);
    let (position, end) = (2 * i32::from(shade), i32::from(SHADES - 1));
    let (from, to, step) = if position <= end {
        (ESTIMATE, MIDDLE, position)
    } else {
        (MIDDLE, ALARM, position - end)
    };
    let mix = |a: u8, b: u8| {
        let mixed = i32::from(a) + (i32::from(b) - i32::from(a)) * step / end;
        u8::try_from(mixed).unwrap_or(a)
    };
    RGBColor(mix(from.0, to.0), mix(from.1, to.1), mix(from.2, to.2))
}

/// Maximal runs of one shade, each ending with the first point of the next so that lines meet.
fn runs(points: &[AtePoint], largest_m: f64) -> Vec<(u8, &[AtePoint])> {
    let shade = |i: usize| shade_of(points[i].error_m, largest_m);
    let mut runs = Vec::new();
    let mut start = 0;
    for end in 1..=points.len() {
        if end == points.len() || shade(end) != shade(start) {
            runs.push((shade(start), &points[start..(end + 1).min(points.len())]));
            start = end;
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(t_s: f64, at: [f64; 3], error_m: f64) -> AtePoint {
        AtePoint {
            t_s,
            ground_truth: at.into(),
            estimate: at.into(),
            error_m,
        }
    }

    #[test]
    fn the_widest_planes_are_drawn() {
        let points = [point(0.0, [0.0; 3], 0.0), point(1.0, [0.5, 3.0, 1.0], 0.1)];
        let [first, second] = widest_planes(&points);
        assert_eq!(first, Plane { right: 1, up: 2 }, "y and z");
        assert_eq!(second, Plane { right: 0, up: 1 }, "y and x");
    }

    #[test]
    fn both_axes_have_one_scale() {
        let (x, y) = one_scale((0.0, 4.0), (1.0, 1.5), (400, 300));
        let (per_px_x, per_px_y) = ((x.1 - x.0) / 400.0, (y.1 - y.0) / 300.0);
        assert!((per_px_x - per_px_y).abs() < 1e-15, "{x:?} {y:?}");
        assert!(x.0 < 0.0 && x.1 > 4.0 && y.0 < 1.0 && y.1 > 1.5, "inside");
        let (x, _) = one_scale((2.0, 2.0), (1.0, 1.0), (400, 300));
        assert!(x.1 > x.0, "a single point has a range");
    }

    #[test]
    fn runs_are_connected_and_complete() {
        let errors = [0.0, 0.01, 0.9, 1.0, 0.0];
        let points: Vec<_> = errors.iter().map(|&e| point(e, [e; 3], e)).collect();
        let runs = runs(&points, 1.0);
        let expected = [(0, 0..3), (10, 2..4), (11, 3..5), (0, 4..5)];
        let expected = expected.map(|(shade, range)| (shade, &points[range]));
        assert_eq!(runs, expected, "shade and range");
        assert_eq!(shade_color(0), ESTIMATE, "no error");
        assert_eq!(shade_color(SHADES - 1), ALARM, "largest error");
    }

    #[test]
    fn same_input_same_text() {
        let points: Vec<_> = (0..40)
            .map(|i| f64::from(i) * 0.1)
            .map(|s| point(s, [s, s * s, 0.3 * s], 0.01 * s))
            .collect();
        let draw = || trajectory_panel(&points, Plane { right: 0, up: 1 }, &[0.0, 1.0]);
        let text = draw().expect("40 points");
        assert_eq!(Ok(&text), draw().as_ref(), "twice");
        assert!(
            text.contains("ground truth") && text.contains("3.9 cm"),
            "legend"
        );
        assert!(!text.contains("NaN"), "numbers");
        let one = trajectory_panel(&points[..1], Plane { right: 0, up: 1 }, &[]);
        assert!(one.expect("one point").contains("</svg>"), "one point");
        assert!(
            trajectory_panel(&[], Plane { right: 0, up: 1 }, &[]).is_err(),
            "none"
        );
    }
}
