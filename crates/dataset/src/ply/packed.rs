//! Compressed PLY, as SuperSplat writes it: 16 bytes a Gaussian, within the bounds of its chunk of 256.
//!
//! | property of `vertex` | bits, from the highest | meaning |
//! |---|---|---|
//! | `packed_position`, `packed_scale` | 11, 10, 11 | x, y, z and ln of the sizes, between the chunk's bounds |
//! | `packed_rotation` | 2, 10, 10, 10 | which of w, x, y, z is largest; the other three in this order, from -1/sqrt 2 to 1/sqrt 2 |
//! | `packed_color` | 8, 8, 8, 8 | red, green, blue (between the chunk's bounds, if it has any) and opacity |
//!
//! An element `sh` may follow, with `uchar f_rest_0..` of -4 to 4.

use std::path::Path;

use garad_core::{GaussianMap, Label, Real, sh};
use serde_ply::ElementDef;

use super::columns::{logit, push};
use super::property::{Refused, error, names};
use crate::errors::DatasetError;

/// Gaussians that share bounds.
const CHUNK: usize = 256;
const PACKED: [&str; 4] = [
    "packed_position",
    "packed_rotation",
    "packed_scale",
    "packed_color",
];
const BOUNDS: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];
/// Bounds that every file has; those of the colours came later.
const BOUNDS_NEEDED: usize = 12;
const EXPECTED: &str = "a compressed PLY as SuperSplat writes it";

/// The columns of a compressed file, and the bounds of its chunks.
pub(super) struct Packed {
    vertex: [usize; 4],
    /// Of the bounds, 12 or 18.
    chunk: Vec<usize>,
    /// Of the higher coefficients: red, then green, then blue.
    rest: Vec<usize>,
    bounds: Vec<Bounds>,
}

/// Least and largest values in a chunk.
struct Bounds {
    position: [[f32; 3]; 2],
    log_scale: [[f32; 3]; 2],
    color: [[f32; 3]; 2],
}

impl Packed {
    pub(super) fn find(path: &Path, elements: &[ElementDef]) -> Result<Self, DatasetError> {
        let element = |name: &str| elements.iter().position(|e| e.name == name);
        let (chunk, vertex) = (element("chunk"), element("vertex"));
        let (Some(chunk), Some(vertex)) = (chunk.filter(|c| Some(*c) < vertex), vertex) else {
            return Err(error(path, "no element chunk before vertex", EXPECTED));
        };
        let needed = elements[vertex].count.div_ceil(CHUNK);
        if elements[chunk].count < needed {
            let found = format!("{} chunks", elements[chunk].count);
            return Err(error(path, found, "one chunk for each 256 Gaussians"));
        }
        let find = |element: usize, wanted: &[&str]| -> Result<Vec<usize>, DatasetError> {
            let names = names(path, &elements[element])?;
            let at = |name: &&str| match names.get(name) {
                Some(&(at, Some(_))) => Ok(at),
                _ => Err(error(path, format!("no property {name}"), EXPECTED)),
            };
            wanted.iter().map(at).collect()
        };
        let colored = elements[chunk].get_property("min_r").is_some();
        let bounds = if colored { BOUNDS.len() } else { BOUNDS_NEEDED };
        let columns = find(vertex, &PACKED)?;
        let rest = match element("sh") {
            None => Vec::new(),
            Some(at) if at < vertex || elements[at].count != elements[vertex].count => {
                return Err(error(
                    path,
                    "an element sh of another count or before vertex",
                    EXPECTED,
                ));
            }
            Some(at) => {
                let count = elements[at].properties.len();
                if !matches!(count, 9 | 24 | 45) {
                    let found = format!("{count} properties of sh");
                    return Err(error(path, found, "9, 24 or 45 (degree 1 to 3)"));
                }
                let wanted: Vec<String> = (0..count).map(|i| format!("f_rest_{i}")).collect();
                find(at, &wanted.iter().map(String::as_str).collect::<Vec<_>>())?
            }
        };
        Ok(Self {
            vertex: [columns[0], columns[1], columns[2], columns[3]],
            chunk: find(chunk, &BOUNDS[..bounds])?,
            rest,
            bounds: Vec::new(),
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

    pub(super) fn take(
        &mut self,
        element: &str,
        index: usize,
        row: &[f64],
        map: &mut GaussianMap<f32>,
    ) -> Result<(), Refused> {
        match element {
            "chunk" => self.bounds.push(self.read_bounds(row)?),
            "vertex" => self.push(index, row, map),
            "sh" => self.read_rest(index, row, map),
            _ => {}
        }
        Ok(())
    }

    fn read_bounds(&self, row: &[f64]) -> Result<Bounds, Refused> {
        #[allow(clippy::cast_possible_truncation, reason = "written as f32")]
        let values: Vec<f32> = self.chunk.iter().map(|&at| row[at] as f32).collect();
        if let Some(bad) = values.iter().position(|v| !v.is_finite()) {
            let found = format!("property {} is {}", BOUNDS[bad], values[bad]);
            return Err((found, "a finite number"));
        }
        let three = |from: usize| [values[from], values[from + 1], values[from + 2]];
        Ok(Bounds {
            position: [three(0), three(3)],
            log_scale: [three(6), three(9)],
            color: match values.len() {
                BOUNDS_NEEDED => [[0.0; 3], [1.0; 3]],
                _ => [three(12), three(15)],
            },
        })
    }

    fn push(&self, index: usize, row: &[f64], map: &mut GaussianMap<f32>) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "written as u32"
        )]
        let [position, rotation, scale, color] = self.vertex.map(|at| row[at] as u32);
        let bounds = &self.bounds[index / CHUNK];
        let [r, g, b, a] = [24, 16, 8, 0].map(|shift| unit(color, shift, 8));
        let rgb = between(&bounds.color, [r, g, b]);
        let mut sh = vec![[0.0; 3]; 1 + self.rest.len() / 3];
        sh[0] = rgb.map(sh::dc_from_color);
        push(
            map,
            between(&bounds.position, three(position)),
            &sh,
            between(&bounds.log_scale, three(scale)),
            unpack_rotation(rotation),
            logit(a),
            Label::Static,
        );
    }

    fn read_rest(&self, index: usize, row: &[f64], map: &mut GaussianMap<f32>) {
        #[allow(clippy::cast_possible_truncation, reason = "written as u8")]
        let value = |at: usize| match row[at] as f32 {
            v if v <= 0.0 => -4.0,
            v if v >= 255.0 => 4.0,
            v => ((v + 0.5) / 256.0 - 0.5) * 8.0,
        };
        let per_channel = self.rest.len() / 3;
        let first = index * (1 + per_channel) + 1;
        for k in 0..per_channel {
            map.sh[first + k] = [0, 1, 2].map(|c| value(self.rest[c * per_channel + k]));
        }
    }
}

/// `bits` bits of a number from bit `shift` on, from 0 to 1.
fn unit(packed: u32, shift: u32, bits: u32) -> f32 {
    let largest = (1u32 << bits) - 1;
    f32::from_f64(f64::from((packed >> shift) & largest) / f64::from(largest))
}

fn three(packed: u32) -> [f32; 3] {
    [
        unit(packed, 21, 11),
        unit(packed, 11, 10),
        unit(packed, 0, 11),
    ]
}

fn between([least, largest]: &[[f32; 3]; 2], at: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|k| least[k] * (1.0 - at[k]) + largest[k] * at[k])
}

/// w, x, y, z.
fn unpack_rotation(packed: u32) -> [f32; 4] {
    let others =
        [20, 10, 0].map(|shift| (unit(packed, shift, 10) - 0.5) * std::f32::consts::SQRT_2);
    let rest = 1.0 - others.iter().map(|v| v * v).sum::<f32>();
    let largest = rest.max(0.0).sqrt();
    let [a, b, c] = others;
    match packed >> 30 {
        0 => [largest, a, b, c],
        1 => [a, largest, b, c],
        2 => [a, b, largest, c],
        _ => [a, b, c, largest],
    }
}
