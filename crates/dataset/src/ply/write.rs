//! Maps to PLY files.

use std::io::{self, Write};
use std::path::Path;

use garad_core::{GaussianMap, Label};

use crate::atomic::write_atomically;
use crate::errors::DatasetError;

/// SH coefficients per channel in the standard vertex.
const COEFFICIENTS: usize = 16;

/// Floats in the standard vertex.
const STANDARD_FLOATS: usize = 62;

/// Names of the standard vertex's properties, in order.
fn standard_names() -> Vec<String> {
    let numbered = |name: &'static str, n: usize| (0..n).map(move |i| format!("{name}{i}"));
    let plain = |names: [&str; 3]| names.map(str::to_owned);
    let mut names = Vec::with_capacity(STANDARD_FLOATS);
    names.extend(plain(["x", "y", "z"]));
    names.extend(plain(["nx", "ny", "nz"]));
    names.extend(numbered("f_dc_", 3));
    names.extend(numbered("f_rest_", 45));
    names.push("opacity".to_owned());
    names.extend(numbered("scale_", 3));
    names.extend(numbered("rot_", 4));
    names
}

/// What goes into the file besides the standard 62 floats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PlyOptions {
    /// Appends `uchar label`. Off by default: some viewers accept the standard vertex alone.
    pub label: bool,
}

/// Writes a map, whole or not at all.
///
/// # Errors
/// [`DatasetError::Map`] for numbers that are not finite, [`DatasetError::Io`].
pub fn write_ply(
    path: &Path,
    map: &GaussianMap<f32>,
    options: &PlyOptions,
) -> Result<(), DatasetError> {
    map.validate().map_err(|problem| DatasetError::Map {
        path: path.to_path_buf(),
        problem,
    })?;
    write_atomically(path, |out| format_ply(out, map, options))
}

/// The version of garad that last changed the layout. Not that of the program: a release that draws
/// the same map writes the same bytes.
const LAYOUT: &str = "0.1.0";

/// Writes a map to a stream; the same map gives the same bytes. The layout is in the
/// [module's documentation](super).
///
/// # Errors
/// Those of `out`.
pub fn format_ply(
    out: &mut impl Write,
    map: &GaussianMap<f32>,
    options: &PlyOptions,
) -> io::Result<()> {
    writeln!(out, "ply")?;
    writeln!(out, "format binary_little_endian 1.0")?;
    writeln!(
        out,
        "comment garad {LAYOUT}: metres, x right, y down, z forward"
    )?;
    writeln!(out, "element vertex {}", map.len())?;
    for name in standard_names() {
        writeln!(out, "property float {name}")?;
    }
    if options.label {
        writeln!(out, "property uchar label")?;
    }
    writeln!(out, "end_header")?;
    let mut vertex = Vec::with_capacity(STANDARD_FLOATS * 4 + 1);
    for i in 0..map.len() {
        vertex.clear();
        let mut put = |value: f32| vertex.extend_from_slice(&value.to_le_bytes());
        map.means[i].into_iter().for_each(&mut put);
        [0.0; 3].into_iter().for_each(&mut put); // nx ny nz
        let sh = map.sh_of(i);
        sh[0].into_iter().for_each(&mut put);
        for channel in 0..3 {
            for k in 1..COEFFICIENTS {
                put(sh.get(k).map_or(0.0, |triple| triple[channel]));
            }
        }
        put(map.opacity_logits[i]);
        map.log_scales[i].into_iter().for_each(&mut put);
        map.quaternions[i].into_iter().for_each(&mut put);
        if options.label {
            vertex.push(u8::from(map.label[i] == Label::Dynamic));
        }
        out.write_all(&vertex)?;
    }
    Ok(())
}
