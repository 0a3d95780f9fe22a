//! One list of pairs, `associations.txt`, lines `time file time file`: ICL-NUIM has depth first, ORB-SLAM colour.
//!
//! Which column is depth is decided by the first files (a 16-bit grey PNG is depth), otherwise by their names.
//!
//! Where all times are whole numbers below a million they are frame numbers: those of ICL-NUIM, 1, 2, 3, ... Frames are then
//! at (number - first number) / fps, and so are the poses of a truth with such numbers.
//!
//! # ICL-NUIM
//! Its page gives fx fy cx cy = 481.20 -480.00 319.50 239.50 for a renderer whose y axis points up. The images of the TUM
//! compatible archives have rows from the top, so the camera is 481.20 480.00 319.50 239.50, depth factor 5000, and the poses of
//! `livingRoom*.gt.freiburg` are reflected about the xz plane: t = F t', R = F R' F with F = diag(1, -1, 1).

use garad_core::camera::Distortion;
use garad_core::{Camera, Se3, So3, StampedPose};
use nalgebra::Vector3;

use super::{Context, Layout, Pair, Remarks, intrinsics, tum};
use crate::calibration::Calibration;
use crate::decode::{Origin, is_depth};
use crate::errors::{DatasetError, excerpt};
use crate::list::{Entry, parse_entries, parse_line};
use crate::source::Source;
use crate::text::Place;

const NAMES: [&str; 4] = [
    "associations.txt",
    "association.txt",
    "associate.txt",
    "associated.txt",
];
const ICL_TRUTH: &str = ".gt.freiburg";
const ICL_DEPTH_FACTOR: f64 = 5000.0;
/// Whole times below this are frame numbers.
const LARGEST_NUMBER: f64 = 1e6;

#[derive(Debug)]
pub(super) struct Associations;

fn name_in(source: &Source) -> Option<&'static str> {
    NAMES.into_iter().find(|name| source.has_file(name))
}

fn icl_truth(source: &Source) -> Option<String> {
    let mut names = source.files_in("").into_iter();
    names.find(|name| name.ends_with(ICL_TRUTH))
}

impl Layout for Associations {
    fn name(&self) -> &'static str {
        "ICL-NUIM or ORB-SLAM"
    }

    fn lists(&self) -> [&'static str; 2] {
        [NAMES[0]; 2]
    }

    fn matches(&self, source: &Source) -> bool {
        name_in(source).is_some()
    }

    /// ICL-NUIM's, where its truth is.
    fn calibration(&self, source: &Source) -> Result<Option<Calibration>, DatasetError> {
        let Some(truth) = icl_truth(source) else {
            return Ok(None);
        };
        let camera = Camera {
            width: 640,
            height: 480,
            fx: 481.20,
            fy: 480.0,
            cx: 319.5,
            cy: 239.5,
            distortion: Distortion::default(),
        };
        let path = source.locate(&truth);
        let mut known = intrinsics::calibration(&path, camera, ICL_DEPTH_FACTOR)?;
        known.source = format!("ICL-NUIM's page, for {truth}");
        Ok(Some(known))
    }

    fn pairs(
        &self,
        context: &Context<'_>,
        remarks: &mut Remarks,
    ) -> Result<Vec<Pair>, DatasetError> {
        let Context {
            path,
            source,
            options,
            ..
        } = *context;
        let unreadable = || DatasetError::NotARecording {
            path: path.to_path_buf(),
            found: "no readable associations.txt".to_owned(),
        };
        let name = name_in(source).ok_or_else(unreadable)?;
        let bytes = source.read(name)?.ok_or_else(unreadable)?;
        let list = source.locate(name);
        let mut columns: [Vec<Entry>; 2] = [Vec::new(), Vec::new()];
        parse_entries(&list, &bytes, false, &mut Vec::new(), |place, text| {
            let both = parse_pair(place, text)?;
            let first = both[0].clone();
            for (column, entry) in columns.iter_mut().zip(both) {
                column.push(entry);
            }
            Ok(first)
        })?;
        if depth_is_first(source, &columns)? {
            columns.reverse();
            let note = format!("{name}: depth is in its first column, colour in its second");
            remarks.notes.push(note);
        }
        let [colours, depths] = columns;
        let mut in_order = colours.iter().cloned();
        let warnings = &mut remarks.warnings;
        let sorted = parse_entries(&list, &bytes, options.strict, warnings, |place, text| {
            // The lines are those of the first pass.
            in_order
                .next()
                .ok_or_else(|| place.error(excerpt(text), PAIR))
        })?;
        let mut depths = depths;
        depths.sort_by_key(|entry| entry.line);
        let pair = |colour: Entry| {
            let at = depths.partition_point(|depth| depth.line < colour.line);
            let mut depth = depths[at].clone();
            depth.t_s += options.depth_offset_s;
            Pair {
                colour,
                depth,
                number: at,
            }
        };
        let mut pairs: Vec<Pair> = sorted.into_iter().map(pair).collect();
        if let Some(first) = first_number(&pairs) {
            let seconds = |t_s: f64| (t_s - first) / context.fps;
            for Pair { colour, depth, .. } in &mut pairs {
                let offset_s = options.depth_offset_s;
                depth.t_s = seconds(depth.t_s - offset_s) + offset_s;
                colour.t_s = seconds(colour.t_s);
            }
            remarks.notes.push(format!(
                "{name}: times are frame numbers: frames are at (number - {first}) / {} s, the fps of the calibration",
                context.fps
            ));
        }
        Ok(pairs)
    }

    fn truth(
        &self,
        context: &Context<'_>,
        _pairs: &[Pair],
        remarks: &mut Remarks,
    ) -> Result<Option<Vec<StampedPose>>, DatasetError> {
        let icl = icl_truth(context.source);
        let file = icl.as_deref().unwrap_or(tum::TRUTH);
        let read = tum::read_truth(context, file, &mut remarks.warnings)?;
        let Some(mut poses) = read else {
            return Ok(None);
        };
        let numbers = poses.iter().all(|pose| is_number(pose.t_s));
        // The options may have left out the first frames.
        let all = self.pairs(context, &mut Remarks::default())?;
        if let Some(first) = first_number(&all).filter(|_| numbers) {
            for pose in &mut poses {
                pose.t_s = (pose.t_s - first) / context.fps;
            }
        }
        if icl.is_some() {
            for pose in &mut poses {
                pose.world_from_camera = reflect(&pose.world_from_camera);
            }
            let note = format!("{file}: poses are reflected about the xz plane, as ICL-NUIM needs");
            remarks.notes.push(note);
        }
        Ok(Some(poses))
    }

    fn scales_colour(&self) -> bool {
        false
    }
}

const PAIR: &str = "`timestamp filename timestamp filename`";

/// Both halves of a line.
fn parse_pair(place: Place<'_>, text: &str) -> Result<[Entry; 2], DatasetError> {
    let fields: Vec<&str> = text.split_whitespace().collect();
    let [t0, file0, t1, file1] = fields[..] else {
        return Err(place.error(excerpt(text), PAIR));
    };
    let half = |t: &str, file: &str| parse_line(place, &format!("{t} {file}"));
    Ok([half(t0, file0)?, half(t1, file1)?])
}

/// By the kind of the first files, then by their names; colour is first where neither tells.
fn depth_is_first(source: &Source, columns: &[Vec<Entry>; 2]) -> Result<bool, DatasetError> {
    let [first, second] = columns.each_ref().map(|column| column[0].file.as_str());
    let kind = |file: &str| {
        let path = source.locate(file);
        let origin = Origin {
            frame: None,
            path: &path,
        };
        let bytes = source.read(file)?;
        Ok(bytes.and_then(|bytes| is_depth(&bytes, origin).ok()))
    };
    Ok(match (kind(first)?, kind(second)?) {
        (Some(a), Some(b)) if a != b => a,
        (Some(true), None) => true,
        (None, Some(true)) => false,
        _ => first.contains("depth") && !second.contains("depth"),
    })
}

/// The smallest time as listed, if all are frame numbers.
fn first_number(pairs: &[Pair]) -> Option<f64> {
    let listed = |pair: &Pair| pair.colour.stamp.parse().ok().filter(|t_s| is_number(*t_s));
    let numbers: Option<Vec<f64>> = pairs.iter().map(listed).collect();
    numbers?.first().copied()
}

fn is_number(t_s: f64) -> bool {
    t_s < LARGEST_NUMBER && t_s.fract().abs() < 1e-9
}

/// F T F with F = diag(1, -1, 1).
fn reflect(pose: &Se3) -> Se3 {
    // A reflection turns the axis of a rotation and its sense: x and z change their sign.
    let [w, x, y, z] = pose.rotation.quaternion();
    let rotation = So3::from_quaternion(w, -x, y, -z).unwrap_or_default();
    let t = pose.translation;
    Se3::new(rotation, Vector3::new(t.x, -t.y, t.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflection_of_a_pose() {
        let rotation = So3::from_quaternion(0.5, 0.5, -0.7, 0.1).expect("not zero");
        let pose = Se3::new(rotation, Vector3::new(1.0, 2.0, 3.0));
        let reflected = reflect(&pose);
        let f = |p: Vector3<f64>| Vector3::new(p.x, -p.y, p.z);
        let p = Vector3::new(0.3, -0.4, 2.0);
        let difference = reflected * f(p) - f(pose * p);
        assert!(difference.amax() < 1e-12, "{difference}");
    }
}
