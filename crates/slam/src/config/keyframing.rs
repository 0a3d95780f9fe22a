//! Keyframes, landmarks, local bundle adjustment, loops and culling.

use garad_optim::LinearSolver;
use serde::{Deserialize, Serialize};

/// When a frame becomes a keyframe, and which landmarks it makes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyframeConfig {
    /// Keypoints the first frame needs.
    pub first_min_keypoints: usize,
    /// Fewer inliers than this share of the most that a frame since the last keyframe had: new
    /// keyframe. See decision 016.
    pub tracked_share: f64,
    /// A frame with fewer inliers than this is too weak to become one.
    pub min_inliers: usize,
    /// At most this many frames between two keyframes (ORB-SLAM: a second's worth); see decision 003.
    pub max_gap: usize,
    /// At least this many frames between two keyframes.
    pub min_gap: usize,
    /// Landmarks nearer than this are made at once, metres. ORB-SLAM takes 40 baselines, about 3 m;
    /// see decision 003.
    pub close_m: f64,
    /// Fewer tracked close points than this, while ...
    pub close_tracked_min: usize,
    /// ... more untracked close points than this: new keyframe.
    pub close_untracked_min: usize,
    /// At least this many landmarks per keyframe, nearest first.
    pub min_new_landmarks: usize,
    /// A landmark found in less than this share of the frames that should see it is dropped.
    pub found_ratio: f64,
    /// Observing keyframes a landmark needs two keyframes after its birth.
    pub min_observations: usize,
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self {
            first_min_keypoints: 100,
            tracked_share: 0.67,
            min_inliers: 15,
            max_gap: 10,
            min_gap: 3,
            close_m: 6.0,
            close_tracked_min: 100,
            close_untracked_min: 70,
            min_new_landmarks: 100,
            found_ratio: 0.25,
            min_observations: 2,
        }
    }
}

/// Landmarks from two views, for keypoints without depth (decision 018).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TwoViewConfig {
    /// Off: every landmark comes from a depth reading.
    pub enabled: bool,
    /// Keyframes that a new one is matched with, most covisible first.
    pub neighbours: usize,
    /// Largest distance from the image of the other keypoint's ray, px at level 0.
    pub radius_px: f64,
    /// Largest Hamming distance of the two descriptors.
    pub match_distance: u32,
    /// Least inverse depth, in its standard deviations.
    pub min_inverse_depth_sigmas: f64,
}

impl Default for TwoViewConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            neighbours: 10,
            radius_px: 2.0,
            match_distance: 50,
            min_inverse_depth_sigmas: 4.0,
        }
    }
}

/// Local bundle adjustment after each keyframe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalBaConfig {
    /// Off: keyframe poses stay as tracked.
    pub enabled: bool,
    /// LM iterations.
    pub iterations: usize,
    /// Keyframes whose poses are free at most, nearest in covisibility first.
    pub max_free: usize,
    /// Keyframes that see the same landmarks and stay fixed at most.
    pub max_fixed: usize,
}

impl Default for LocalBaConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            iterations: 10,
            max_free: 10,
            max_fixed: 20,
        }
    }
}

/// When a place counts as revisited, and how the path is corrected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LoopConfig {
    /// Off: no loop is closed.
    pub enabled: bool,
    /// Keyframes younger than this are no candidates, and so many keyframes pass between two loops.
    pub min_gap: u32,
    /// Two keyframes that share so many landmarks are neighbours.
    pub neighbour_landmarks: usize,
    /// Keyframes in a row that must resemble one place.
    pub in_a_row: usize,
    /// Older keyframes tried for each new one.
    pub candidates: usize,
    /// Landmarks of the place that must agree with one pose of the new keyframe.
    pub min_inliers: usize,
    /// Largest plausible drift: a share of the path length since, ...
    pub max_drift: f64,
    /// ... plus this, metres.
    pub max_drift_floor_m: f64,
    /// Iterations of the global bundle adjustment afterwards; 0: none.
    pub bundle_iterations: usize,
    /// Of the pose graph and the global bundle adjustment (decision 017): "portable", or "faer", which is
    /// faster from some hundred keyframes on and whose last bits depend on the processor. Local bundles
    /// are always solved by the portable one.
    pub linear_solver: LinearSolver,
}

impl Default for LoopConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            min_gap: 10,
            neighbour_landmarks: 15,
            in_a_row: 3,
            candidates: 10,
            min_inliers: 40,
            max_drift: 0.05,
            max_drift_floor_m: 0.2,
            bundle_iterations: 10,
            linear_solver: LinearSolver::Portable,
        }
    }
}

/// Which keyframes are culled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CullingConfig {
    /// Off: every keyframe stays.
    pub enabled: bool,
    /// Share of a keyframe's near landmarks that others must observe, too. Lower: fewer keyframes stay.
    pub redundant_share: f64,
    /// Number of those others.
    pub observers: usize,
    /// This many of the youngest keyframes always stay.
    pub keep_youngest: u32,
}

impl Default for CullingConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            redundant_share: 0.9,
            observers: 3,
            keep_youngest: 10,
        }
    }
}
