//! PLY files to maps. `serde-ply` reads headers and numbers; what it lets through is checked here.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, ErrorKind, Read};
use std::path::Path;

use garad_core::{GaussianMap, KeyframeId, Label};
use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, Visitor};
use serde_ply::{DeserializeError, ElementDef, PlyReader, PropertyType, RowVisitor, ScalarType};

use crate::errors::{DatasetError, excerpt};
use crate::limits;

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
    parse_ply(path, &mut BufReader::new(file))
}

/// Reads a map of degree 0 to 3 in ASCII or binary of either byte order; `path` serves the messages.
///
/// Properties are found by name, in any order; unknown ones are ignored. Gaussians come without
/// landmark and parent, born in keyframe 0, and static unless the file has a `label`.
///
/// # Errors
/// [`DatasetError::Ply`] for a bad header, a missing property, a vertex with a number that is not
/// finite, a zero quaternion or an unknown label, and unless the vertices take all the bytes that follow
/// the header; [`DatasetError::TooLarge`] above [`limits::GAUSSIANS`].
/// Memory grows with what has been read, not with what the header promises.
pub fn parse_ply(path: &Path, reader: &mut impl BufRead) -> Result<GaussianMap<f32>, DatasetError> {
    let (header, ascii) = read_header(path, reader)?;
    // `serde-ply` wants white space behind the last number of an ASCII file.
    let end: &[u8] = if ascii { b"\n" } else { b"" };
    let mut file = Cursor::new(header).chain(reader).chain(end);
    let mut ply = PlyReader::from_reader(&mut file)
        .map_err(|DeserializeError(e)| error(path, e.to_string(), HEADER))?;
    let columns = match &ply.header().elem_defs[..] {
        [vertex] if vertex.name == "vertex" => Columns::find(path, vertex)?,
        elements => {
            let names: Vec<&str> = elements.iter().map(|e| e.name.as_str()).collect();
            let found = format!("elements {}", excerpt(&names.join(" ")));
            return Err(error(path, found, HEADER));
        }
    };
    let mut map = GaussianMap::new(columns.degree);
    let mut read = 0;
    let mut refused = None;
    let mut rows = RowVisitor::new(|Row(values)| {
        if refused.is_none() {
            refused = columns.push(&values, &mut map).err();
            read += usize::from(refused.is_none());
        }
    });
    let outcome = (&mut ply).next_value_seed(&mut rows);
    let wrong = refused.or_else(|| {
        let DeserializeError(e) = outcome.err()?;
        let found = match e.kind() {
            ErrorKind::UnexpectedEof => "the file ends".to_owned(),
            _ => e.to_string(),
        };
        Some((found, "as many numbers as the header promises"))
    });
    if let Some((found, expected)) = wrong {
        return Err(error(path, format!("vertex {read}: {found}"), expected));
    }
    let mut rest = Vec::new();
    (file.take(limits::LINE_BYTES as u64).read_to_end(&mut rest))
        .map_err(DatasetError::io(path))?;
    if !rest.iter().all(|byte| ascii && byte.is_ascii_whitespace()) {
        return Err(error(path, "bytes after the last vertex", "none"));
    }
    Ok(map)
}

const HEADER: &str = "`format NAME 1.0` with NAME ascii, binary_little_endian or binary_big_endian, \
                      one `element vertex N`, scalar properties, `end_header`";
const FLOATS: &str = "the float properties of 3D Gaussian Splatting";

fn error(path: &Path, found: impl Into<String>, expected: &'static str) -> DatasetError {
    DatasetError::Ply {
        path: path.to_path_buf(),
        found: found.into(),
        expected,
    }
}

/// The bytes up to and with `end_header`, at most [`limits::PLY_HEADER_BYTES`], and whether numbers are
/// text. Lines of an unknown kind are refused.
fn read_header(path: &Path, reader: &mut impl BufRead) -> Result<(Vec<u8>, bool), DatasetError> {
    let (mut header, mut ascii) = (Vec::new(), false);
    let mut capped = reader.take(limits::PLY_HEADER_BYTES as u64);
    loop {
        let start = header.len();
        (capped.read_until(b'\n', &mut header)).map_err(DatasetError::io(path))?;
        let Some(line) = header[start..].strip_suffix(b"\n") else {
            let found = format!("no line end within {} bytes of header", header.len());
            return Err(error(path, found, HEADER));
        };
        let line = String::from_utf8_lossy(line);
        let fields: Vec<&str> = line.split_ascii_whitespace().collect();
        match fields[..] {
            ["ply"] if start == 0 => {}
            _ if start == 0 => {
                return Err(error(
                    path,
                    excerpt(line.trim_end()),
                    "`ply` in the first line",
                ));
            }
            ["end_header"] => return Ok((header, ascii)),
            ["format", name, "1.0"] => ascii = name == "ascii",
            ["comment" | "obj_info", ..] => {}
            ["element", _, _] | ["property", _, _] | ["property", "list", _, _, _] => {}
            _ => return Err(error(path, excerpt(line.trim_end()), HEADER)),
        }
    }
}

/// The numbers of a vertex in the order of the file. An f64 holds any of PLY's types exactly.
struct Row(Vec<f64>);

impl<'de> Deserialize<'de> for Row {
    fn deserialize<D: Deserializer<'de>>(row: D) -> Result<Self, D::Error> {
        struct Values;

        impl<'de> Visitor<'de> for Values {
            type Value = Row;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("numbers")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut row: A) -> Result<Row, A::Error> {
                let mut values = Vec::new();
                while row.next_key::<IgnoredAny>()?.is_some() {
                    values.push(row.next_value()?);
                }
                Ok(Row(values))
            }
        }
        row.deserialize_map(Values)
    }
}

/// Positions of the numbers of a Gaussian in a [`Row`].
struct Columns {
    degree: usize,
    mean: [usize; 3],
    dc: [usize; 3],
    /// Red, then green, then blue.
    rest: Vec<usize>,
    opacity: usize,
    scale: [usize; 3],
    rotation: [usize; 4],
    label: Option<usize>,
    /// Names of all of these but the label, in the order of the file.
    names: Vec<(usize, String)>,
}

impl Columns {
    fn find(path: &Path, vertex: &ElementDef) -> Result<Self, DatasetError> {
        let count = vertex.count as u64;
        if count > limits::GAUSSIANS {
            return Err(DatasetError::TooLarge {
                path: path.to_path_buf(),
                what: "number of Gaussians",
                value: count,
                limit: limits::GAUSSIANS,
            });
        }
        let mut columns = BTreeMap::new();
        for (i, property) in vertex.properties.iter().enumerate() {
            let name = property.name.as_str();
            let PropertyType::Scalar(kind) = property.property_type else {
                return Err(error(
                    path,
                    format!("list {name}"),
                    "properties of a scalar type",
                ));
            };
            if columns.insert(name, (i, kind)).is_some() {
                return Err(error(
                    path,
                    format!("two properties {name}"),
                    "each property once",
                ));
            }
        }
        let float = |name: &str| match columns.get(name) {
            Some(&(i, ScalarType::F32)) => Ok(i),
            Some(_) => Err(error(
                path,
                format!("property {name} of another type"),
                FLOATS,
            )),
            None => Err(error(path, format!("no property {name}"), FLOATS)),
        };
        let rest_count = columns
            .keys()
            .filter(|name| name.starts_with("f_rest_"))
            .count();
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
        let label = match columns.get("label") {
            None => None,
            Some(&(i, ScalarType::U8 | ScalarType::F32)) => Some(i),
            Some(_) => {
                return Err(error(
                    path,
                    "property label of another type",
                    "uchar or float",
                ));
            }
        };
        let rest = (0..rest_count).map(|i| float(&format!("f_rest_{i}")));
        let mut found = Self {
            degree,
            mean: [float("x")?, float("y")?, float("z")?],
            dc: [float("f_dc_0")?, float("f_dc_1")?, float("f_dc_2")?],
            rest: rest.collect::<Result<_, _>>()?,
            opacity: float("opacity")?,
            scale: [float("scale_0")?, float("scale_1")?, float("scale_2")?],
            rotation: [
                float("rot_0")?,
                float("rot_1")?,
                float("rot_2")?,
                float("rot_3")?,
            ],
            label,
            names: Vec::new(),
        };
        let triples = [found.mean, found.dc, found.scale];
        let read = [triples.as_flattened(), &found.rest, &found.rotation];
        let read = [&read.concat()[..], &[found.opacity]].concat();
        let names = columns
            .iter()
            .map(|(name, &(i, _))| (i, (*name).to_owned()));
        found.names = names.filter(|(i, _)| read.contains(i)).collect();
        found.names.sort_unstable();
        Ok(found)
    }

    /// Appends the Gaussian of one vertex, or returns what was found and expected.
    fn push(
        &self,
        values: &[f64],
        map: &mut GaussianMap<f32>,
    ) -> Result<(), (String, &'static str)> {
        #[allow(clippy::cast_possible_truncation, reason = "read as f32")]
        let float = |at: usize| values[at] as f32;
        let quaternion = self.rotation.map(float);
        if quaternion.iter().all(|v| v.abs() <= 0.0) {
            return Err(("a zero quaternion".to_owned(), "a rotation"));
        }
        let per_channel = self.rest.len() / 3;
        let higher = (0..per_channel).map(|k| [0, 1, 2].map(|c| self.rest[c * per_channel + k]));
        let mut sh = vec![self.dc.map(float)];
        sh.extend(higher.map(|triple| triple.map(float)));
        let (mean, scale) = (self.mean.map(float), self.scale.map(float));
        let opacity = float(self.opacity);
        if let Some((at, name)) = self.names.iter().find(|(at, _)| !float(*at).is_finite()) {
            let found = format!("{name} is not finite ({})", float(*at));
            return Err((found, "finite numbers"));
        }
        #[allow(clippy::float_cmp, reason = "labels are exactly 0 or 1")]
        let label = match self.label.map_or(0.0, float) {
            0.0 => Label::Static,
            1.0 => Label::Dynamic,
            other => return Err((format!("label {other}"), "0 (static) or 1 (dynamic)")),
        };
        map.means.push(mean);
        map.sh.extend(sh);
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
