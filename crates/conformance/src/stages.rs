//! [`STAGES`]: every stage with the ways to compute it.

use garad_core::Par;
use garad_crf::Method;
use garad_features::lk;
use garad_golden::Inputs;
use garad_raster::losses as loss;
use garad_slam::mapping::iteration::Engine;

use crate::outputs::{Answer, Error, Outputs};
use crate::{
    bundle, features, field, geometry, judging, losses, mapping, moving, poses, raster, recordings,
    tracking, train_run, training, two_views,
};

/// In which numbers a stage computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// f64, or what its definition says where there is one form only.
    F64,
    /// f32, as on a GPU.
    F32,
}

/// One of the ways to compute a stage.
#[derive(Debug, Clone, Copy)]
pub struct Form {
    /// In words.
    pub name: &'static str,
    /// Its numbers.
    pub width: Width,
    run: fn(&Inputs, Par) -> Answer,
}

impl Form {
    const fn only(run: fn(&Inputs, Par) -> Answer) -> Self {
        Self::f64("the only form", run)
    }

    const fn f64(name: &'static str, run: fn(&Inputs, Par) -> Answer) -> Self {
        let width = Width::F64;
        Self { name, width, run }
    }

    const fn f32(name: &'static str, run: fn(&Inputs, Par) -> Answer) -> Self {
        let width = Width::F32;
        Self { name, width, run }
    }

    /// The outputs, the same for any number of threads.
    ///
    /// # Errors
    /// If the inputs lack something, or are nothing the stage can compute with.
    pub fn answer(&self, inputs: &Inputs, par: Par) -> Answer {
        (self.run)(inputs, par)
    }
}

/// Every stage that has cases of its own, with its forms. The first is what `--self` runs, and the last of those in
/// f32 what `--self=f32` runs.
#[rustfmt::skip]
pub const STAGES: &[(&str, &[Form])] = &[
    ("decode", &[Form::only(|i, _| recordings::decode(i))]),
    ("associate", &[Form::only(|i, _| recordings::pairs(i))]),
    ("bonn", &[Form::only(|i, _| recordings::bonn(i))]),
    ("ply", &[Form::only(|i, _| recordings::ply(i))]),
    ("se3", &[Form::only(|i, _| geometry::se3(i))]),
    ("camera", &[Form::only(|i, _| geometry::camera(i))]),
    ("undistort", &[Form::only(geometry::undistort)]),
    ("pyramid", &[Form::only(|i, _| features::pyramid(i))]),
    ("fast", &[Form::only(|i, _| features::fast(i))]),
    ("orb", &[Form::only(features::orb)]),
    ("matching", &[Form::only(features::matching)]),
    ("lk", &[
        Form::f64("fast", |i, par| features::lucas_kanade(i, par, lk::track)),
        Form::f64("reference", |i, par| features::lucas_kanade(i, par, lk::track_reference)),
    ]),
    ("epipolar", &[Form::only(|i, _| two_views::epipolar(i))]),
    ("flow", &[Form::only(|i, _| two_views::flow(i))]),
    ("robust", &[Form::only(|i, _| poses::robust(i))]),
    ("reprojection", &[Form::only(|i, _| poses::reprojection(i))]),
    ("place", &[Form::only(|i, _| features::place(i))]),
    ("pnp", &[Form::only(poses::pnp)]),
    ("pose_lm", &[Form::only(|i, _| poses::pose(i))]),
    ("landmark_links", &[Form::only(|i, _| tracking::landmark_links(i))]),
    ("keyframe", &[Form::only(|i, _| tracking::keyframe(i))]),
    ("bundle", &[Form::only(|i, _| bundle::bundle(i))]),
    ("pose_graph", &[Form::only(|i, _| bundle::pose_graph(i))]),
    ("free_space", &[Form::only(|i, _| moving::free_space(i))]),
    ("cues", &[Form::only(|i, _| moving::cues(i))]),
    ("unary", &[Form::only(|i, _| field::unary(i))]),
    ("kernel", &[Form::only(|i, _| field::kernels(i))]),
    ("mean_field", &[
        Form::f64("reference", |i, par| field::mean_field(i, par, Method::Reference)),
        Form::f64("fast", |i, par| field::mean_field(i, par, Method::Fast { tail: 0.0 })),
        Form::f64("fast, tails cut", |i, par| field::mean_field(i, par, Method::Fast { tail: 1e-17 })),
    ]),
    ("label_window", &[Form::only(|i, _| field::window(i))]),
    ("relabel", &[Form::only(|i, _| moving::relabelled(i))]),
    ("sh", &[
        Form::f64("f64", |i, _| raster::harmonics::<f64>(i)),
        Form::f32("f32", |i, _| raster::harmonics::<f32>(i)),
    ]),
    ("projection_covariance", &[
        Form::f64("reference in f64", |i, par| raster::projection(i, par, Engine::<f64>::REFERENCE)),
        Form::f32("reference in f32", |i, par| raster::projection(i, par, Engine::<f32>::REFERENCE)),
        Form::f32("fast in f32", |i, par| raster::projection(i, par, Engine::FAST)),
    ]),
    ("raster", &[
        Form::f64("reference in f64", |i, par| raster::forward(i, par, Engine::<f64>::REFERENCE)),
        Form::f32("reference in f32", |i, par| raster::forward(i, par, Engine::<f32>::REFERENCE)),
        Form::f32("fast in f32", |i, par| raster::forward(i, par, Engine::FAST)),
    ]),
    ("raster_backward", &[
        Form::f64("reference in f64", |i, par| raster::backward(i, par, Engine::<f64>::REFERENCE)),
        Form::f32("reference in f32", |i, par| raster::backward(i, par, Engine::<f32>::REFERENCE)),
        Form::f32("fast in f32", |i, par| raster::backward(i, par, Engine::FAST)),
    ]),
    ("losses", &[
        Form::f64("sweep in f64", |i, par| losses::losses::<f64>(i, par, loss::ssim, loss::photometric)),
        Form::f64("reference in f64", |i, par| losses::losses::<f64>(i, par, loss::reference::ssim, loss::reference::photometric)),
        Form::f32("reference in f32", |i, par| losses::losses::<f32>(i, par, loss::reference::ssim, loss::reference::photometric)),
        Form::f32("sweep in f32", |i, par| losses::losses::<f32>(i, par, loss::ssim, loss::photometric)),
    ]),
    ("knn_scale", &[Form::only(|i, _| training::knn_scale(i))]),
    ("adam", &[
        Form::f64("f64", |i, _| training::adam::<f64>(i)),
        Form::f32("f32", |i, _| training::adam::<f32>(i)),
    ]),
    ("sgd", &[
        Form::f64("f64", |i, _| training::plain_descent::<f64>(i)),
        Form::f32("f32", |i, _| training::plain_descent::<f32>(i)),
    ]),
    ("image_pyramid", &[Form::only(mapping::image_pyramid)]),
    ("densify", &[Form::only(|i, _| mapping::density(i))]),
    ("train_step", &[
        Form::f64("reference in f64", |i, par| training::train_step(i, par, Engine::<f64>::REFERENCE)),
        Form::f32("reference in f32", |i, par| training::train_step(i, par, Engine::<f32>::REFERENCE)),
        Form::f32("fast in f32", |i, par| training::train_step(i, par, Engine::FAST)),
    ]),
    ("train_run", &[Form::only(|i, _| train_run::train_run(i))]),
    ("trajectory", &[Form::only(|i, _| judging::trajectory(i))]),
    ("image_metrics", &[Form::only(judging::image_metrics)]),
];

/// The forms of a stage; none if it is not one of [`STAGES`].
#[must_use]
pub fn forms(stage: &str) -> &'static [Form] {
    let found = STAGES.iter().find(|(name, _)| *name == stage);
    found.map_or(&[], |(_, forms)| forms)
}

/// The outputs of this project's own stage; `None` if it is not one of [`STAGES`].
///
/// # Errors
/// As [`Form::answer`], with the name of the case.
pub fn answer(inputs: &Inputs, width: Width) -> Result<Option<Outputs>, Error> {
    let forms = forms(inputs.stage());
    let narrow = forms.iter().rfind(|form| form.width == Width::F32);
    let form = match width {
        Width::F64 => forms.first(),
        Width::F32 => narrow.or(forms.first()),
    };
    let outputs = form.map(|form| form.answer(inputs, Par::Seq)).transpose();
    outputs.map_err(|error| format!("{}: {error}", inputs.name()).into())
}
