//! [`Tensor`]: an array with a type and a shape, as a golden case holds it.

use crate::npy::error::NpyError;

/// Element type. The name in `case.json` and the descriptor in `.npy` files are two spellings
/// of the same thing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names are the types")]
pub enum Dtype {
    F32,
    F64,
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    Bool,
}

impl Dtype {
    /// Every element type.
    pub const ALL: [Self; 10] = [
        Self::F32,
        Self::F64,
        Self::I8,
        Self::U8,
        Self::I16,
        Self::U16,
        Self::I32,
        Self::U32,
        Self::I64,
        Self::Bool,
    ];

    /// Name in `case.json`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
            Self::I8 => "i8",
            Self::U8 => "u8",
            Self::I16 => "i16",
            Self::U16 => "u16",
            Self::I32 => "i32",
            Self::U32 => "u32",
            Self::I64 => "i64",
            Self::Bool => "bool",
        }
    }

    /// numpy's descriptor, little-endian.
    #[must_use]
    pub fn descr(self) -> &'static str {
        match self {
            Self::F32 => "<f4",
            Self::F64 => "<f8",
            Self::I8 => "|i1",
            Self::U8 => "|u1",
            Self::I16 => "<i2",
            Self::U16 => "<u2",
            Self::I32 => "<i4",
            Self::U32 => "<u4",
            Self::I64 => "<i8",
            Self::Bool => "|b1",
        }
    }

    /// Bytes of one element.
    #[must_use]
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 | Self::Bool => 1,
            Self::I16 | Self::U16 => 2,
            Self::F32 | Self::I32 | Self::U32 => 4,
            Self::F64 | Self::I64 => 8,
        }
    }

    /// From the name in `case.json`.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|d| d.name() == name)
    }

    /// From numpy's descriptor.
    #[must_use]
    pub fn from_descr(descr: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|d| d.descr() == descr)
    }
}

/// An array in C order: shape, type, and the elements as little-endian bytes.
///
/// The accessors convert only where no value can change; a call for a type that does not fit is
/// a mistake in the test that made it, and panics with the two types.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

/// Integers of f64 are exact up to here.
pub(crate) const EXACT_F64: u64 = 1 << 53;

impl Tensor {
    /// From its bytes; `None` unless their number is that of the shape.
    #[must_use]
    pub fn from_bytes(dtype: Dtype, shape: Vec<usize>, bytes: Vec<u8>) -> Option<Self> {
        let tensor = Self {
            dtype,
            shape,
            bytes,
        };
        (checked_len(&tensor.shape)?.checked_mul(dtype.size())? == tensor.bytes.len())
            .then_some(tensor)
    }

    /// The same elements under another shape; `None` if their number differs.
    #[must_use]
    pub fn reshape(self, shape: &[usize]) -> Option<Self> {
        Self::from_bytes(self.dtype, shape.to_vec(), self.bytes)
    }

    /// Element type.
    #[must_use]
    pub fn dtype(&self) -> Dtype {
        self.dtype
    }

    /// Sizes, slowest index first.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Number of elements.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len() / self.dtype.size()
    }

    /// No elements.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The elements as little-endian bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The tensor, if [`Tensor::f64`] holds each of its elements exactly.
    ///
    /// # Errors
    /// [`NpyError::Inexact`] with the first that it does not.
    pub(crate) fn exact(self) -> Result<Self, NpyError> {
        let i64s = match self.dtype {
            Dtype::I64 => self.i64(),
            _ => Vec::new(),
        };
        let at = i64s.iter().position(|v| v.unsigned_abs() > EXACT_F64);
        match at {
            Some(at) => Err(NpyError::Inexact {
                at,
                value: i64s[at],
            }),
            None => Ok(self),
        }
    }

    /// Indices of the element at position `flat`.
    #[must_use]
    pub fn unravel(&self, flat: usize) -> Vec<usize> {
        let mut rest = flat;
        let mut index = vec![0; self.shape.len()];
        for axis in (0..self.shape.len()).rev() {
            let size = self.shape[axis].max(1);
            index[axis] = rest % size;
            rest /= size;
        }
        index
    }

    fn elements<const N: usize, T>(&self, from: fn([u8; N]) -> T) -> Vec<T> {
        let (elements, _) = self.bytes.as_chunks::<N>();
        elements.iter().map(|e| from(*e)).collect()
    }

    /// The elements as f64. Any type fits; an i64 beyond 2⁵³ does not.
    ///
    /// # Panics
    /// For an i64 that f64 cannot hold.
    #[must_use]
    pub fn f64(&self) -> Vec<f64> {
        match self.dtype {
            Dtype::F64 => self.elements(f64::from_le_bytes),
            Dtype::F32 => self.elements(|b| f64::from(f32::from_le_bytes(b))),
            _ => self.i64().into_iter().map(exact_f64).collect(),
        }
    }

    /// The elements as i64.
    ///
    /// # Panics
    /// If the tensor holds floats.
    #[must_use]
    pub fn i64(&self) -> Vec<i64> {
        match self.dtype {
            Dtype::I8 => self.elements(|b| i64::from(i8::from_le_bytes(b))),
            Dtype::U8 | Dtype::Bool => self.elements(|b| i64::from(u8::from_le_bytes(b))),
            Dtype::I16 => self.elements(|b| i64::from(i16::from_le_bytes(b))),
            Dtype::U16 => self.elements(|b| i64::from(u16::from_le_bytes(b))),
            Dtype::I32 => self.elements(|b| i64::from(i32::from_le_bytes(b))),
            Dtype::U32 => self.elements(|b| i64::from(u32::from_le_bytes(b))),
            Dtype::I64 => self.elements(i64::from_le_bytes),
            Dtype::F32 | Dtype::F64 => self.misfit("i64"),
        }
    }

    /// The elements as u8; fits u8 and bool.
    ///
    /// # Panics
    /// If the tensor holds anything else.
    #[must_use]
    pub fn u8(&self) -> Vec<u8> {
        match self.dtype {
            Dtype::U8 | Dtype::Bool => self.bytes.clone(),
            _ => self.misfit("u8"),
        }
    }

    /// The elements as f32; fits f32 alone.
    ///
    /// # Panics
    /// If the tensor holds anything else.
    #[must_use]
    pub fn f32(&self) -> Vec<f32> {
        match self.dtype {
            Dtype::F32 => self.elements(f32::from_le_bytes),
            _ => self.misfit("f32"),
        }
    }

    fn misfit(&self, wanted: &str) -> ! {
        panic!(
            "a tensor of {} was asked for as {wanted}",
            self.dtype.name()
        )
    }
}

impl From<Vec<f64>> for Tensor {
    fn from(values: Vec<f64>) -> Self {
        Self {
            dtype: Dtype::F64,
            shape: vec![values.len()],
            bytes: values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        }
    }
}

/// Product of the sizes, `None` if it does not fit.
pub(crate) fn checked_len(shape: &[usize]) -> Option<usize> {
    shape
        .iter()
        .try_fold(1usize, |n, &size| n.checked_mul(size))
}

fn exact_f64(value: i64) -> f64 {
    assert!(value.unsigned_abs() <= EXACT_F64, "{value} is no exact f64");
    value as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_descriptors_lead_back() {
        for dtype in Dtype::ALL {
            assert_eq!(Dtype::from_name(dtype.name()), Some(dtype), "name");
            assert_eq!(Dtype::from_descr(dtype.descr()), Some(dtype), "descr");
            let last = dtype.descr().as_bytes()[2] - b'0';
            assert_eq!(usize::from(last), dtype.size(), "numpy names the size");
        }
    }

    #[test]
    fn bytes_are_read_as_their_type() {
        let i16s = Tensor::from_bytes(Dtype::I16, vec![2], vec![0xFE, 0xFF, 0x01, 0x02]).unwrap();
        assert_eq!(i16s.i64(), [-2, 513], "little-endian, signed");
        assert_eq!(i16s.f64(), [-2.0, 513.0], "widened");
        let u8s = Tensor::from_bytes(Dtype::U8, vec![1, 2], vec![255, 1]).unwrap();
        assert_eq!((u8s.u8(), u8s.i64()), (vec![255, 1], vec![255, 1]), "u8");
        let single = Tensor::from_bytes(Dtype::F32, vec![1], 0.1f32.to_le_bytes().into()).unwrap();
        assert_eq!(single.f32(), [0.1f32], "f32");
        assert_eq!(single.f64(), [f64::from(0.1f32)], "not 0.1f64");
        assert!(
            Tensor::from_bytes(Dtype::F64, vec![1], vec![0; 7]).is_none(),
            "a byte is missing"
        );
        assert!(
            Tensor::from_bytes(Dtype::U8, vec![usize::MAX, 2], vec![]).is_none(),
            "overflow"
        );
    }

    #[test]
    #[should_panic(expected = "a tensor of f64 was asked for as u8")]
    fn a_type_that_does_not_fit_panics_with_both_names() {
        let _ = Tensor::from(vec![1.0]).u8();
    }

    #[test]
    fn flat_positions_unravel_in_c_order() {
        let t = Tensor::from(vec![0.0; 24]).reshape(&[2, 3, 4]).unwrap();
        assert_eq!(t.unravel(23), [1, 2, 3], "last");
        assert_eq!(t.unravel(5), [0, 1, 1], "row 1, column 1");
    }
}
