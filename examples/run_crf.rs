//! Which of these points move? A wall, a person in front of it, and the word of one point in six is
//! false: what the random field makes of them (chapter 7 of the book).
//!
//! `cargo run --release --example run_crf`
#![allow(clippy::print_stdout, reason = "an example speaks to its reader")]

use std::error::Error;

use garad::core::{Label, Par, Rng};
use garad::crf::{Crf, Node};
use garad::slam::Config;
use nalgebra::{Vector2, Vector3};

const COLUMNS: usize = 40;
const ROWS: usize = 14;
/// What a point says of itself: ln(P(moves) / P(rests)) is this, or minus this.
const SURENESS: f64 = 2.0;

fn main() -> Result<(), Box<dyn Error>> {
    let mut rng = Rng::new(1);
    let (mut nodes, mut log_odds, mut truth) = (Vec::new(), Vec::new(), Vec::new());
    for row in 0..ROWS {
        for column in 0..COLUMNS {
            let moves = (14..24).contains(&column) && row >= 3;
            let depth_m = if moves { 1.5 } else { 3.0 };
            let uv_px = Vector2::new(column as f64, row as f64) * 16.0;
            let ray = Vector3::new((uv_px.x - 320.0) / 525.0, (uv_px.y - 112.0) / 525.0, 1.0);
            nodes.push(Node {
                p_world: ray * depth_m,
                uv_px: Some(uv_px),
                ..Node::default()
            });
            let says_moves = moves != (rng.below(6) == 0);
            log_odds.push(if says_moves { SURENESS } else { -SURENESS });
            truth.push(moves);
        }
    }
    // The pipeline's field: neighbours can add at most 3 to a log-odds, so they outvote a 2.
    let field = Crf::new(Config::default().crf)?;
    let beliefs = field.infer_from_log_odds(&nodes, &log_odds, Par::Seq)?;

    let alone: Vec<bool> = log_odds.iter().map(|u| *u > 0.0).collect();
    let together: Vec<bool> = (beliefs.labels.iter())
        .map(|label| *label == Label::Dynamic)
        .collect();
    let wrong = |labels: &[bool]| labels.iter().zip(&truth).filter(|(a, b)| a != b).count();
    println!("alone, {} of {} are wrong:", wrong(&alone), nodes.len());
    print(&alone);
    println!("after asking the neighbours, {} are:", wrong(&together));
    print(&together);
    println!(
        "all pairs would give the same beliefs to {:.0e}",
        beliefs.error_bound
    );
    Ok(())
}

fn print(labels: &[bool]) {
    for row in labels.chunks(COLUMNS) {
        let marks = row.iter().map(|&moves| if moves { '#' } else { '.' });
        println!("  {}", marks.collect::<String>());
    }
}
