//! Losses and their gradients.

use garad_core::{Image, MaskImage, Par, Real};
use garad_golden::Inputs;
use garad_raster::RasterError;
use garad_raster::losses::{ImageLoss, depth_l1, l1, opacity_penalty};

use crate::convert::{channels, gray_if_there, labels, plane, reals};
use crate::outputs::{Answer, Element, Outputs};

type Found<T> = Result<ImageLoss<T>, RasterError>;
type Ssim<T> = fn(&Image<[T; 3]>, &Image<[T; 3]>, Option<&MaskImage>, Par) -> Found<T>;
type Photometric<T> = fn(&Image<[T; 3]>, &Image<[T; 3]>, f64, Option<&MaskImage>, Par) -> Found<T>;

pub(crate) fn losses<T: Real + Element>(
    inputs: &Inputs,
    par: Par,
    ssim: Ssim<T>,
    photometric: Photometric<T>,
) -> Answer {
    let excluded = gray_if_there(inputs, "excluded")?;
    let excluded = excluded.as_ref();
    let mut out = Outputs::default();
    match inputs.word("loss")? {
        "depth" => {
            let loss = depth_l1(
                &plane::<T>(inputs, "depth")?,
                &plane(inputs, "opacity")?,
                &plane(inputs, "measured")?,
                inputs.number("min_opacity")?,
                excluded,
            )?;
            out.put("value", [loss.value]);
            out.image("by_depth", &loss.depth);
            out.image("by_opacity", &loss.opacity);
        }
        "opacity" => {
            let loss = opacity_penalty(
                &reals::<T>(inputs, "logits")?,
                &labels(inputs, "dynamic")?,
                None,
            )?;
            out.put("value", [loss.value]);
            out.put("gradient", loss.opacity_logits);
        }
        kind => {
            let (x, y) = (
                channels::<T, 3>(inputs, "rendered")?,
                channels(inputs, "target")?,
            );
            let loss = match kind {
                "l1" => l1(&x, &y, excluded),
                "ssim" => ssim(&x, &y, excluded, par),
                "photometric" => photometric(&x, &y, inputs.number("lambda")?, excluded, par),
                other => return Err(format!("loss '{other}'").into()),
            }?;
            out.put("value", [loss.value]);
            out.image("gradient", &loss.gradient);
        }
    }
    Ok(out)
}
