//! Trajectory error and duration of tracking over time.

use std::ops::Range;

use plotters::prelude::*;

use super::style::{
    ALARM, BAND_OPACITY, Canvas, ESTIMATE, GRID, INK, Key, SCALE, TEXT_PX, TRUTH, failed, font,
    legend, length_unit, stroke, svg, tick_format, ticks, unbroken,
};
use crate::{AtePoint, EvalError, Stats};

const WIDTH: u32 = 980;
const HEIGHT: u32 = 250;
const LEFT: u32 = 60;

/// Duration of tracking of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameTime {
    /// Time of the frame in the recording, seconds.
    pub t_s: f64,
    /// Duration, milliseconds.
    pub ms: f64,
    /// Whether it became a keyframe.
    pub keyframe: bool,
}

/// SVG of the trajectory error over time since `start_s`, with its RMSE as a line and the
/// intervals in which tracking was `lost` (seconds, in the recording's time) as bands.
///
/// # Errors
/// [`EvalError::TooFew`] without points, [`EvalError::Plot`] if drawing fails.
pub fn error_over_time(
    points: &[AtePoint],
    start_s: f64,
    lost: &[Range<f64>],
) -> Result<String, EvalError> {
    let errors: Vec<f64> = points.iter().map(|p| p.error_m).collect();
    let stats = Stats::of(&errors)?;
    let (unit, per_m) = length_unit(stats.max);
    let value = |p: &AtePoint| (p.t_s - start_s, p.error_m * per_m);
    let end_s = lost
        .iter()
        .map(|l| l.end)
        .chain(points.iter().map(|p| p.t_s));
    let end_s = end_s.fold(start_s, f64::max);
    let rmse = stats.rmse * per_m;
    let mut keys = vec![
        (Key::Line(ESTIMATE), "position error".to_owned()),
        (Key::Line(INK), format!("RMSE {rmse:.2} {unit}")),
    ];
    if !lost.is_empty() {
        keys.push((Key::Band(ALARM), "lost".to_owned()));
    }
    let axes = Axes {
        duration_s: end_s - start_s,
        top: stats.max * per_m,
        name: format!("error ({unit})"),
    };
    svg(WIDTH, HEIGHT, "position error over time", |canvas| {
        let mut chart = axes.draw(canvas, &keys)?;
        let top = axes.limit();
        let bands = lost.iter().map(|l| {
            let corners = [(l.start - start_s, 0.0), (l.end - start_s, top)];
            Rectangle::new(corners, ALARM.mix(BAND_OPACITY).filled())
        });
        chart.draw_series(bands).map_err(failed)?;
        for stretch in unbroken(points) {
            let stretch = &points[stretch];
            let line: Vec<_> = stretch.iter().map(value).collect();
            let mut area = line.clone();
            area.push((line[line.len() - 1].0, 0.0));
            area.push((line[0].0, 0.0));
            let area = Polygon::new(area, ESTIMATE.mix(0.15));
            chart.draw_series([area]).map_err(failed)?;
            let line = PathElement::new(line, stroke(&ESTIMATE, 3));
            chart.draw_series([line]).map_err(failed)?;
        }
        let level = PathElement::new([(0.0, rmse), (axes.width(), rmse)], stroke(&INK, 2));
        chart.draw_series([level]).map_err(failed)?;
        Ok(())
    })
}

/// SVG of the tracking time per frame since `start_s`; keyframes are dots. `budget_ms`, the time
/// between two frames of the sensor, is drawn as a line if it fits.
///
/// # Errors
/// [`EvalError::TooFew`] without frames, [`EvalError::NonFinite`], [`EvalError::Plot`].
pub fn time_per_frame(
    frames: &[FrameTime],
    start_s: f64,
    budget_ms: Option<f64>,
) -> Result<String, EvalError> {
    let durations: Vec<f64> = frames.iter().map(|frame| frame.ms).collect();
    let stats = Stats::of(&durations)?;
    if let Some(index) = frames.iter().position(|frame| !frame.t_s.is_finite()) {
        let what = "frame time";
        return Err(EvalError::NonFinite { what, index });
    }
    let at = |frame: &FrameTime| (frame.t_s - start_s, frame.ms);
    let mut keys = vec![
        (Key::Line(ESTIMATE), "tracking".to_owned()),
        (Key::Dot(ALARM), "keyframe".to_owned()),
        (Key::Line(INK), format!("median {:.1} ms", stats.median)),
    ];
    let budget_ms = budget_ms.filter(|&ms| ms > 0.0 && ms < 3.0 * stats.max);
    if let Some(ms) = budget_ms {
        keys.push((Key::Line(TRUTH), format!("sensor rate {ms:.1} ms")));
    }
    let axes = Axes {
        duration_s: frames.iter().fold(0.0, |d: f64, f| d.max(f.t_s - start_s)),
        top: stats.max.max(budget_ms.unwrap_or(0.0)),
        name: "time per frame (ms)".to_owned(),
    };
    svg(WIDTH, HEIGHT, "tracking time per frame", |canvas| {
        let mut chart = axes.draw(canvas, &keys)?;
        let levels = [(budget_ms, TRUTH), (Some(stats.median), INK)];
        for (level, color) in levels {
            if let Some(ms) = level {
                let line = PathElement::new([(0.0, ms), (axes.width(), ms)], stroke(&color, 2));
                chart.draw_series([line]).map_err(failed)?;
            }
        }
        let line: Vec<_> = frames.iter().map(at).collect();
        let line = PathElement::new(line, stroke(&ESTIMATE, 3));
        chart.draw_series([line]).map_err(failed)?;
        let keyframes = frames.iter().filter(|frame| frame.keyframe);
        let dots = keyframes.map(|frame| Circle::new(at(frame), 3 * SCALE, ALARM.filled()));
        chart.draw_series(dots).map_err(failed)?;
        Ok(())
    })
}

type Chart<'a, 'b> = ChartContext<
    'a,
    SVGBackend<'b>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

/// Axes of a plot over time: time to the right from 0, a positive quantity up from 0.
struct Axes {
    duration_s: f64,
    top: f64,
    name: String,
}

impl Axes {
    /// Upper end of the vertical axis.
    fn limit(&self) -> f64 {
        1.08 * self.top.max(1e-9)
    }

    /// Right end of the time axis.
    fn width(&self) -> f64 {
        self.duration_s.max(1e-3)
    }

    fn draw<'a, 'b>(
        &self,
        canvas: &'a Canvas<'b>,
        keys: &[(Key, String)],
    ) -> Result<Chart<'a, 'b>, EvalError> {
        let scale = SCALE.unsigned_abs();
        let (top, bottom, margin) = (30, 42, 14);
        let mut chart = ChartBuilder::on(canvas)
            .margin_top(top * scale)
            .margin_right(margin * scale)
            .x_label_area_size(bottom * scale)
            .y_label_area_size(LEFT * scale)
            .build_cartesian_2d(0.0..self.width(), 0.0..self.limit())
            .map_err(failed)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(ticks(WIDTH - LEFT))
            .y_labels(5)
            .x_label_formatter(&tick_format(self.width()))
            .y_label_formatter(&tick_format(self.limit()))
            .x_desc("time (s)")
            .y_desc(&self.name)
            .label_style(font(TEXT_PX - 1, &INK))
            .axis_desc_style(font(TEXT_PX, &INK))
            .bold_line_style(stroke(&GRID, 2))
            .light_line_style(TRANSPARENT)
            .axis_style(stroke(&TRUTH, 2))
            .draw()
            .map_err(failed)?;
        legend(canvas, LEFT.cast_signed(), 12, keys)?;
        Ok(chart)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn points(times: &[f64]) -> Vec<AtePoint> {
        let point = |&t_s: &f64| AtePoint {
            t_s,
            ground_truth: Vector3::zeros(),
            estimate: Vector3::x() * 0.02,
            error_m: 0.02,
        };
        times.iter().map(point).collect()
    }

    #[test]
    fn error_plot_has_a_legend() {
        let points = points(&[10.0, 10.1, 10.2]);
        let text = error_over_time(&points, 10.0, &[10.2..10.5]).expect("three points");
        assert!(text.contains("RMSE 2.00 cm"), "legend");
        assert!(text.contains("lost"), "bands have a key");
        assert!(!text.contains("NaN"), "numbers");
        let calm = error_over_time(&points, 10.0, &[]).expect("three points");
        assert!(!calm.contains("lost"), "no key without bands");
        assert!(error_over_time(&[], 0.0, &[]).is_err(), "nothing to draw");
    }

    #[test]
    fn time_plot_shows_a_budget_that_fits() {
        let frame = |t_s, ms, keyframe| FrameTime { t_s, ms, keyframe };
        let frames = [frame(0.0, 20.0, true), frame(0.1, 30.0, false)];
        let text = time_per_frame(&frames, 0.0, Some(33.3)).expect("two frames");
        assert!(text.contains("sensor rate 33.3 ms"), "near");
        let text = time_per_frame(&frames, 0.0, Some(1000.0)).expect("two frames");
        assert!(!text.contains("sensor rate"), "far");
        let bad = [frame(f64::NAN, 1.0, false)];
        assert!(time_per_frame(&bad, 0.0, None).is_err(), "time");
        let still = [frame(5.0, 0.0, false)];
        assert!(
            time_per_frame(&still, 5.0, None).is_ok(),
            "one frame, no time"
        );
    }
}
