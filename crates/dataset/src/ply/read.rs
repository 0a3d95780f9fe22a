//! PLY files to maps. `serde-ply` reads headers and numbers; what it lets through is checked here.

use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, ErrorKind, Read};
use std::path::Path;

use garad_core::GaussianMap;
use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_ply::{DeserializeError, ElementDef, PlyReader, RowVisitor};

use super::columns::Columns;
use super::packed::Packed;
use super::property::{Refused, error, names};
use crate::errors::{DatasetError, excerpt};
use crate::limits;

/// Reads a map. See [`parse_ply`].
///
/// # Errors
/// [`DatasetError::NotFound`], [`DatasetError::Io`], and those of [`parse_ply`].
pub fn read_ply(path: &Path) -> Result<GaussianMap<f32>, DatasetError> {
    let file = File::open(path).map_err(|source| match source.kind() {
        ErrorKind::NotFound => DatasetError::not_found(path, "a PLY map"),
        _ => DatasetError::io(path)(source),
    })?;
    if path.is_dir() {
        return Err(DatasetError::not_found(path, "a PLY map"));
    }
    parse_ply(path, &mut BufReader::new(file))
}

/// Reads a map of degree 0 to 3 in ASCII or binary of either byte order; `path` serves the messages.
///
/// Properties are found by name, in any order and of any type; unknown ones and other elements are skipped.
/// Files of other programs: see the [module's table](super). Gaussians come without landmark and parent, born in
/// keyframe 0, and static unless the file has a `label`.
///
/// # Errors
/// [`DatasetError::Ply`] for a bad header, a missing property, a vertex with a number that cannot be used (named with
/// its property and value), a zero quaternion or an unknown label, and unless the elements take all the bytes that
/// follow the header (a last newline aside); [`DatasetError::TooLarge`] above [`limits::GAUSSIANS`].
/// Memory grows with what has been read, not with what the header promises.
pub fn parse_ply(path: &Path, reader: &mut impl BufRead) -> Result<GaussianMap<f32>, DatasetError> {
    let (header, ascii) = read_header(path, reader)?;
    // `serde-ply` wants white space behind the last number of an ASCII file.
    let end: &[u8] = if ascii { b"\n" } else { b"" };
    let mut file = Cursor::new(header).chain(reader).chain(end);
    let mut ply = PlyReader::from_reader(&mut file)
        .map_err(|DeserializeError(e)| error(path, e.to_string(), HEADER))?;
    let elements = ply.header().elem_defs.clone();
    let mut vertices = Vertices::find(path, &elements)?;
    for element in &elements {
        let (mut read, mut refused) = (0, None);
        let mut rows = RowVisitor::new(|Row(values)| {
            if refused.is_none() {
                refused = vertices.take(&element.name, read, &values).err();
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
            let found = format!("{} {read}: {found}", element.name);
            return Err(error(path, found, expected));
        }
    }
    let mut rest = Vec::new();
    (file.take(limits::LINE_BYTES as u64).read_to_end(&mut rest))
        .map_err(DatasetError::io(path))?;
    let line_end = matches!(&rest[..], b"\n" | b"\r\n");
    if !line_end && !rest.iter().all(|byte| ascii && byte.is_ascii_whitespace()) {
        return Err(error(path, "bytes after the last element", "none"));
    }
    Ok(vertices.map)
}

const HEADER: &str = "`format NAME 1.0` with NAME ascii, binary_little_endian or binary_big_endian, \
                      one `element vertex N`, its properties, `end_header`";

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
            _ if header.starts_with(b"\x1f\x8b") => {
                return Err(error(path, "a gzip file", "a PLY file, unpacked"));
            }
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

/// The numbers of a row in the order of the file; NaN for a list, which is skipped. An f64 holds any of PLY's types
/// exactly.
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
                    let Cell(value) = row.next_value()?;
                    values.push(value);
                }
                Ok(Row(values))
            }
        }
        row.deserialize_map(Values)
    }
}

struct Cell(f64);

impl<'de> Deserialize<'de> for Cell {
    fn deserialize<D: Deserializer<'de>>(cell: D) -> Result<Self, D::Error> {
        struct Value;

        impl<'de> Visitor<'de> for Value {
            type Value = Cell;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number or a list")
            }

            fn visit_f64<E>(self, value: f64) -> Result<Cell, E> {
                Ok(Cell(value))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Cell, E> {
                Ok(Cell(value as f64)) // of 32 bits at most
            }

            fn visit_u64<E>(self, value: u64) -> Result<Cell, E> {
                Ok(Cell(value as f64)) // of 32 bits at most
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Cell, A::Error> {
                while list.next_element::<IgnoredAny>()?.is_some() {}
                Ok(Cell(f64::NAN))
            }
        }
        cell.deserialize_any(Value)
    }
}

/// The Gaussians of a file, as its elements are read.
struct Vertices {
    layout: Layout,
    map: GaussianMap<f32>,
}

/// How the file holds them.
enum Layout {
    Plain(Box<Columns>),
    Packed(Packed),
}

impl Vertices {
    fn find(path: &Path, elements: &[ElementDef]) -> Result<Self, DatasetError> {
        for element in elements {
            if element.count as u64 > limits::GAUSSIANS {
                return Err(DatasetError::TooLarge {
                    path: path.to_path_buf(),
                    what: "number of Gaussians",
                    value: element.count as u64,
                    limit: limits::GAUSSIANS,
                });
            }
            if element.properties.is_empty() && element.count > 0 {
                let found = format!("element {} without properties", excerpt(&element.name));
                return Err(error(path, found, HEADER));
            }
        }
        let mut vertices = elements.iter().filter(|e| e.name == "vertex");
        let (Some(vertex), None) = (vertices.next(), vertices.next()) else {
            let names: Vec<&str> = elements.iter().map(|e| e.name.as_str()).collect();
            let found = format!("elements {}", excerpt(&names.join(" ")));
            return Err(error(path, found, HEADER));
        };
        let columns = names(path, vertex)?;
        if columns.contains_key("packed_position") {
            let packed = Packed::find(path, elements)?;
            return Ok(Self {
                map: GaussianMap::new(packed.degree()),
                layout: Layout::Packed(packed),
            });
        }
        let columns = Columns::find(path, &columns)?;
        Ok(Self {
            map: GaussianMap::new(columns.degree()),
            layout: Layout::Plain(Box::new(columns)),
        })
    }

    /// Takes row `index` of an element; rows of unknown elements are skipped.
    fn take(&mut self, element: &str, index: usize, values: &[f64]) -> Result<(), Refused> {
        match &mut self.layout {
            Layout::Plain(columns) if element == "vertex" => columns.push(values, &mut self.map),
            Layout::Packed(packed) => packed.take(element, index, values, &mut self.map),
            Layout::Plain(_) => Ok(()),
        }
    }
}
