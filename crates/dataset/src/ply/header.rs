//! PLY headers: parsed with every number checked before it is believed.

use std::collections::BTreeMap;
use std::io::{BufRead, Read};
use std::path::Path;

use crate::errors::{DatasetError, excerpt};
use crate::limits;

/// Scalar types; lists are refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    /// `float`.
    F32,
    /// `uchar`.
    U8,
    /// Any other, of so many bytes: can be passed over.
    Other(usize),
}

impl Scalar {
    fn from_name(name: &str) -> Option<Self> {
        match name {
            "float" | "float32" => Some(Self::F32),
            "uchar" | "uint8" => Some(Self::U8),
            "char" | "int8" => Some(Self::Other(1)),
            "short" | "ushort" | "int16" | "uint16" => Some(Self::Other(2)),
            "int" | "uint" | "int32" | "uint32" => Some(Self::Other(4)),
            "double" | "float64" => Some(Self::Other(8)),
            _ => None,
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::U8 => 1,
            Self::Other(bytes) => bytes,
        }
    }
}

/// What a header promises, and the file can keep.
#[derive(Debug)]
pub(super) struct Header {
    /// Number of vertices.
    pub(super) count: usize,
    /// Bytes of one.
    pub(super) stride: usize,
    properties: BTreeMap<String, (usize, Scalar)>,
}

/// An error about a PLY file.
pub(super) fn error(path: &Path, found: impl Into<String>, expected: &'static str) -> DatasetError {
    DatasetError::Ply {
        path: path.to_path_buf(),
        found: found.into(),
        expected,
    }
}

impl Header {
    /// Reads up to and with `end_header`; `length` is that of the whole file, in bytes.
    ///
    /// # Errors
    /// [`DatasetError::Ply`]; [`DatasetError::TooLarge`] above [`limits::GAUSSIANS`]. After `Ok`,
    /// exactly `count * stride` bytes are left and `stride` is not 0.
    pub(super) fn read(
        path: &Path,
        reader: &mut impl BufRead,
        length: u64,
    ) -> Result<Self, DatasetError> {
        let mut lines = Lines {
            path,
            reader,
            bytes: 0,
        };
        let magic = lines.next()?;
        if magic != "ply" {
            return Err(error(path, excerpt(&magic), "`ply` in the first line"));
        }
        let mut format = None;
        let mut count: Option<usize> = None;
        let mut stride = 0;
        let mut properties = BTreeMap::new();
        loop {
            let line = lines.next()?;
            let fields: Vec<&str> = line.split_ascii_whitespace().collect();
            match fields[..] {
                ["end_header"] => break,
                ["comment" | "obj_info", ..] => {}
                ["format", name, "1.0"] if name == FORMAT && format.is_none() => {
                    format = Some(());
                }
                ["element", "vertex", number] if count.is_none() => {
                    count = Some(parse_count(path, number)?);
                }
                ["property", kind, name] if count.is_some() => {
                    let scalar = Scalar::from_name(kind).ok_or_else(|| {
                        error(path, excerpt(&line), "a property of a scalar type")
                    })?;
                    if properties
                        .insert(name.to_owned(), (stride, scalar))
                        .is_some()
                    {
                        return Err(error(path, excerpt(&line), "each property once"));
                    }
                    stride += scalar.bytes(); // at most 8 for each line of a short header
                }
                _ => return Err(error(path, excerpt(&line), SHAPE)),
            }
        }
        let (Some(()), Some(count)) = (format, count) else {
            return Err(error(path, "a header without format or vertices", SHAPE));
        };
        let header = Self {
            count,
            stride,
            properties,
        };
        header
            .column("x")
            .ok_or_else(|| header.missing(path, "x"))?;
        let left = length.saturating_sub(lines.bytes as u64);
        let promised = (count as u64).checked_mul(stride as u64);
        if promised != Some(left) {
            let found = format!("{left} bytes after the header, for {count} vertices of {stride}");
            return Err(error(path, found, "exactly that many bytes"));
        }
        Ok(header)
    }

    /// Offset of a float property in a vertex.
    pub(super) fn column(&self, name: &str) -> Option<usize> {
        match self.properties.get(name) {
            Some(&(offset, Scalar::F32)) => Some(offset),
            _ => None,
        }
    }

    /// Offset and type of any property.
    pub(super) fn property(&self, name: &str) -> Option<(usize, Scalar)> {
        self.properties.get(name).copied()
    }

    /// Number of properties whose name begins so.
    pub(super) fn count_of(&self, prefix: &str) -> usize {
        let names = self.properties.keys();
        names.filter(|name| name.starts_with(prefix)).count()
    }

    /// The error for a float property that is not there.
    pub(super) fn missing(&self, path: &Path, name: &str) -> DatasetError {
        let found = match self.properties.get(name) {
            Some(_) => format!("property {name} of another type"),
            None => format!("no property {name}"),
        };
        error(path, found, "the float properties of 3D Gaussian Splatting")
    }
}

const FORMAT: &str = "binary_little_endian";
const SHAPE: &str =
    "`format binary_little_endian 1.0`, one `element vertex N`, scalar properties, `end_header`";

fn parse_count(path: &Path, number: &str) -> Result<usize, DatasetError> {
    let found = || {
        error(
            path,
            format!("{} vertices", excerpt(number)),
            "a whole number",
        )
    };
    let count: u64 = number.parse().map_err(|_| found())?;
    if count > limits::GAUSSIANS {
        return Err(DatasetError::TooLarge {
            path: path.to_path_buf(),
            what: "number of Gaussians",
            value: count,
            limit: limits::GAUSSIANS,
        });
    }
    usize::try_from(count).map_err(|_| found())
}

/// Lines of a header, with a cap on all of them together.
struct Lines<'a, R> {
    path: &'a Path,
    reader: &'a mut R,
    bytes: usize,
}

impl<R: BufRead> Lines<'_, R> {
    fn next(&mut self) -> Result<String, DatasetError> {
        let mut line = Vec::new();
        let room = (limits::PLY_HEADER_BYTES - self.bytes) as u64;
        self.reader
            .by_ref()
            .take(room)
            .read_until(b'\n', &mut line)
            .map_err(DatasetError::io(self.path))?;
        self.bytes += line.len();
        if line.pop() != Some(b'\n') {
            let found = format!("no line end within {} bytes of header", self.bytes);
            return Err(error(self.path, found, SHAPE));
        }
        if line.last() == Some(&b'\r') {
            line.pop();
        }
        String::from_utf8(line).map_err(|e| {
            error(
                self.path,
                excerpt(&String::from_utf8_lossy(e.as_bytes())),
                SHAPE,
            )
        })
    }
}
