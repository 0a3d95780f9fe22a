//! Cost of long runs, frame by frame: one plot of all runs, and a table of their beginning and end.
//!
//! ```text
//! cargo run --release -p garad-eval --example long_run -- loop/frames.csv desk/frames.csv long_runs.svg
//! ```
//!
//! `frames.csv` is written by `garad run`; a run has the name of its folder. Processor time is that of all threads, the
//! mean of the last 100 frames, and does not depend on the load of the machine.
#![allow(clippy::print_stdout, reason = "an example speaks to its reader")]

use std::error::Error;
use std::fs;
use std::path::Path;

use plotters::prelude::*;

/// Frames of the running mean.
const MEAN_OF: usize = 100;
/// Frames between two points of a line.
const STEP: usize = 25;
/// Frames of the table: the second half of the first thousand against as many at the end.
const EARLY: [usize; 2] = [500, 1000];
const SIZE: (u32, u32) = (860, 780);
const COLORS: [RGBColor; 4] = [
    RGBColor(30, 60, 110),
    RGBColor(190, 90, 20),
    RGBColor(40, 120, 70),
    RGBColor(120, 120, 125),
];
const PANELS: [&str; 3] = [
    "processor time per frame, ms",
    "resident memory, MiB",
    "keyframes made",
];

/// A run's name, and of every frame: processor time since the start (ms), memory (MiB), keyframes so far.
struct Run {
    name: String,
    frames: Vec<[f64; 3]>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut paths: Vec<String> = std::env::args().skip(1).collect();
    let svg = paths.pop().filter(|svg| svg.ends_with(".svg"));
    let (Some(svg), false) = (svg, paths.is_empty()) else {
        return Err("expected: long_run RUN/frames.csv ... PLOT.svg".into());
    };
    let mut runs = Vec::new();
    for csv in &paths {
        let folder = Path::new(csv).parent().and_then(Path::file_name);
        let frames = read(&fs::read_to_string(csv)?)
            .map_err(|line| format!("{csv}:{line}: expected a line as `garad run` writes it"))?;
        runs.push(Run {
            name: folder.map_or_else(|| csv.clone(), |name| name.to_string_lossy().into()),
            frames,
        });
    }
    print!("{}", table(&runs));
    let canvas = SVGBackend::new(&svg, SIZE).into_drawing_area();
    canvas.fill(&WHITE)?;
    for (of, panel) in canvas.split_evenly((PANELS.len(), 1)).iter().enumerate() {
        draw(panel, of, &runs)?;
    }
    canvas.present()?;
    Ok(())
}

/// The frames, or the number of the first line that is none.
fn read(text: &str) -> Result<Vec<[f64; 3]>, usize> {
    let mut keyframes = 0.0;
    let rows = text.lines().enumerate().skip(1);
    rows.map(|(i, line)| {
        let fields: Vec<&str> = line.split(',').collect();
        let [_, _, _, _, _, _, keyframe, _, _, memory, processor] = fields[..] else {
            return Err(i + 1);
        };
        keyframes += f64::from(u8::from(!keyframe.is_empty()));
        let number = |field: &str| field.parse::<f64>().map_err(|_| i + 1);
        Ok([number(processor)?, number(memory)?, keyframes])
    })
    .collect()
}

impl Run {
    /// Processor time per frame, mean of frames `from..to`, ms.
    fn processor(&self, from: usize, to: usize) -> f64 {
        (self.frames[to - 1][0] - self.frames[from - 1][0]) / (to - from) as f64
    }

    /// One of [`PANELS`], every [`STEP`] frames.
    fn line(&self, of: usize) -> Vec<(f64, f64)> {
        let at = (MEAN_OF + 1..=self.frames.len()).step_by(STEP);
        let value = |i: usize| match of {
            0 => self.processor(i - MEAN_OF, i),
            _ => self.frames[i - 1][of],
        };
        at.map(|i| (i as f64, value(i))).collect()
    }
}

/// Processor time, memory and keyframes early and at the end, in Markdown.
fn table(runs: &[Run]) -> String {
    let mut text = String::from(
        "| run | frames | processor time a frame [ms] | resident memory [MiB] | keyframes made |\n|---|---|---|---|---|\n",
    );
    for run in runs {
        let [from, to] = EARLY;
        let last = run.frames.len();
        for [from, to] in [[from, to], [last.saturating_sub(to - from).max(1), last]] {
            if to <= last {
                let [_, memory, keyframes] = run.frames[to - 1];
                let processor = run.processor(from, to);
                text += &format!(
                    "| {} | {from} to {} | {processor:.1} | {memory:.0} | {keyframes:.0} |\n",
                    run.name,
                    to - 1
                );
            }
        }
    }
    text
}

fn draw(
    area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    of: usize,
    runs: &[Run],
) -> Result<(), Box<dyn Error>> {
    let frames = runs.iter().map(|run| run.frames.len()).max().unwrap_or(1);
    let lines: Vec<_> = runs.iter().map(|run| run.line(of)).collect();
    let most = lines.iter().flatten().map(|p| p.1).fold(1.0, f64::max);
    let mut chart = ChartBuilder::on(area)
        .margin(10)
        .x_label_area_size(34)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..frames as f64, 0.0..1.1 * most)?;
    chart
        .configure_mesh()
        .x_desc("frame")
        .y_desc(PANELS[of])
        .x_label_formatter(&|x| format!("{x:.0}"))
        .y_label_formatter(&|y| format!("{y:.0}"))
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12))
        .draw()?;
    for ((run, points), color) in runs.iter().zip(lines).zip(COLORS.iter().cycle()) {
        chart
            .draw_series(LineSeries::new(points, color.stroke_width(2)))?
            .label(run.name.clone())
            .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .background_style(WHITE.mix(0.8))
        .draw()?;
    Ok(())
}
