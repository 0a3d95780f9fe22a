//! Two frames of a real recording, and the motion of the camera between them: keypoints, matches,
//! depth, pose (chapters 2, 3 and 6 of the book). The truth is that of the motion-capture system.
//!
//! `cargo run --release --example track_two_frames`
#![allow(
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "an example speaks to its reader; keypoints lie inside the picture"
)]

use std::error::Error;
use std::path::Path;

use garad::core::{Par, Se3};
use garad::dataset::{Dataset, OpenOptions};
use garad::eval::{MAX_DT_S, nearest_in_time};
use garad::features::matching::match_descriptors;
use garad::features::{MatchConfig, OrbConfig, OrbExtractor};
use garad::optim::{PoseConfig, PoseObservation, optimise_pose};
use nalgebra::Vector2;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/tum_fr1_desk_9");
    let recording = Dataset::open(&folder, &OpenOptions::default())?;
    let camera = recording.calibration().camera;
    let (first, second) = (recording.read(0)?, recording.read(4)?);

    let mut orb = OrbExtractor::new(OrbConfig::default())?;
    let a = orb.extract(&first.rgb.to_gray(), Par::Seq)?;
    let b = orb.extract(&second.rgb.to_gray(), Par::Seq)?;
    let gates = MatchConfig::default();
    let matches = match_descriptors(&a.descriptors, &b.descriptors, &gates, Par::Seq);

    // Points in the first camera, which is the world here, and where the second camera sees them.
    let mut observations = Vec::new();
    for found in &matches {
        let (from, to) = (&a.keypoints[found.query], &b.keypoints[found.train]);
        let [from_px, to_px] = [from, to].map(|k| Vector2::new(k.x, k.y).map(f64::from));
        let pixel = from_px.map(|v| (v + 0.5) as usize);
        let depth_m = f64::from(first.depth[(pixel.x, pixel.y)]);
        let ideal = (camera.undistort_pixel(&from_px)).zip(camera.undistort_pixel(&to_px));
        if let Some((from_px, uv_px)) = ideal.filter(|_| depth_m > 0.0) {
            observations.push(PoseObservation {
                p_world: camera.unproject(&from_px, depth_m),
                uv_px,
                sigma_px: f64::from(orb.level_scale(to.level)),
                depth: None,
            });
        }
    }
    let start = Se3::identity();
    let solved = optimise_pose(&camera, &observations, &start, &PoseConfig::default())?;

    let truth = recording.ground_truth().unwrap_or_default();
    let at = |t_s: f64| Some(truth[nearest_in_time(truth, t_s, MAX_DT_S)?].world_from_camera);
    let (Some(before), Some(after)) = (at(first.t_s), at(second.t_s)) else {
        return Err("the recording has no true pose for these frames".into());
    };
    let motion = before.inverse() * after;
    let error = solved.camera_from_world * motion;
    let (n_a, n_b, n) = (a.keypoints.len(), b.keypoints.len(), matches.len());
    println!("{n_a} and {n_b} keypoints, {n} matches");
    let with_depth = observations.len();
    println!("{with_depth} with depth, {} inliers", solved.n_inliers);
    println!("the camera moved {:.1} mm", 1e3 * motion.translation.norm());
    println!(
        "the pose is off by {:.1} mm",
        1e3 * error.translation.norm()
    );
    println!("and {:.2} degrees", error.rotation.angle_rad().to_degrees());
    Ok(())
}
