//! [`decode`] and [`encode`]: numpy's `.npy` files, version 1.0, little-endian, C order.
//!
//! Layout: `\x93NUMPY`, version 1 0, header length (u16), a Python dict literal with the keys
//! `descr`, `fortran_order` and `shape`, then the elements. The header is read by a parser that
//! knows this one dict and nothing else. Nothing is allocated from what a header claims: the
//! claimed size is computed with checked arithmetic and must be the number of bytes that are
//! really there.

pub(crate) mod error;
mod header;

use crate::tensor::{Dtype, Tensor, checked_len};
pub use error::NpyError;
use header::HeaderParser;

const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Magic, version, header length.
const PREAMBLE: usize = 10;
/// numpy pads headers so that the elements start at a multiple of this.
const ALIGNMENT: usize = 64;
/// numpy leaves room for the first size to grow to this many digits in place.
const GROWTH_DIGITS: usize = 21;

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
    let (descr, fortran_order, shape) = HeaderParser::new(header).parse()?;
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
