//! Gaussians of a PLY file whose properties are plain numbers.

use std::path::Path;

use garad_core::{GaussianMap, KeyframeId, Label, Real, sh};
use serde_ply::ScalarType;

use super::property::{Names, Refused, error};
use crate::errors::DatasetError;

const PROPERTIES: &str = "the properties of 3D Gaussian Splatting";
/// ln of the standard deviation of an axis without extent, 0.1 um.
const FLAT: f32 = -16.0;
/// ln of a standard deviation that no map has, 66 000 km. Its square still is a number.
const LARGEST_LN_SCALE: f32 = 18.0;
/// Stands for an opacity of exactly 0 or 1.
const LOGIT_LIMIT: f32 = 40.0;
/// Quaternions longer or shorter than this factor are normalised, so that their squares are numbers.
const LONG: f32 = 1e9;

/// Where a row holds the numbers of a Gaussian.
pub(super) struct Columns {
    mean: [Column; 3],
    color: Color,
    /// Red, then green, then blue.
    rest: Vec<Column>,
    opacity: Column,
    /// One for a sphere, two for a disc.
    scale: Vec<Column>,
    rotation: [Column; 4],
    label: Option<Column>,
}

struct Column {
    name: String,
    at: usize,
}

/// The colour of a Gaussian seen from everywhere.
enum Color {
    /// SH coefficient 0.
    Sh([Column; 3]),
    /// Red, green, blue, of so much at full intensity.
    Rgb([Column; 3], f32),
}

impl Columns {
    pub(super) fn find(path: &Path, names: &Names<'_>) -> Result<Self, DatasetError> {
        let number = |name: &str| match names.get(name) {
            Some(&(at, Some(_))) => Ok(Column {
                name: name.to_owned(),
                at,
            }),
            Some(_) => Err(error(path, format!("list {name}"), "a number")),
            None => Err(error(path, format!("no property {name}"), PROPERTIES)),
        };
        let three = |[a, b, c]: [&str; 3]| Ok([number(a)?, number(b)?, number(c)?]);
        let counted = |name: &&&str| {
            let index = name.strip_prefix("f_rest_");
            index.is_some_and(|index| index.bytes().all(|b| b.is_ascii_digit()))
        };
        let rest = names.keys().filter(counted).count();
        if !matches!(rest, 0 | 9 | 24 | 45) {
            let found = format!("{rest} properties f_rest");
            return Err(error(path, found, "0, 9, 24 or 45 (degree 0 to 3)"));
        }
        let rest = (0..rest).map(|i| number(&format!("f_rest_{i}")));
        let has = |name: &str| names.contains_key(name);
        let color = match names.get("red") {
            Some(&(_, kind)) if !has("f_dc_0") => {
                let full = match kind {
                    Some(ScalarType::U8) => 255.0,
                    Some(ScalarType::U16) => 65_535.0,
                    _ => 1.0,
                };
                Color::Rgb(three(["red", "green", "blue"])?, full)
            }
            _ => Color::Sh(three(["f_dc_0", "f_dc_1", "f_dc_2"])?),
        };
        let axes = ["scale_0", "scale_1", "scale_2"];
        let given = match axes.map(has) {
            [true, false, false] => 1,
            [true, true, false] => 2,
            _ => 3,
        };
        let rotation = ["rot_0", "rot_1", "rot_2", "rot_3"].map(number);
        let [w, x, y, z] = rotation;
        Ok(Self {
            mean: three(["x", "y", "z"])?,
            color,
            rest: rest.collect::<Result<_, _>>()?,
            opacity: number("opacity")?,
            scale: axes[..given]
                .iter()
                .map(|name| number(name))
                .collect::<Result<_, _>>()?,
            rotation: [w?, x?, y?, z?],
            label: has("label").then(|| number("label")).transpose()?,
        })
    }

    pub(super) fn degree(&self) -> usize {
        match self.rest.len() {
            0 => 0,
            9 => 1,
            24 => 2,
            _ => 3,
        }
    }

    /// Appends the Gaussian of one row.
    pub(super) fn push(&self, row: &[f64], map: &mut GaussianMap<f32>) -> Result<(), Refused> {
        let finite = |column: &Column| {
            let value = column.of(row);
            match value.is_finite() {
                true => Ok(value),
                false => Err(column.refused(value, "a finite number")),
            }
        };
        let three = |[a, b, c]: &[Column; 3]| Ok([finite(a)?, finite(b)?, finite(c)?]);
        let mean = three(&self.mean)?;
        let dc = match &self.color {
            Color::Sh(dc) => three(dc)?,
            Color::Rgb(rgb, full) => three(rgb)?.map(|v| sh::dc_from_color(v / full)),
        };
        let rest: Vec<f32> = self.rest.iter().map(finite).collect::<Result<_, _>>()?;
        let per_channel = rest.len() / 3;
        let mut sh = vec![dc];
        sh.extend((0..per_channel).map(|k| [0, 1, 2].map(|c| rest[c * per_channel + k])));

        let opacity = match self.opacity.of(row) {
            v if v.is_nan() => return Err(self.opacity.refused(v, "a number")),
            v if v.is_infinite() => LOGIT_LIMIT.copysign(v),
            v => v,
        };
        let mut scale = [FLAT; 3];
        for (axis, column) in scale.iter_mut().zip(&self.scale) {
            let value = column.of(row);
            *axis = match value {
                f32::NEG_INFINITY => FLAT,
                v if v < LARGEST_LN_SCALE => v,
                v => return Err(column.refused(v, "ln of a size in metres, below 18")),
            };
        }
        if self.scale.len() == 1 {
            scale = [scale[0]; 3];
        }
        let [w, x, y, z] = &self.rotation;
        let quaternion = [finite(w)?, finite(x)?, finite(y)?, finite(z)?];
        let length = quaternion.iter().fold(0.0, |m: f32, v| m.max(v.abs()));
        if length <= 0.0 {
            return Err((
                "rot_0 to rot_3 are 0".to_owned(),
                "a quaternion that is not 0",
            ));
        }
        let usual = (1.0 / LONG..=LONG).contains(&length);
        let quaternion = quaternion.map(|v| if usual { v } else { v / length });
        #[allow(clippy::float_cmp, reason = "labels are exactly 0 or 1")]
        let label = match self.label.as_ref().map(|column| (column, column.of(row))) {
            None | Some((_, 0.0)) => Label::Static,
            Some((_, 1.0)) => Label::Dynamic,
            Some((column, v)) => return Err(column.refused(v, "0 (static) or 1 (dynamic)")),
        };
        push(map, mean, &sh, scale, quaternion, opacity, label);
        Ok(())
    }
}

impl Column {
    #[allow(clippy::cast_possible_truncation, reason = "maps are held in f32")]
    fn of(&self, row: &[f64]) -> f32 {
        row[self.at] as f32
    }

    fn refused(&self, value: f32, expected: &'static str) -> Refused {
        (format!("property {} is {value}", self.name), expected)
    }
}

/// Appends a Gaussian that was read from a file.
pub(super) fn push(
    map: &mut GaussianMap<f32>,
    mean: [f32; 3],
    sh: &[[f32; 3]],
    log_scale: [f32; 3],
    quaternion: [f32; 4],
    opacity_logit: f32,
    label: Label,
) {
    map.means.push(mean);
    map.sh.extend_from_slice(sh);
    map.log_scales.push(log_scale);
    map.quaternions.push(quaternion);
    map.opacity_logits.push(opacity_logit);
    map.landmark.push(None);
    map.parent.push(None);
    map.born.push(KeyframeId(0));
    map.label.push(label);
}

/// ln(a / (1 - a)), finite for 0 and 1.
pub(super) fn logit(a: f32) -> f32 {
    match a {
        a if a <= 0.0 => -LOGIT_LIMIT,
        a if a >= 1.0 => LOGIT_LIMIT,
        a => Real::ln(a / (1.0 - a)),
    }
}
