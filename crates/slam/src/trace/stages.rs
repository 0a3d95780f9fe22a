//! The tensors of each stage.

use garad_core::pyramid::GrayPyramid;
use garad_core::{
    DepthImage, GaussianMap, GrayImage, Image, KeyframeId, Label, LandmarkId, Real, Se3,
};
use garad_crf::{Beliefs, Node};
use garad_features::flow::{FlowFit, FlowPoint, FlowVerification};
use garad_features::{Descriptor, LkPyramid, LkTrack};
use garad_optim::{
    BundleObservation, CentrePrior, DepthObservation, PoseGraph, PoseObservation, PoseSolution,
};
use garad_raster::fast::Coverage;
use nalgebra::{Vector2, Vector3};

use super::{NONE, Role, StageRecord, matrix};
use crate::dynamics::evidence::DepthEvidence;
use crate::dynamics::gaussian_field::LabelledGaussian;
use crate::dynamics::samples::Sample;
use crate::frame::depth_planes::DepthPlanes;
use crate::frame::{Frame, FrameLabels};
use crate::io::FrameInput;
use crate::keyframing::culling::Observed;
use crate::keyframing::loop_closing::LoopClosure;
use crate::map::Map;
use crate::map::landmark::Appearance;
use crate::mapping::job::NewLandmark;

fn id(landmark: Option<LandmarkId>) -> u32 {
    landmark.map_or(NONE, |l| l.0)
}

fn pairs(points: &[Vector2<f64>]) -> Vec<f64> {
    points.iter().flat_map(|p| [p.x, p.y]).collect()
}

fn triples(points: impl IntoIterator<Item = Vector3<f64>>) -> Vec<f64> {
    points.into_iter().flat_map(|p| [p.x, p.y, p.z]).collect()
}

fn flags(values: impl IntoIterator<Item = bool>) -> Vec<u8> {
    values.into_iter().map(u8::from).collect()
}

fn moving(labels: &[Label]) -> Vec<u8> {
    flags(labels.iter().map(|l| *l == Label::Dynamic))
}

fn index(i: usize) -> u32 {
    u32::try_from(i).unwrap_or(NONE)
}

/// Of the virtual right camera or of depth, what is measured and its σ; NaN without depth.
fn third_rows(of: impl Iterator<Item = Option<DepthObservation>>) -> [Vec<f64>; 2] {
    let (mut value, mut sigma) = (Vec::new(), Vec::new());
    for depth in of {
        let (v, s) = match depth {
            None => (f64::NAN, f64::NAN),
            Some(DepthObservation::Right { u_px, sigma_px }) => (u_px, sigma_px),
            Some(DepthObservation::Disparity {
                disparity_px,
                sigma_px,
            }) => (disparity_px, sigma_px),
        };
        value.push(v);
        sigma.push(s);
    }
    [value, sigma]
}

/// x₀, y₀, a, b, c of a depth plane.
const PLANE_UNIT: &str = "px, 1/(m px), 1/m";

impl StageRecord {
    fn pose(&mut self, made: bool, name: &str, pose: &Se3) {
        let (row, unit) = (matrix(pose), "R | t in m");
        match made {
            true => self.output(name, unit, &[4], row),
            false => self.input(name, unit, &[4], row),
        }
    }

    pub(crate) fn image<T: Clone>(&mut self, name: &str, unit: &'static str, of: &Image<T>)
    where
        super::Values: From<Vec<T>>,
    {
        self.input(name, unit, &[of.width()], of.data().to_vec());
    }

    pub(crate) fn frame_input(&mut self, input: &FrameInput<'_>) {
        let rgb = input.rgb.data().as_flattened().to_vec();
        self.input("t_s", "s", &[], vec![input.t_s]);
        self.input("rgb", "1", &[input.rgb.width(), 3], rgb);
        self.image("depth_m", "m", input.depth);
        if let Some(mask) = input.mask {
            self.image("mask", "1", mask);
        }
    }

    /// Grey, the pyramid of the extractor (made again for the trace), keypoints.
    pub(crate) fn orb(
        &mut self,
        gray: &GrayImage,
        scale: f64,
        levels: usize,
        wanted: usize,
        frame: &Frame,
    ) {
        let scale = Real::to_f32(scale);
        self.input("wanted", "1", &[], vec![wanted as f64]);
        self.output("gray", "1", &[gray.width()], gray.data().to_vec());
        let pyramid = GrayPyramid::scaled(gray.clone(), scale, levels);
        for (l, level) in pyramid.levels().iter().enumerate().skip(1) {
            let name = format!("level_{l}");
            self.output(name, "1", &[level.width()], level.data().to_vec());
        }
        let keypoints = &frame.keypoints;
        let xy: Vec<f32> = keypoints.iter().flat_map(|k| [k.x, k.y]).collect();
        let level: Vec<u8> = keypoints.iter().map(|k| k.level).collect();
        let angle: Vec<f32> = keypoints.iter().map(|k| k.angle_deg).collect();
        let response: Vec<f32> = keypoints.iter().map(|k| k.response).collect();
        let descriptors = frame.descriptors.iter().flat_map(Descriptor::to_bytes);
        self.output("xy", "px", &[2], xy);
        self.output("level", "1", &[], level);
        self.output("angle_deg", "deg", &[], angle);
        self.output("response", "1", &[], response);
        self.output("descriptor", "1", &[32], descriptors.collect::<Vec<u8>>());
    }

    /// Keypoints in the full image, with their depth.
    pub(crate) fn keypoints(&mut self, frame: &Frame) {
        let depth = frame.depth_m.iter().map(|d| d.unwrap_or(f64::NAN));
        self.output("px", "px", &[2], pairs(&frame.px));
        self.output("uv_px", "px", &[2], pairs(&frame.uv_px));
        self.output("sigma_px", "px", &[], frame.sigma_px.clone());
        self.output("depth_m", "m", &[], depth.collect::<Vec<_>>());
        let one = flags(frame.one_surface.iter().copied());
        self.output("one_surface", "1", &[], one);
        let in_use = flags(frame.in_use.iter().copied());
        self.output("in_use", "1", &[], in_use);
    }

    /// Per block: x₀, y₀, a, b, c of its plane; NaN without one.
    pub(crate) fn depth_planes(&mut self, planes: &DepthPlanes) {
        self.output("planes", PLANE_UNIT, &[5], planes.rows_of_numbers());
    }

    /// The pose refined with depth planes: this frame's against those of `references`.
    pub(crate) fn depth_pose(
        &mut self,
        links: &[PoseObservation],
        planes: &DepthPlanes,
        references: &[(&DepthPlanes, &Se3)],
        (prior, before): (Option<&CentrePrior>, &Se3),
        found: (&Se3, f64),
    ) {
        let uv: Vec<Vector2<f64>> = links.iter().map(|o| o.uv_px).collect();
        self.input(
            "p_world",
            "m",
            &[3],
            triples(links.iter().map(|o| o.p_world)),
        );
        self.input("uv_px", "px", &[2], pairs(&uv));
        let sigma: Vec<f64> = links.iter().map(|o| o.sigma_px).collect();
        self.input("sigma_px", "px", &[], sigma);
        self.input("planes", PLANE_UNIT, &[5], planes.rows_of_numbers());
        for (k, (planes, reference_from_world)) in references.iter().enumerate() {
            let rows = planes.rows_of_numbers();
            self.input(format!("planes_{k}"), PLANE_UNIT, &[5], rows);
            self.pose(false, &format!("pose_{k}"), reference_from_world);
        }
        self.prior(prior);
        self.pose(false, "before", before);
        self.pose(true, "after", found.0);
        self.output("cost", "1", &[], vec![found.1]);
    }

    /// What the motion says of the camera's centre: c₀, and L with the information L Lᵀ.
    fn prior(&mut self, prior: Option<&CentrePrior>) {
        if let Some(prior) = prior {
            let centre: Vec<f64> = prior.centre_m.iter().copied().collect();
            let root = prior.root_information.transpose(); // row by row
            self.input("prior_centre", "m", &[], centre);
            self.input("prior_root", "1/m", &[3], root.as_slice().to_vec());
        }
    }

    pub(crate) fn predict(&mut self, last: &Se3, velocity: &Se3, predicted: &Se3) {
        self.pose(false, "last", last);
        self.pose(false, "velocity", velocity);
        self.pose(true, "predicted", predicted);
    }

    /// Which keypoint was linked to which landmark.
    pub(crate) fn links(&mut self, frame: &Frame) {
        let links: Vec<u32> = frame.landmark.iter().map(|l| id(*l)).collect();
        self.output("landmark", "1", &[], links);
    }

    /// The landmarks searched for, and what was found.
    pub(crate) fn local_map(&mut self, visible: &[(LandmarkId, Appearance)]) {
        let ids: Vec<u32> = visible.iter().map(|(l, _)| l.0).collect();
        let uv: Vec<f64> = visible
            .iter()
            .flat_map(|(_, a)| [a.uv_px.x, a.uv_px.y])
            .collect();
        let level: Vec<u32> = visible.iter().map(|(_, a)| index(a.level)).collect();
        self.input("visible", "1", &[], ids);
        self.input("visible_uv_px", "px", &[2], uv);
        self.input("visible_level", "1", &[], level);
    }

    /// A pose from points; `keypoints[k]` is the one behind observation k.
    pub(crate) fn pose_lm(
        &mut self,
        keypoints: &[usize],
        observations: &[PoseObservation],
        before: &Se3,
        prior: Option<&CentrePrior>,
        solution: &PoseSolution,
    ) {
        let seen = observations.iter();
        let at: Vec<u32> = keypoints.iter().map(|k| index(*k)).collect();
        let [right, right_sigma] = third_rows(seen.clone().map(|o| o.depth));
        let uv: Vec<Vector2<f64>> = seen.clone().map(|o| o.uv_px).collect();
        let sigma: Vec<f64> = seen.clone().map(|o| o.sigma_px).collect();
        self.input("keypoint", "1", &[], at);
        self.input("p_world", "m", &[3], triples(seen.map(|o| o.p_world)));
        self.input("uv_px", "px", &[2], pairs(&uv));
        self.input("sigma_px", "px", &[], sigma);
        self.input("third_px", "px", &[], right);
        self.input("third_sigma_px", "px", &[], right_sigma);
        self.prior(prior);
        self.pose(false, "before", before);
        self.pose(true, "after", &solution.camera_from_world);
        let inlier = flags(solution.inlier.iter().copied());
        self.output("inlier", "1", &[], inlier);
        self.output("cost", "1", &[], vec![solution.cost]);
    }

    /// The field over a frame's samples: keypoints with depth first, then the lattice.
    pub(crate) fn field(
        &mut self,
        nodes: &[Node],
        evidence: &[DepthEvidence],
        log_odds: &[f64],
        beliefs: &Beliefs,
    ) {
        let px: Vec<_> = nodes.iter().map(|n| n.uv_px.unwrap_or_default()).collect();
        let residual = evidence.iter().map(|v| v.residual.unwrap_or(f64::NAN));
        let agreed: Vec<u32> = evidence.iter().map(|e| e.agreed_frames).collect();
        let points = triples(nodes.iter().map(|n| n.p_world));
        self.input("p_world", "m", &[3], points);
        self.input("px", "px", &[2], pairs(&px));
        self.input("depth_residual", "sigma", &[], residual.collect::<Vec<_>>());
        self.input("agreed_frames", "frames", &[], agreed);
        self.output("log_odds", "nat", &[], log_odds.to_vec());
        self.output("belief", "1", &[], beliefs.dynamic.clone());
    }

    /// The labels of a frame's keypoints, and its mask in cells.
    pub(crate) fn labels(&mut self, labels: &FrameLabels) {
        let cells = &labels.cells;
        self.output("cells", "1", &[cells.width()], cells.data().to_vec());
        self.output("label", "1", &[], moving(&labels.label));
        let in_use = flags(labels.in_use.iter().copied());
        self.output("in_use", "1", &[], in_use);
    }

    /// The flow model of static points, and the suspects judged by it.
    pub(crate) fn flow(
        &mut self,
        model: &[FlowPoint],
        suspects: &[FlowPoint],
        answer: &FlowVerification,
    ) {
        for (name, points) in [("static", model), ("suspect", suspects)] {
            let flow: Vec<_> = points.iter().map(|p| p.flow).collect();
            let nan = Vector2::repeat(f64::NAN);
            let predicted: Vec<_> = points.iter().map(|p| p.predicted.unwrap_or(nan)).collect();
            self.input(format!("{name}_flow"), "px", &[2], pairs(&flow));
            self.input(format!("{name}_predicted"), "px", &[2], pairs(&predicted));
        }
        if let FlowFit::Model(fit) = &answer.fit {
            let covariance = fit.covariance.transpose().as_slice().to_vec();
            self.output("mean", "px", &[], vec![fit.mean.x, fit.mean.y]);
            self.output("covariance", "px^2", &[2], covariance);
        }
        let verdicts = answer.verdicts.iter();
        let distance = verdicts
            .clone()
            .map(|v| v.map_or(f64::NAN, |v| v.distance2));
        self.output("distance2", "1", &[], distance.collect::<Vec<_>>());
        let inside = flags(verdicts.map(|v| v.is_some_and(|v| v.inside)));
        self.output("inside", "1", &[], inside);
    }

    /// Points of one image tracked into another.
    pub(crate) fn tracks(
        &mut self,
        [from, to]: [&LkPyramid; 2],
        [points, starts]: [&[[f32; 2]]; 2],
        tracks: &[LkTrack],
    ) {
        self.image("from", "1", &from.image());
        self.image("to", "1", &to.image());
        self.input("points", "px", &[2], points.as_flattened().to_vec());
        self.input("starts", "px", &[2], starts.as_flattened().to_vec());
        let xy: Vec<f32> = tracks.iter().flat_map(|t| t.xy).collect();
        self.output("xy", "px", &[2], xy);
        let tracked = flags(tracks.iter().map(LkTrack::is_tracked));
        self.output("tracked", "1", &[], tracked);
        let residual: Vec<f32> = tracks.iter().map(|t| t.residual).collect();
        self.output("residual", "1", &[], residual);
    }

    /// Whether the frame becomes a keyframe.
    pub(crate) fn decision(&mut self, inliers: usize, frame: &Frame, kept: bool) {
        let linked = frame.landmark.iter().flatten().count();
        self.input("inliers", "1", &[], vec![index(inliers)]);
        self.input("linked", "1", &[], vec![index(linked)]);
        self.output("kept", "1", &[], vec![u8::from(kept)]);
    }

    /// A keyframe's landmarks through the field, with the paper's cues.
    pub(crate) fn landmark_field(
        &mut self,
        ids: impl Iterator<Item = LandmarkId>,
        nodes: &[Node],
        beliefs: &Beliefs,
    ) {
        let uv: Vec<_> = nodes.iter().map(|n| n.uv_px.unwrap_or_default()).collect();
        let nan = f64::NAN;
        let cues = nodes.iter().flat_map(|n| {
            [
                n.cues.reproj_px.unwrap_or(nan),
                n.cues.depth_residual.unwrap_or(nan),
                n.cues.observations.map_or(nan, f64::from),
                n.cues.epipolar_px.unwrap_or(nan),
            ]
        });
        let previous = nodes.iter().map(|n| n.previous.unwrap_or(nan));
        self.input("landmark", "1", &[], ids.map(|l| l.0).collect::<Vec<_>>());
        let points = triples(nodes.iter().map(|n| n.p_world));
        self.input("p_world", "m", &[3], points);
        self.input("uv_px", "px", &[2], pairs(&uv));
        self.input("cues", "px, sigma, 1, px", &[4], cues.collect::<Vec<_>>());
        self.input("previous", "1", &[], previous.collect::<Vec<_>>());
        self.output("belief", "1", &[], beliefs.dynamic.clone());
        self.output("label", "1", &[], moving(&beliefs.labels));
    }

    /// What goes into a bundle adjustment.
    pub(crate) fn bundle_in(
        &mut self,
        poses: &[Se3],
        fixed: &[bool],
        points: &[Vector3<f64>],
        observations: &[BundleObservation],
    ) {
        let seen = observations.iter();
        let [third, third_sigma] = third_rows(seen.clone().map(|o| o.depth));
        let of: Vec<u32> = seen
            .clone()
            .flat_map(|o| [index(o.pose), index(o.point)])
            .collect();
        let uv: Vec<_> = seen.clone().map(|o| o.uv_px).collect();
        let sigma: Vec<f64> = seen.map(|o| o.sigma_px).collect();
        let rows: Vec<f64> = poses.iter().flat_map(matrix).collect();
        self.input("poses_before", "R | t in m", &[3, 4], rows);
        self.input("fixed", "1", &[], flags(fixed.iter().copied()));
        let points = triples(points.iter().copied());
        self.input("points_before", "m", &[3], points);
        self.input("observation", "pose, point", &[2], of);
        self.input("uv_px", "px", &[2], pairs(&uv));
        self.input("sigma_px", "px", &[], sigma);
        self.input("third_px", "px", &[], third);
        self.input("third_sigma_px", "px", &[], third_sigma);
    }

    /// What comes out of it.
    pub(crate) fn bundle_out(
        &mut self,
        poses: &[Se3],
        points: &[Vector3<f64>],
        report: &garad_optim::BundleReport,
    ) {
        let rows: Vec<f64> = poses.iter().flat_map(matrix).collect();
        self.output("poses_after", "R | t in m", &[3, 4], rows);
        let points = triples(points.iter().copied());
        self.output("points_after", "m", &[3], points);
        let inlier = flags(report.inlier.iter().copied());
        self.output("inlier", "1", &[], inlier);
        let cost = vec![report.report.cost0, report.report.cost];
        self.output("cost", "1", &[], cost);
    }

    /// The frame's final pose, and the landmarks it sees.
    pub(crate) fn trajectory(&mut self, frame: &Frame, map: &Map) {
        self.pose(true, "camera_from_world", &frame.camera_from_world);
        let linked = frame.landmark.iter().flatten();
        let living: Vec<_> = linked
            .filter_map(|l| Some((*l, map.landmark(*l)?)))
            .collect();
        let ids: Vec<u32> = living.iter().map(|(l, _)| l.0).collect();
        self.output("landmark", "1", &[], ids);
        let points = triples(living.iter().map(|(_, l)| l.p_world));
        self.output("p_world", "m", &[3], points);
    }

    /// What insertion reads: all landmarks of the map, and those the keyframe made.
    pub(crate) fn landmarks(&mut self, living: &[(LandmarkId, Label)], new: &[NewLandmark]) {
        let ids: Vec<u32> = living.iter().map(|(l, _)| l.0).collect();
        self.input("living", "1", &[], ids);
        let ids: Vec<u32> = new.iter().map(|l| l.id.0).collect();
        self.input("new_landmark", "1", &[], ids);
        let points = triples(new.iter().map(|l| l.p_world));
        self.input("new_p_world", "m", &[3], points);
        let px: Vec<u32> = new.iter().flat_map(|l| l.px.map(index)).collect();
        self.input("new_px", "px", &[2], px);
    }

    /// A map of Gaussians, as the stage leaves it.
    pub(crate) fn gaussians(&mut self, map: &GaussianMap) {
        self.map(Role::Output, "", map);
    }

    fn map(&mut self, role: Role, prefix: &str, map: &GaussianMap) {
        let tags: Vec<u32> = map.landmark.iter().map(|l| id(*l)).collect();
        let of_one: [(&str, &'static str, &[usize], super::Values); 7] = [
            ("means", "m", &[3], map.means.as_flattened().to_vec().into()),
            (
                "log_scales",
                "ln m",
                &[3],
                map.log_scales.as_flattened().to_vec().into(),
            ),
            (
                "quaternions",
                "w x y z",
                &[4],
                map.quaternions.as_flattened().to_vec().into(),
            ),
            (
                "opacity_logits",
                "1",
                &[],
                map.opacity_logits.clone().into(),
            ),
            (
                "sh",
                "1",
                &[map.coefficients(), 3],
                map.sh.as_flattened().to_vec().into(),
            ),
            ("landmark", "1", &[], tags.into()),
            ("label", "1", &[], moving(&map.label).into()),
        ];
        for (name, unit, row, values) in of_one {
            self.tensor(role, format!("{prefix}{name}"), unit, row, values);
        }
    }

    /// Clones, splits and prunes: the map before and after, and what decides. `normals` are those drawn for the
    /// children.
    pub(crate) fn densify(
        &mut self,
        (before, after): (&GaussianMap, &GaussianMap),
        (gradient, seen): (&[f32], &[u32]),
        (extent_m, young_from): (f64, KeyframeId),
        normals: Vec<f64>,
    ) {
        self.map(Role::Input, "before_", before);
        let born: Vec<u32> = before.born.iter().map(|k| k.0).collect();
        self.input("born", "keyframe", &[], born);
        self.input("gradient", "1", &[], gradient.to_vec());
        self.input("seen", "iterations", &[], seen.to_vec());
        self.input("extent_m", "m", &[], vec![extent_m]);
        self.input("young_from", "keyframe", &[], vec![young_from.0]);
        self.input("normals", "1", &[3], normals);
        self.gaussians(after);
    }

    /// The mask rendered from the dynamic Gaussians, and the samples of the frame in it: keypoints with depth first,
    /// then the lattice.
    pub(crate) fn gaussian_mask(
        &mut self,
        (dynamic, frame): (&GaussianMap, &Frame),
        levels: &[Coverage],
        label: &[Label],
        samples: &[Sample],
        suspected: &[bool],
    ) {
        self.map(Role::Input, "", dynamic);
        self.pose(false, "camera_from_world", &frame.camera_from_world);
        let px: Vec<_> = samples.iter().map(|s| s.px).collect();
        let depth: Vec<f64> = samples.iter().map(|s| s.depth_m).collect();
        self.input("px", "px", &[2], pairs(&px));
        self.input("depth_m", "m", &[], depth);
        let points = triples(samples.iter().map(|s| s.p_world));
        self.input("p_world", "m", &[3], points);
        for (l, drawn) in levels.iter().enumerate() {
            let (opacity, depth) = (&drawn.opacity, &drawn.depth);
            let row = [opacity.width()];
            self.output(format!("opacity_{l}"), "1", &row, opacity.data().to_vec());
            self.output(format!("depth_m_{l}"), "m", &row, depth.data().to_vec());
        }
        self.output("in_mask", "1", &[], moving(label));
        let suspected = flags(suspected.iter().copied());
        self.output("suspected", "1", &[], suspected);
    }

    /// What the flow check sets static again: samples, keypoints, and of the dynamic landmarks in view those that
    /// these keypoints show.
    pub(crate) fn restore<'a>(
        &mut self,
        seen: impl Iterator<Item = (LandmarkId, &'a Descriptor, Vector2<f64>)> + Clone,
        rests: &[bool],
        keypoints: &[usize],
        landmarks: &[LandmarkId],
    ) {
        let ids: Vec<u32> = seen.clone().map(|(l, _, _)| l.0).collect();
        let descriptors: Vec<u8> = seen.clone().flat_map(|(_, d, _)| d.to_bytes()).collect();
        let uv: Vec<_> = seen.map(|(_, _, uv_px)| uv_px).collect();
        self.input("dynamic_landmark", "1", &[], ids);
        self.input("dynamic_descriptor", "1", &[32], descriptors);
        self.input("dynamic_uv_px", "px", &[2], pairs(&uv));
        self.output("rests", "1", &[], flags(rests.iter().copied()));
        let keypoints: Vec<u32> = keypoints.iter().map(|i| index(*i)).collect();
        self.output("keypoint", "1", &[], keypoints);
        let landmarks: Vec<u32> = landmarks.iter().map(|l| l.0).collect();
        self.output("landmark", "1", &[], landmarks);
    }

    /// The labels of Gaussians by the field, by the vote of those it labelled, and by restored landmarks. Windows are
    /// the runs so far and the dynamic ones among the last n - 1.
    pub(crate) fn label_gaussians(
        &mut self,
        map: &GaussianMap,
        (label, windows): (&[Label], &[[u32; 2]]),
        restored: impl Iterator<Item = LandmarkId>,
        voters: &[LabelledGaussian],
        removed: &[bool],
    ) {
        self.input("means", "m", &[3], map.means.as_flattened().to_vec());
        let tags: Vec<u32> = map.landmark.iter().map(|l| id(*l)).collect();
        self.input("landmark", "1", &[], tags);
        self.input("before", "1", &[], moving(label));
        let windows = windows.as_flattened().to_vec();
        self.input("window", "runs, dynamic", &[2], windows);
        let restored: Vec<u32> = restored.map(|l| l.0).collect();
        self.input("restored", "1", &[], restored);
        let rows: Vec<u32> = voters.iter().map(|v| index(v.row)).collect();
        self.input("voter", "row", &[], rows);
        let labels: Vec<Label> = voters.iter().map(|v| v.label).collect();
        self.input("voter_label", "1", &[], moving(&labels));
        self.output("label", "1", &[], moving(&map.label));
        self.output("removed", "1", &[], flags(removed.iter().copied()));
    }

    /// A lost camera: the keyframes tried, and the inliers of each; the links and the pose of the one taken.
    pub(crate) fn relocalise(&mut self, tried: &[(KeyframeId, usize)], found: bool, frame: &Frame) {
        let keyframes: Vec<u32> = tried.iter().map(|(k, _)| k.0).collect();
        let inliers: Vec<u32> = tried.iter().map(|(_, n)| index(*n)).collect();
        self.input("keyframe", "1", &[], keyframes);
        self.input("inliers", "1", &[], inliers);
        self.output("found", "1", &[], vec![u8::from(found)]);
        self.links(frame);
        self.pose(true, "camera_from_world", &frame.camera_from_world);
    }

    /// A loop that is closed: the pose graph with the keyframe as located, and the poses it leads to.
    pub(crate) fn closed_loop(
        &mut self,
        closure: &LoopClosure,
        graph: &PoseGraph,
        fixed: &[bool],
        located: &Se3,
        after: &[Se3],
    ) {
        let edges = graph.edges.iter();
        let ends: Vec<u32> = edges.clone().flat_map(|e| [e.a, e.b].map(index)).collect();
        let relative: Vec<f64> = edges.clone().flat_map(|e| matrix(&e.a_from_b)).collect();
        let weight =
            edges.flat_map(|e| e.information.diagonal().iter().copied().collect::<Vec<_>>());
        let pair = vec![closure.keyframe.0, closure.older.0];
        self.input("keyframe", "newest, older", &[2], pair);
        self.pose(false, "located", located);
        self.input("edge", "a, b", &[2], ends);
        self.input("a_from_b", "R | t in m", &[3, 4], relative);
        let weight: Vec<f64> = weight.collect();
        self.input("information", "1/m^2, 1/rad^2", &[6], weight);
        let before: Vec<f64> = graph.poses.iter().flat_map(matrix).collect();
        self.input("poses_before", "R | t in m", &[3, 4], before);
        self.input("fixed", "1", &[], flags(fixed.iter().copied()));
        let after: Vec<f64> = after.iter().flat_map(matrix).collect();
        self.output("poses_after", "R | t in m", &[3, 4], after);
        self.output("drift_m", "m", &[], vec![closure.drift_m]);
    }

    /// Which keyframes are culled, by the observations of all.
    pub(crate) fn cull(
        &mut self,
        newest: KeyframeId,
        ends: impl Iterator<Item = KeyframeId>,
        observations: &[Observed],
        culled: &[KeyframeId],
    ) {
        let rows: Vec<u32> = (observations.iter())
            .flat_map(|o| [o.keyframe.0, o.landmark.0, u32::from(o.level)])
            .collect();
        let depth: Vec<f64> = observations.iter().map(|o| o.depth_m).collect();
        let is_static = flags(observations.iter().map(|o| o.is_static));
        self.input("newest", "1", &[], vec![newest.0]);
        self.input("loop_end", "1", &[], ends.map(|k| k.0).collect::<Vec<_>>());
        self.input("observation", "keyframe, landmark, level", &[3], rows);
        self.input("depth_m", "m", &[], depth);
        self.input("static", "1", &[], is_static);
        let culled: Vec<u32> = culled.iter().map(|k| k.0).collect();
        self.output("culled", "1", &[], culled);
    }

    /// One training iteration: target, render and loss.
    pub(crate) fn training(
        &mut self,
        (keyframe, level): (u32, usize),
        pose: &Se3,
        target: (&Image<[f32; 3]>, Option<&DepthImage>, &GrayImage),
        drawn: (&Image<[f32; 3]>, &Image<f32>, &Image<f32>),
        loss: f32,
    ) {
        let (color, depth, excluded) = target;
        let flat = |i: &Image<[f32; 3]>| i.data().as_flattened().to_vec();
        self.input("keyframe", "1", &[], vec![keyframe]);
        self.input("level", "1", &[], vec![index(level)]);
        self.pose(false, "camera_from_world", pose);
        self.input("target", "1", &[color.width(), 3], flat(color));
        if let Some(depth) = depth {
            self.image("measured_m", "m", depth);
        }
        self.image("excluded", "1", excluded);
        let (color, depth, opacity) = drawn;
        self.output("color", "1", &[color.width(), 3], flat(color));
        self.output("depth_m", "m", &[depth.width()], depth.data().to_vec());
        self.output("opacity", "1", &[opacity.width()], opacity.data().to_vec());
        self.output("loss", "1", &[], vec![loss]);
    }
}
