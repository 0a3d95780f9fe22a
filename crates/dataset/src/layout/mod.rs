//! [`Layout`]: how the files of a recording are arranged, one file per arrangement.
//!
//! | layout | recognised by | camera | times | truth |
//! |---|---|---|---|---|
//! | [`tum`] | `rgb.txt` and `depth.txt` | – | listed | `groundtruth.txt` |
//! | [`associations`] | `associations.txt` | ICL-NUIM's, by its truth | listed, or frame numbers | `groundtruth.txt`, `*.gt.freiburg` |
//! | [`replica`] | `results/frame*` and `results/depth*` | `cam_params.json` | number / fps | `traj.txt` |
//! | [`scannet`] | `color/`, `depth/`, `pose/` or `intrinsic/` | `intrinsic/` | number / fps | `pose/N.txt` |
//! | [`seven_scenes`] | `*.color.png` | 585 px, 640x480 | number / fps | `*.pose.txt` |
//! | [`nerfstudio`] | `transforms.json` | in it | index / fps | in it |
//! | [`open3d`] | `color/` or `image/`, `depth/` | `camera_intrinsic.json` | number / fps | `trajectory.log` |
//!
//! The first one that a folder matches is taken. A folder's camera counts only where neither the options nor a
//! `camera.txt` give one, see [`crate::Dataset::open`].

mod associations;
mod find;
mod intrinsics;
mod nerfstudio;
mod open3d;
mod pose;
mod replica;
mod scannet;
mod series;
mod seven_scenes;
mod tum;

use std::fmt::Debug;
use std::path::Path;

use garad_core::{Se3, StampedPose};

pub(crate) use self::intrinsics::scale_to;
use crate::calibration::Calibration;
use crate::errors::DatasetError;
use crate::list::Entry;
use crate::options::OpenOptions;
use crate::source::Source;

/// All layouts, in the order in which they are tried.
pub(crate) const ALL: [&dyn Layout; 7] = [
    &tum::Tum,
    &associations::Associations,
    &replica::Replica,
    &scannet::ScanNet,
    &seven_scenes::SevenScenes,
    &nerfstudio::Nerfstudio,
    &open3d::Open3d,
];

/// Poses that cannot be read and are named one by one.
const POSES_NAMED: usize = 3;

/// Colour and depth image of one frame.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Pair {
    pub(crate) colour: Entry,
    pub(crate) depth: Entry,
    /// Number of the frame in its layout, by which it finds its pose.
    pub(crate) number: usize,
}

/// What a layout reads from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Context<'a> {
    pub(crate) path: &'a Path,
    pub(crate) source: &'a Source,
    pub(crate) options: &'a OpenOptions,
    /// Frames per second of the calibration, for frames without time stamps.
    pub(crate) fps: f64,
}

/// What reading a recording has to say beside its frames, one sentence each.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Remarks {
    /// What was found odd.
    pub(crate) warnings: Vec<String>,
    /// What was assumed.
    pub(crate) notes: Vec<String>,
    /// Listed colour images that are no frame.
    pub(crate) unpaired: Unpaired,
}

/// Listed colour images without a depth image of their own.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Unpaired {
    /// What they lack.
    pub(crate) why: String,
    /// Their times, seconds, ascending.
    pub(crate) times_s: Vec<f64>,
}

/// Pose of a frame, by its number: `None` where the recording marks it as lost.
pub(crate) type NumberedPose = (usize, Result<Option<Se3>, DatasetError>);

/// One arrangement of files.
pub(crate) trait Layout: Debug + Sync {
    /// Its name, for messages.
    fn name(&self) -> &'static str;

    /// The lists or folders that name colour and depth images, for messages.
    fn lists(&self) -> [&'static str; 2];

    /// The file its camera is read from, for messages; empty if there is none.
    fn camera_file(&self) -> &'static str {
        ""
    }

    /// Whether a recording has this layout.
    fn matches(&self, source: &Source) -> bool;

    /// The camera it describes, if it does.
    fn calibration(&self, _source: &Source) -> Result<Option<Calibration>, DatasetError> {
        Ok(None)
    }

    /// All frames in ascending order of time, at least one.
    fn pairs(
        &self,
        context: &Context<'_>,
        remarks: &mut Remarks,
    ) -> Result<Vec<Pair>, DatasetError>;

    /// The poses of these frames, `world_from_camera`, in their order; empty without any.
    fn poses(
        &self,
        _context: &Context<'_>,
        _pairs: &[Pair],
    ) -> Result<Vec<NumberedPose>, DatasetError> {
        Ok(Vec::new())
    }

    /// The true trajectory. It only judges: without `strict`, what cannot be read is a warning.
    fn truth(
        &self,
        context: &Context<'_>,
        pairs: &[Pair],
        remarks: &mut Remarks,
    ) -> Result<Option<Vec<StampedPose>>, DatasetError> {
        truth_by_number(self.poses(context, pairs), context, pairs, remarks)
    }

    /// Whether a colour image larger than its depth image is scaled down to it.
    fn scales_colour(&self) -> bool {
        true
    }
}

/// The layout of a recording; `None` if it has none of them.
pub(crate) fn detect(source: &Source) -> Option<&'static dyn Layout> {
    ALL.into_iter().find(|layout| layout.matches(source))
}

/// Gives the poses the times of their frames.
fn truth_by_number(
    poses: Result<Vec<NumberedPose>, DatasetError>,
    context: &Context<'_>,
    pairs: &[Pair],
    remarks: &mut Remarks,
) -> Result<Option<Vec<StampedPose>>, DatasetError> {
    let strict = context.options.strict;
    let poses = match poses {
        Err(error) if strict => return Err(error),
        Err(error) => {
            let warning = format!("{error}; the path is not judged");
            remarks.warnings.push(warning);
            return Ok(None);
        }
        Ok(poses) => poses,
    };
    let mut poses = poses.into_iter().peekable();
    let (mut truth, mut lost, mut bad) = (Vec::new(), 0, 0);
    for pair in pairs {
        while poses.next_if(|(number, _)| *number < pair.number).is_some() {}
        match poses.next_if(|(number, _)| *number == pair.number) {
            None => {}
            Some((_, Ok(Some(world_from_camera)))) => truth.push(StampedPose {
                t_s: pair.colour.t_s,
                world_from_camera,
            }),
            Some((_, Ok(None))) => lost += 1,
            Some((_, Err(error))) if strict => return Err(error),
            Some((_, Err(error))) => {
                bad += 1;
                if bad <= POSES_NAMED {
                    let warning = format!("{error}; the pose is left out");
                    remarks.warnings.push(warning);
                }
            }
        }
    }
    let frames = pairs.len();
    if bad > POSES_NAMED {
        let more = bad - POSES_NAMED;
        remarks.warnings.push(format!("{more} more poses left out"));
    }
    if lost > 0 {
        let note = format!("{lost} of {frames} frames are marked as lost: no true pose there");
        remarks.notes.push(note);
    }
    Ok(Some(truth).filter(|truth| !truth.is_empty()))
}

#[cfg(test)]
mod tests {
    use super::ALL;

    #[test]
    fn messages_name_every_layout() {
        for layout in ALL {
            let name = format!("({})", layout.name());
            assert!(crate::errors::LAYOUTS.contains(&name), "{name}");
        }
    }
}
