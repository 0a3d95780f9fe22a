//! [`Outputs`]: what a stage makes, by name, with types and shapes of its own.

use std::collections::BTreeMap;

use garad_core::Image;
use garad_golden::answers::Answers;
use garad_golden::{Dtype, Tensor};

/// Why a stage cannot be given a case.
pub type Error = Box<dyn std::error::Error + Send + Sync>;

/// What a stage makes of its inputs.
pub type Answer = Result<Outputs, Error>;

/// The outputs of a stage.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Outputs(BTreeMap<String, Tensor>);

/// Numbers, and rows of numbers.
pub trait Element {
    /// Reals keep their type; whole numbers are stored as f64, where they are exact.
    const DTYPE: Dtype;
    /// Axes of its own: none for a number.
    fn shape() -> Vec<usize>;
    /// Appends its numbers, little-endian.
    fn write(self, bytes: &mut Vec<u8>);
}

macro_rules! numbers {
    ($($number:ty, $dtype:ident, $stored:expr;)*) => {$(
        impl Element for $number {
            const DTYPE: Dtype = Dtype::$dtype;
            fn shape() -> Vec<usize> {
                Vec::new()
            }
            fn write(self, bytes: &mut Vec<u8>) {
                let stored = $stored;
                bytes.extend(stored(self).to_le_bytes());
            }
        }
    )*};
}

numbers! {
    f32, F32, |v: f32| v;
    f64, F64, |v: f64| v;
    bool, F64, |v: bool| f64::from(u8::from(v));
    u8, F64, f64::from;
    u32, F64, f64::from;
    i32, F64, f64::from;
    i64, F64, |v: i64| v as f64;
    usize, F64, |v: usize| v as f64;
}

impl<E: Element, const N: usize> Element for [E; N] {
    const DTYPE: Dtype = E::DTYPE;

    fn shape() -> Vec<usize> {
        let mut shape = E::shape();
        shape.insert(0, N);
        shape
    }

    fn write(self, bytes: &mut Vec<u8>) {
        self.into_iter().for_each(|element| element.write(bytes));
    }
}

impl Outputs {
    /// One element: no axis of its own.
    pub fn one<E: Element>(&mut self, name: &str, element: E) {
        self.counted(name, &[], [element]);
    }

    /// A list: one axis for its elements, before theirs.
    pub fn put<E: Element>(&mut self, name: &str, elements: impl IntoIterator<Item = E>) {
        let elements: Vec<E> = elements.into_iter().collect();
        self.counted(name, &[elements.len()], elements);
    }

    /// An image: height, width, and the axes of its pixels.
    pub fn image<E: Element + Copy>(&mut self, name: &str, image: &Image<E>) {
        let shape = [image.height(), image.width()];
        self.counted(name, &shape, image.data().iter().copied());
    }

    fn counted<E: Element>(
        &mut self,
        name: &str,
        axes: &[usize],
        all: impl IntoIterator<Item = E>,
    ) {
        let done = self.shaped(name, axes, all);
        done.expect("axes come from the number of elements");
    }

    /// Elements under axes of any number, before their own.
    ///
    /// # Errors
    /// If there are more or fewer elements than that.
    pub fn shaped<E: Element>(
        &mut self,
        name: &str,
        axes: &[usize],
        elements: impl IntoIterator<Item = E>,
    ) -> Result<(), Error> {
        let mut bytes = Vec::new();
        for element in elements {
            element.write(&mut bytes);
        }
        let shape = [axes, &E::shape()].concat();
        let tensor = Tensor::from_bytes(E::DTYPE, shape, bytes);
        let tensor = tensor.ok_or_else(|| format!("'{name}' does not have {axes:?} elements"))?;
        self.0.insert(name.to_owned(), tensor);
        Ok(())
    }

    /// Every output by name.
    #[must_use]
    pub fn tensors(&self) -> &BTreeMap<String, Tensor> {
        &self.0
    }

    /// For [`judge`](garad_golden::judge::judge).
    #[must_use]
    pub fn answers(&self) -> Answers {
        let all = self.0.iter();
        all.map(|(name, tensor)| (name.clone(), Ok(tensor.clone())))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_come_from_the_types() {
        let mut out = Outputs::default();
        out.one("cost", 1.5);
        out.put("uv", [[1.0f32, 2.0], [3.0, 4.0], [5.0, 6.0]]);
        out.image("rgb", &Image::new(4, 2, [7u8; 3]));
        out.shaped("k", &[2, 2], [true, false, false, true])
            .unwrap();
        let error = out.shaped("k", &[2, 3], [1.0, 2.0]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "'k' does not have [2, 3] elements",
            "too few"
        );
        let of = |name: &str| {
            let tensor = &out.tensors()[name];
            (tensor.dtype(), tensor.shape().to_vec(), tensor.f64())
        };
        assert_eq!(of("cost"), (Dtype::F64, vec![], vec![1.5]), "a scalar");
        let uv = vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        assert_eq!(of("uv"), (Dtype::F32, vec![3, 2], uv), "rows");
        assert_eq!(
            of("rgb"),
            (Dtype::F64, vec![2, 4, 3], vec![7.0; 24]),
            "an image"
        );
        assert_eq!(
            of("k"),
            (Dtype::F64, vec![2, 2], vec![1.0, 0.0, 0.0, 1.0]),
            "a table"
        );
    }
}
