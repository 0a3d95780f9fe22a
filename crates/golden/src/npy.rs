//! [`decode`] and [`encode`]: numpy's `.npy` files, version 1.0, little-endian, C order.
//!
//! Layout: `\x93NUMPY`, version 1 0, header length (u16), a Python dict literal with the keys
//! `descr`, `fortran_order` and `shape`, then the elements. The header is read by a parser that
//! knows this one dict and nothing else. Nothing is allocated from what a header claims: the
//! claimed size is computed with checked arithmetic and must be the number of bytes that are
//! really there.

use thiserror::Error;

use crate::tensor::{Dtype, Tensor, checked_len};

const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Magic, version, header length.
const PREAMBLE: usize = 10;
/// numpy pads headers so that the elements start at a multiple of this.
const ALIGNMENT: usize = 64;
/// numpy leaves room for the first size to grow to this many digits in place.
const GROWTH_DIGITS: usize = 21;
/// numpy's own limit on dimensions.
const MAX_DIMENSIONS: usize = 32;

/// Why bytes are not a `.npy` file that golden cases use.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum NpyError {
    /// No `\x93NUMPY` at the start.
    #[error("not a .npy file: the first six bytes are not \\x93NUMPY")]
    Magic,
    /// A version other than 1.0.
    #[error(".npy version {major}.{minor}; expected 1.0")]
    Version {
        /// Found.
        major: u8,
        /// Found.
        minor: u8,
    },
    /// The file ends inside the header.
    #[error("header of {claimed} bytes, but {there} are there")]
    Truncated {
        /// Bytes the file says its header has.
        claimed: usize,
        /// Bytes left.
        there: usize,
    },
    /// The header is not the dict expected.
    #[error("header: expected {expected} at byte {at}")]
    Header {
        /// What should have stood there.
        expected: &'static str,
        /// Position in the header.
        at: usize,
    },
    /// An element type golden cases do not use, big-endian ones among them.
    #[error("element type '{descr}' is not one of <f4 <f8 |i1 |u1 <i2 <u2 <i4 <u4 <i8 |b1")]
    Dtype {
        /// numpy's descriptor.
        descr: String,
    },
    /// `fortran_order: True`.
    #[error("Fortran order; expected C order")]
    FortranOrder,
    /// The shape asks for another number of bytes than the file holds.
    #[error("shape {shape:?} of '{descr}' does not have the {there} bytes that are there")]
    Size {
        /// Claimed.
        shape: Vec<usize>,
        /// Claimed.
        descr: &'static str,
        /// Bytes after the header.
        there: usize,
    },
    /// A bool that is neither 0 nor 1.
    #[error("bool at position {at} has the value {value}")]
    Bool {
        /// Flat position.
        at: usize,
        /// Its byte.
        value: u8,
    },
}

/// Reads a `.npy` file.
///
/// # Errors
/// [`NpyError`] with what was found; never a panic and never an allocation beyond the input.
pub fn decode(bytes: &[u8]) -> Result<Tensor, NpyError> {
    let rest = bytes.strip_prefix(MAGIC).ok_or(NpyError::Magic)?;
    let [major, minor, low, high, rest @ ..] = rest else {
        return Err(NpyError::Truncated {
            claimed: PREAMBLE - MAGIC.len(),
            there: rest.len(),
        });
    };
    if (*major, *minor) != (1, 0) {
        return Err(NpyError::Version {
            major: *major,
            minor: *minor,
        });
    }
    let claimed = usize::from(u16::from_le_bytes([*low, *high]));
    let (header, data) = rest.split_at_checked(claimed).ok_or(NpyError::Truncated {
        claimed,
        there: rest.len(),
    })?;
    let (descr, fortran_order, shape) = HeaderParser { header, at: 0 }.parse()?;
    let dtype = Dtype::from_descr(descr).ok_or_else(|| NpyError::Dtype {
        descr: descr.to_owned(),
    })?;
    if fortran_order {
        return Err(NpyError::FortranOrder);
    }
    let size = checked_len(&shape).and_then(|n| n.checked_mul(dtype.size()));
    if size != Some(data.len()) {
        return Err(NpyError::Size {
            shape,
            descr: dtype.descr(),
            there: data.len(),
        });
    }
    if dtype == Dtype::Bool
        && let Some(at) = data.iter().position(|&b| b > 1)
    {
        return Err(NpyError::Bool {
            at,
            value: data[at],
        });
    }
    Tensor::from_bytes(dtype, shape.clone(), data.to_vec()).ok_or(NpyError::Size {
        shape,
        descr: dtype.descr(),
        there: data.len(),
    })
}

/// Writes a `.npy` file, the same bytes as `numpy.save`.
///
/// # Panics
/// For a shape so long that its header passes 64 KiB (numpy stops at 32 dimensions).
#[must_use]
pub fn encode(tensor: &Tensor) -> Vec<u8> {
    let sizes: Vec<String> = tensor.shape().iter().map(usize::to_string).collect();
    let shape = match sizes.as_slice() {
        [one] => format!("({one},)"),
        many => format!("({})", many.join(", ")),
    };
    let dict = format!(
        "{{'descr': '{}', 'fortran_order': False, 'shape': {shape}, }}",
        tensor.dtype().descr()
    );
    let growth = sizes.first().map_or(0, |first| GROWTH_DIGITS - first.len());
    let unpadded = PREAMBLE + dict.len() + growth + 1;
    let padding = unpadded.next_multiple_of(ALIGNMENT) - unpadded;
    let padding = padding + growth;
    let header = u16::try_from(dict.len() + padding + 1).expect("at most 32 dimensions");
    let mut bytes = Vec::with_capacity(PREAMBLE + dict.len() + padding + 1 + tensor.bytes().len());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&[1, 0]);
    bytes.extend_from_slice(&header.to_le_bytes());
    bytes.extend_from_slice(dict.as_bytes());
    bytes.resize(bytes.len() + padding, b' ');
    bytes.push(b'\n');
    bytes.extend_from_slice(tensor.bytes());
    bytes
}

/// Reads `{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4), }`, keys in any order.
struct HeaderParser<'a> {
    header: &'a [u8],
    at: usize,
}

impl<'a> HeaderParser<'a> {
    fn parse(mut self) -> Result<(&'a str, bool, Vec<usize>), NpyError> {
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        self.expect(b'{', "{")?;
        while !self.take(b'}') {
            let key = self.string()?;
            self.expect(b':', ":")?;
            match key {
                "descr" if descr.is_none() => descr = Some(self.string()?),
                "fortran_order" if fortran_order.is_none() => fortran_order = Some(self.boolean()?),
                "shape" if shape.is_none() => shape = Some(self.shape()?),
                _ => return Err(self.expected("descr, fortran_order or shape, each once")),
            }
            if !self.take(b',') && self.peek() != Some(b'}') {
                return Err(self.expected(", or }"));
            }
        }
        if self.peek().is_some() {
            return Err(self.expected("nothing but blanks after }"));
        }
        match (descr, fortran_order, shape) {
            (Some(descr), Some(fortran_order), Some(shape)) => Ok((descr, fortran_order, shape)),
            _ => Err(self.expected("descr, fortran_order and shape before the end")),
        }
    }

    fn expected(&self, expected: &'static str) -> NpyError {
        NpyError::Header {
            expected,
            at: self.at,
        }
    }

    /// The next byte that is not blank.
    fn peek(&mut self) -> Option<u8> {
        while let Some(b' ' | b'\n' | b'\t' | b'\r') = self.header.get(self.at) {
            self.at += 1;
        }
        self.header.get(self.at).copied()
    }

    fn take(&mut self, byte: u8) -> bool {
        let found = self.peek() == Some(byte);
        self.at += usize::from(found);
        found
    }

    fn expect(&mut self, byte: u8, name: &'static str) -> Result<(), NpyError> {
        if self.take(byte) {
            Ok(())
        } else {
            Err(self.expected(name))
        }
    }

    /// Bytes from here on for which `accept` holds.
    fn run(&mut self, accept: fn(&u8) -> bool) -> &'a str {
        let start = self.at;
        self.at += self.header[start..]
            .iter()
            .take_while(|b| accept(b))
            .count();
        std::str::from_utf8(&self.header[start..self.at]).unwrap_or_default()
    }

    fn string(&mut self) -> Result<&'a str, NpyError> {
        self.expect(b'\'', "'")?;
        let text = self.run(|&b| b.is_ascii_graphic() && b != b'\'' && b != b'\\');
        self.expect(b'\'', "'")?;
        Ok(text)
    }

    fn boolean(&mut self) -> Result<bool, NpyError> {
        self.peek();
        match self.run(u8::is_ascii_alphabetic) {
            "True" => Ok(true),
            "False" => Ok(false),
            _ => Err(self.expected("True or False")),
        }
    }

    /// `()`, `(3,)`, `(3, 4)`.
    fn shape(&mut self) -> Result<Vec<usize>, NpyError> {
        let mut shape = Vec::new();
        self.expect(b'(', "(")?;
        while !self.take(b')') {
            self.peek();
            let size = self.run(u8::is_ascii_digit).parse();
            shape.push(size.map_err(|_| self.expected("a size"))?);
            if shape.len() > MAX_DIMENSIONS {
                return Err(self.expected("at most 32 dimensions"));
            }
            if !self.take(b',') && self.peek() != Some(b')') {
                return Err(self.expected(", or )"));
            }
        }
        Ok(shape)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn file(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend_from_slice(&[1, 0]);
        bytes.extend_from_slice(&u16::try_from(header.len()).unwrap().to_le_bytes());
        bytes.extend_from_slice(header.as_bytes());
        bytes.extend_from_slice(data);
        bytes
    }

    /// What `numpy.save` writes for `np.array([[1.5], [-2.0]])`, byte for byte.
    #[test]
    fn the_bytes_are_numpys() {
        let mut numpy =
            b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f8', 'fortran_order': False, 'shape': (2, 1), }"
                .to_vec();
        numpy.resize(127, b' ');
        numpy.push(b'\n');
        numpy.extend_from_slice(&[0, 0, 0, 0, 0, 0, 0xF8, 0x3F, 0, 0, 0, 0, 0, 0, 0, 0xC0]);
        let tensor = decode(&numpy).unwrap();
        assert_eq!(tensor.f64(), [1.5, -2.0], "values");
        assert_eq!(tensor.shape(), [2, 1], "shape");
        assert_eq!(encode(&tensor), numpy, "and back");
    }

    #[test]
    fn scalars_and_empty_arrays() {
        let scalar = file(
            "{'descr': '|u1', 'fortran_order': False, 'shape': (), }\n",
            &[7],
        );
        assert_eq!(
            decode(&scalar).unwrap().u8(),
            [7],
            "no dimension, one element"
        );
        let empty = file(
            "{'shape': (0, 4), 'descr': '<i4', 'fortran_order': False}",
            &[],
        );
        assert_eq!(decode(&empty).unwrap().shape(), [0, 4], "keys in any order");
    }

    #[test]
    fn hostile_headers_are_refused() {
        let with_shape = |shape: &str| {
            file(
                &format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"),
                &[0; 16],
            )
        };
        let size = |bytes: &[u8]| matches!(decode(bytes), Err(NpyError::Size { there: 16, .. }));
        assert!(size(&with_shape("(3,)")), "more than is there");
        assert!(size(&with_shape("(1,)")), "less than is there");
        assert!(
            size(&with_shape("(4294967296, 4294967296, 2)")),
            "product overflows"
        );
        assert!(
            size(&with_shape("(2305843009213693953,)")),
            "times 8 overflows to 8"
        );
        let header = |bytes: &[u8]| matches!(decode(bytes), Err(NpyError::Header { .. }));
        for shape in [
            "(99999999999999999999,)",
            "(-2,)",
            "(2",
            "2",
            "(2 2)",
            "(,)",
        ] {
            assert!(header(&with_shape(shape)), "{shape}");
        }
        let many = format!("({})", "1, ".repeat(33));
        assert!(header(&with_shape(&many)), "33 dimensions");
        for dict in [
            "",
            "{}",
            "{'descr': '|u1', 'fortran_order': False, 'shape': ()",
            "{'descr': '|u1', 'descr': '|u1', 'fortran_order': False, 'shape': ()}",
            "{'descr': '|u1', 'fortran_order': 0, 'shape': ()}",
            "{'descr': '|u1', 'fortran_order': False, 'shape': (), 'x': 1}",
            "{'descr': [('a', '|u1')], 'fortran_order': False, 'shape': ()}",
            "{'descr': '|u1', 'fortran_order': False, 'shape': ()} + evil()",
        ] {
            assert!(header(&file(dict, &[0])), "{dict}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let dict = |descr: &str, order: &str| {
            file(
                &format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': (1,), }}"),
                &[2],
            )
        };
        assert_eq!(
            decode(&dict(">f8", "False")),
            Err(NpyError::Dtype {
                descr: ">f8".into()
            }),
            "big-endian"
        );
        assert_eq!(
            decode(&dict("|u1", "True")),
            Err(NpyError::FortranOrder),
            "order"
        );
        assert_eq!(
            decode(&dict("|b1", "False")),
            Err(NpyError::Bool { at: 0, value: 2 }),
            "bool"
        );
        assert_eq!(decode(b"PK\x03\x04"), Err(NpyError::Magic), "an archive");
        assert_eq!(
            decode(b"\x93NUMPY\x02\x00\0\0\0\0"),
            Err(NpyError::Version { major: 2, minor: 0 }),
            "version"
        );
        assert_eq!(
            decode(b"\x93NUMPY\x01\x00\xff\xff{}"),
            Err(NpyError::Truncated {
                claimed: 65_535,
                there: 2
            }),
            "header longer than the file"
        );
    }

    proptest! {
        #[test]
        fn written_tensors_read_back(
            rows in 0usize..5, columns in 0usize..5, kind in 0usize..10, fill in any::<u64>(),
        ) {
            let dtype = Dtype::ALL[kind];
            let byte = |i: usize| if dtype == Dtype::Bool { u8::from(i.is_multiple_of(3)) } else { fill.to_le_bytes()[i % 8] };
            let bytes: Vec<u8> = (0..rows * columns * dtype.size()).map(byte).collect();
            let tensor = Tensor::from_bytes(dtype, vec![rows, columns], bytes).unwrap();
            let file = encode(&tensor);
            prop_assert_eq!((file.len() - tensor.bytes().len()) % ALIGNMENT, 0);
            prop_assert_eq!(decode(&file), Ok(tensor));
        }

        /// Any single changed byte either reads as something valid or is refused.
        #[test]
        fn damaged_files_never_panic(at in 0usize..160, value in any::<u8>(), cut in 0usize..160) {
            let mut bytes = encode(&Tensor::from(vec![1.0, 2.0, 3.0, 4.0]));
            bytes[at] = value;
            let _ = decode(&bytes);
            let _ = decode(&bytes[..cut]);
        }
    }
}
