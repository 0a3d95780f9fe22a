//! PLY files to maps.

use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind};
use std::path::Path;

use garad_core::{GaussianMap, KeyframeId, Label};

use super::header::{Header, Scalar, error};
use crate::errors::DatasetError;

/// Reads a map. See [`parse_ply`].
///
/// # Errors
/// [`DatasetError::NotFound`], [`DatasetError::Io`], and those of [`parse_ply`].
pub fn read_ply(path: &Path) -> Result<GaussianMap<f32>, DatasetError> {
    let file = File::open(path).map_err(|source| match source.kind() {
        ErrorKind::NotFound => DatasetError::NotFound {
            path: path.to_path_buf(),
            expected: "a PLY map",
        },
        _ => DatasetError::io(path)(source),
    })?;
    let length = file.metadata().map_err(DatasetError::io(path))?.len();
    parse_ply(path, &mut BufReader::new(file), length)
}

/// Reads a map of degree 0 to 3 from `length` bytes; `path` serves the messages.
///
/// Properties are found by name, in any order; those without a meaning here are passed over.
/// Gaussians come without landmark and parent, born in keyframe 0, and static unless the file
/// has a `label`.
///
/// # Errors
/// [`DatasetError::Ply`] for another format, a missing property, a vertex with a number that is
/// not finite, a zero quaternion or an unknown label, and unless the vertices take exactly the
/// bytes that follow the header; [`DatasetError::TooLarge`] above
/// [`limits::GAUSSIANS`](crate::limits::GAUSSIANS). No memory is taken before that is known.
pub fn parse_ply(
    path: &Path,
    reader: &mut impl BufRead,
    length: u64,
) -> Result<GaussianMap<f32>, DatasetError> {
    let header = Header::read(path, reader, length)?;
    let columns = Columns::find(path, &header)?;
    let mut map = GaussianMap::new(columns.degree);
    map.means.reserve_exact(header.count);
    map.sh.reserve_exact(header.count * map.coefficients());
    let mut vertex = vec![0; header.stride];
    for index in 0..header.count {
        reader
            .read_exact(&mut vertex)
            .map_err(DatasetError::io(path))?;
        columns
            .push(&vertex, &mut map)
            .map_err(|(found, expected)| {
                error(path, format!("vertex {index}: {found}"), expected)
            })?;
    }
    Ok(map)
}

/// Where the numbers of a Gaussian stand in a vertex, in bytes.
struct Columns {
    degree: usize,
    mean: [usize; 3],
    dc: [usize; 3],
    /// Red, then green, then blue.
    rest: Vec<usize>,
    opacity: usize,
    scale: [usize; 3],
    rotation: [usize; 4],
    label: Option<(usize, Scalar)>,
}

impl Columns {
    fn find(path: &Path, header: &Header) -> Result<Self, DatasetError> {
        let column = |name: &str| {
            header
                .column(name)
                .ok_or_else(|| header.missing(path, name))
        };
        let numbered = |prefix: &str, i: usize| column(&format!("{prefix}{i}"));
        let three = |prefix: &str| -> Result<[usize; 3], DatasetError> {
            Ok([
                numbered(prefix, 0)?,
                numbered(prefix, 1)?,
                numbered(prefix, 2)?,
            ])
        };
        let rest_count = header.count_of("f_rest_");
        let degree = match rest_count {
            0 => 0,
            9 => 1,
            24 => 2,
            45 => 3,
            n => {
                let found = format!("{n} properties f_rest");
                return Err(error(path, found, "0, 9, 24 or 45 (degree 0 to 3)"));
            }
        };
        let label = header.property("label");
        if let Some((_, Scalar::Other(_))) = label {
            let found = "property label of another type";
            return Err(error(path, found, "uchar or float"));
        }
        Ok(Self {
            degree,
            mean: [column("x")?, column("y")?, column("z")?],
            dc: three("f_dc_")?,
            rest: (0..rest_count)
                .map(|i| numbered("f_rest_", i))
                .collect::<Result<_, _>>()?,
            opacity: column("opacity")?,
            scale: three("scale_")?,
            rotation: [
                numbered("rot_", 0)?,
                numbered("rot_", 1)?,
                numbered("rot_", 2)?,
                numbered("rot_", 3)?,
            ],
            label,
        })
    }

    /// Appends the Gaussian of one vertex, or says what was found and expected.
    fn push(
        &self,
        vertex: &[u8],
        map: &mut GaussianMap<f32>,
    ) -> Result<(), (String, &'static str)> {
        let float = |at: usize| {
            let mut bytes = [0; 4];
            bytes.copy_from_slice(&vertex[at..at + 4]);
            f32::from_le_bytes(bytes)
        };
        let quaternion = self.rotation.map(float);
        if quaternion.iter().all(|v| v.abs() <= 0.0) {
            return Err(("a zero quaternion".to_owned(), "a rotation"));
        }
        let (mean, scale, opacity) = (
            self.mean.map(float),
            self.scale.map(float),
            float(self.opacity),
        );
        let first_sh = map.sh.len();
        map.sh.push(self.dc.map(float));
        let per_channel = self.rest.len() / 3;
        for k in 0..per_channel {
            let channel = |c: usize| float(self.rest[c * per_channel + k]);
            map.sh.push([channel(0), channel(1), channel(2)]);
        }
        let finite = [&mean[..], &scale[..], &quaternion[..], &[opacity]]
            .into_iter()
            .chain(map.sh[first_sh..].iter().map(|triple| &triple[..]))
            .flatten()
            .all(|v| v.is_finite());
        if !finite {
            let found = "a number that is not finite".to_owned();
            return Err((found, "finite numbers"));
        }
        let label = match self.label {
            None => 0.0,
            Some((at, Scalar::U8)) => f32::from(vertex[at]),
            Some((at, _)) => float(at),
        };
        #[allow(clippy::float_cmp, reason = "labels are exactly 0 or 1")]
        let label = match label {
            0.0 => Label::Static,
            1.0 => Label::Dynamic,
            other => return Err((format!("label {other}"), "0 (static) or 1 (dynamic)")),
        };
        map.means.push(mean);
        map.log_scales.push(scale);
        map.quaternions.push(quaternion);
        map.opacity_logits.push(opacity);
        map.landmark.push(None);
        map.parent.push(None);
        map.born.push(KeyframeId(0));
        map.label.push(label);
        Ok(())
    }
}
