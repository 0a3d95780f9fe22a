//! [`STAGES`]: what is tested, in the order of the data, and which stage rests on which.
//!
//! Where two stages disagree with the expected values, the earlier one is the one to look at:
//! a renderer with a wrong projection has wrong gradients, too.

/// A stage of the pipeline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stage {
    /// Name of its folder under `tests/golden`.
    pub name: &'static str,
    /// The part of the method it belongs to, see [`PARTS`].
    pub part: &'static str,
    /// Stages whose results it takes, or whose formulas it contains.
    pub needs: &'static [&'static str],
    /// What goes in and what comes out.
    pub about: &'static str,
}

const fn stage(
    name: &'static str,
    part: &'static str,
    needs: &'static [&'static str],
    about: &'static str,
) -> Stage {
    Stage {
        name,
        part,
        needs,
        about,
    }
}

/// Every stage, earlier ones first.
#[rustfmt::skip]
pub const STAGES: &[Stage] = &[
    stage("decode", "recordings", &[], "a frame of a recording, as OpenCV reads it"),
    stage("associate", "recordings", &[], "two lists of times to pairs"),
    stage("bonn", "recordings", &[], "motion-capture poses to camera poses"),
    stage("ply", "recordings", &[], "a map in the layout of 3D Gaussian Splatting"),
    stage("se3", "se3", &[], "exp, log, Jacobians, adjoint"),
    stage("camera", "camera and distortion", &[], "projection, lens, its inverse"),
    stage("undistort", "camera and distortion", &["camera"], "images without their lens distortion"),
    stage("pyramid", "pyramid", &[], "halved images, blur, derivatives"),
    stage("fast", "fast", &[], "corners of FAST-9/16 with score, non-maximum suppression"),
    stage("orb", "orb", &["fast", "pyramid"], "keypoints over 8 levels, angles, descriptors"),
    stage("matching", "matching", &[], "nearest and second nearest in Hamming distance"),
    stage("lk", "lk", &["pyramid"], "where points of one image are in the next"),
    stage("epipolar", "flow test", &["se3", "camera"], "fundamental matrix, distances to epipolar lines"),
    stage("flow", "flow test", &[], "mean and covariance of static flow, chi-square gate"),
    stage("robust", "pose lm", &[], "robust kernels and their weights"),
    stage("reprojection", "pose lm", &["se3", "camera"], "residuals and Jacobians"),
    stage("place", "relocalisation", &["orb"], "descriptors to words, and images that share them"),
    stage("pnp", "relocalisation", &["se3", "camera"], "the pose from points and their pixels alone"),
    stage("pose_lm", "pose lm", &["se3", "reprojection", "robust"], "the pose with the least cost"),
    stage("landmark_links", "matching", &["se3", "camera", "matching"], "keypoints to the landmarks that project near them"),
    stage("keyframe", "keyframes", &[], "whether a tracked frame becomes a keyframe"),
    stage("bundle", "bundle adjustment", &["se3", "reprojection", "robust"], "poses and points with the least cost"),
    stage("pose_graph", "pose graph", &["se3"], "poses that agree best with their relations"),
    stage("free_space", "cues and unary", &["se3", "camera"], "points against the depth images of other times: in front, on, behind"),
    stage("cues", "cues and unary", &["reprojection", "epipolar", "free_space"], "keyframes that observe a landmark to its four cues"),
    stage("unary", "cues and unary", &[], "four cues to the probability of being static"),
    stage("kernel", "mean field", &[], "the two pairwise kernels"),
    stage("mean_field", "mean field", &["unary", "kernel"], "marginals after each iteration"),
    stage("label_window", "label window", &[], "labels of the last runs to what is removed"),
    stage("relabel", "label window", &["free_space", "label_window"], "labels of Gaussians from their landmarks and from free space"),
    stage("sh", "sh", &[], "basis functions, their gradient, colour towards a direction"),
    stage("projection_covariance", "projection and covariance", &[], "3D Gaussian to centre, covariance, conic, radius"),
    stage("raster", "forward", &["projection_covariance", "sh"], "images of a map"),
    stage("raster_backward", "backward", &["projection_covariance", "sh", "raster"], "gradients by every parameter and by the pose"),
    stage("losses", "l1/ssim and gradients", &[], "L1, SSIM, their mix, depth, opacity penalty, with gradients"),
    stage("knn_scale", "initial scales", &[], "points to the scales of new Gaussians, by three neighbours each"),
    stage("adam", "adam", &[], "parameters after every step"),
    stage("sgd", "adam", &[], "parameters after every step of plain gradient descent"),
    stage("image_pyramid", "pyramid", &["undistort"], "the targets of training: colour, depth and mask at each level"),
    stage("densify", "density control", &[], "Gaussians that are cloned, split, too large or faded, and their children"),
    stage("train_step", "one training iteration", &["raster", "raster_backward", "losses", "adam"], "a map after one iteration"),
    stage("train_run", "a training run", &["label_window", "adam", "densify"], "sixty iterations over a growing map: views, levels, rates, labels, clones, splits, pruning, and the state of every Gaussian"),
    stage("trajectory", "judging", &["associate"], "alignment, ATE, RPE"),
    stage("image_metrics", "judging", &[], "PSNR and SSIM"),
    stage("trace", "trace of several frames", &["orb", "flow", "pose_lm", "bundle", "mean_field", "train_step"],
        "all stages over three frames, each with its inputs and outputs; see `garad trace diff`"),
];

/// Parts of the method that must have cases.
pub const PARTS: &[&str] = &[
    "se3",
    "camera and distortion",
    "pyramid",
    "fast",
    "orb",
    "matching",
    "lk",
    "flow test",
    "pose lm",
    "bundle adjustment",
    "cues and unary",
    "mean field",
    "label window",
    "projection and covariance",
    "sh",
    "forward",
    "backward",
    "l1/ssim and gradients",
    "adam",
    "keyframes",
    "density control",
    "one training iteration",
    "a training run",
    "trace of several frames",
];

/// The entry of a stage.
#[must_use]
pub fn find(name: &str) -> Option<&'static Stage> {
    STAGES.iter().find(|stage| stage.name == name)
}

/// Position in the order of the data; unknown stages come last.
#[must_use]
pub fn rank(name: &str) -> usize {
    let known = STAGES.iter().position(|stage| stage.name == name);
    known.unwrap_or(STAGES.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_needs_earlier_ones_only() {
        for (i, stage) in STAGES.iter().enumerate() {
            assert_eq!(rank(stage.name), i, "{} stands twice", stage.name);
            for need in stage.needs {
                assert!(rank(need) < i, "{} before {need}", stage.name);
            }
        }
        assert_eq!(rank("nowhere"), STAGES.len(), "unknown");
    }

    #[test]
    fn every_part_has_a_stage() {
        for part in PARTS {
            let staged = STAGES.iter().any(|stage| stage.part == *part);
            assert!(staged, "{part}: no stage");
        }
    }
}
