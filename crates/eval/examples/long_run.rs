//! Time and memory of a long run, frame by frame, as a plot.
//!
//! ```text
//! cargo run --release -p garad-eval --example long_run -- OUT/frames.csv long_run.svg
//! ```
//!
//! `frames.csv` is written by `garad run`. The dark line is the processor time of all threads, a mean of 50
//! frames, which does not depend on the load of the machine. The grey line is the wall time of tracking, a
//! median of 50 frames, which does.

use std::error::Error;
use std::fs;

use plotters::prelude::*;

/// Frames per point.
const GROUP: usize = 50;
const SIZE: (u32, u32) = (860, 560);
const INK: RGBColor = RGBColor(30, 60, 110);
const PALE: RGBColor = RGBColor(160, 165, 175);

/// Tracking (ms), memory (MiB) and processor time since the start (ms) of a frame.
type Cost = [f64; 3];

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(csv), Some(svg)) = (arguments.next(), arguments.next()) else {
        return Err("expected: long_run COSTS.csv PLOT.svg".into());
    };
    let costs = read(&fs::read_to_string(&csv)?).map_err(|line| {
        let expected = "frame,tracking_ms,waiting_ms,resident_mib,processor_ms";
        format!("{csv}:{line}: expected {expected}")
    })?;
    let groups: Vec<&[Cost]> = costs.chunks(GROUP).collect();
    let at = |i: usize| (i * GROUP + GROUP / 2) as f64;
    let medians = |of: usize| -> Vec<(f64, f64)> {
        let medians = groups
            .iter()
            .map(|g| median(g.iter().map(|c| c[of]).collect()));
        medians.enumerate().map(|(i, m)| (at(i), m)).collect()
    };
    let last_of_groups = groups.iter().filter_map(|g| g.last()).map(|c| c[2]);
    let mut before = 0.0;
    let processor = last_of_groups
        .zip(&groups)
        .enumerate()
        .map(|(i, (now, group))| {
            let mean = (now - before) / group.len() as f64;
            before = now;
            (at(i), mean)
        });
    let processor: Vec<_> = processor.collect();
    let canvas = SVGBackend::new(&svg, SIZE).into_drawing_area();
    canvas.fill(&WHITE)?;
    let halves = canvas.split_evenly((2, 1));
    let frames = costs.len() as f64;
    let times = [(medians(0), PALE), (processor, INK)];
    draw(&halves[0], "time per frame, ms", frames, &times)?;
    let memory = [(medians(1), INK)];
    draw(&halves[1], "memory in use, MiB", frames, &memory)?;
    canvas.present()?;
    Ok(())
}

/// The rows, or the number of the first line that is none.
fn read(text: &str) -> Result<Vec<Cost>, usize> {
    let rows = text.lines().enumerate().skip(1);
    rows.map(|(i, line)| {
        let costs: Vec<f64> = line.split(',').skip(7).flat_map(str::parse).collect();
        match costs[..] {
            [tracking, _, memory, processor] => Ok([tracking, memory, processor]),
            _ => Err(i + 1),
        }
    })
    .collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values[(values.len() - 1) / 2]
}

fn draw(
    area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    what: &str,
    frames: f64,
    lines: &[(Vec<(f64, f64)>, RGBColor)],
) -> Result<(), Box<dyn Error>> {
    let points = lines.iter().flat_map(|(points, _)| points);
    let most = points.map(|p| p.1).fold(1.0, f64::max);
    let mut chart = ChartBuilder::on(area)
        .margin(14)
        .x_label_area_size(36)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..frames, 0.0..1.1 * most)?;
    chart
        .configure_mesh()
        .x_desc("frame")
        .y_desc(what)
        .light_line_style(TRANSPARENT)
        .bold_line_style(PALE.mix(0.4))
        .draw()?;
    for (points, color) in lines {
        chart.draw_series(LineSeries::new(
            points.iter().copied(),
            color.stroke_width(2),
        ))?;
    }
    Ok(())
}
