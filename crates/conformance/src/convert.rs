//! Inputs of a case in the types of the stages.

use garad_core::{Camera, GrayImage, Image, Label, Real, Se3, So3};
use garad_golden::{InputError, Inputs};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::outputs::Error;

pub(crate) fn reals<T: Real>(inputs: &Inputs, name: &str) -> Result<Vec<T>, InputError> {
    Ok(inputs.reals(name)?.into_iter().map(T::from_f64).collect())
}

pub(crate) fn rows<T: Real, const N: usize>(
    inputs: &Inputs,
    name: &str,
) -> Result<Vec<[T; N]>, InputError> {
    let rows = inputs.rows::<N>(name)?.into_iter();
    Ok(rows.map(|row| row.map(T::from_f64)).collect())
}

pub(crate) fn vectors<const N: usize>(
    inputs: &Inputs,
    name: &str,
) -> Result<Vec<SVector<f64, N>>, InputError> {
    Ok(inputs
        .rows::<N>(name)?
        .into_iter()
        .map(SVector::from)
        .collect())
}

/// An image of any pixels, made from its elements in C order.
fn image<P>(
    inputs: &Inputs,
    name: &str,
    pixels: Vec<P>,
    expected: &str,
) -> Result<Image<P>, InputError> {
    let (width, height) = inputs.size(name)?;
    Image::from_vec(width, height, pixels).ok_or_else(|| inputs.shape_is_not(name, expected))
}

pub(crate) fn gray(inputs: &Inputs, name: &str) -> Result<GrayImage, InputError> {
    image(inputs, name, inputs.bytes(name)?.to_vec(), "a grey image")
}

pub(crate) fn gray_if_there(inputs: &Inputs, name: &str) -> Result<Option<GrayImage>, InputError> {
    inputs.get(name).map(|_| gray(inputs, name)).transpose()
}

/// The image, if it has the camera's size.
pub(crate) fn of_size<P>(
    inputs: &Inputs,
    name: &str,
    image: Image<P>,
    camera: &Camera,
) -> Result<Image<P>, InputError> {
    let fits = image.size() == (camera.width, camera.height);
    let image = fits.then_some(image);
    image.ok_or_else(|| inputs.shape_is_not(name, "an image of the camera's size"))
}

pub(crate) fn plane<T: Real>(inputs: &Inputs, name: &str) -> Result<Image<T>, InputError> {
    image(
        inputs,
        name,
        reals(inputs, name)?,
        "an image of one channel",
    )
}

pub(crate) fn channels<T: Real, const N: usize>(
    inputs: &Inputs,
    name: &str,
) -> Result<Image<[T; N]>, InputError> {
    image(
        inputs,
        name,
        rows(inputs, name)?,
        &format!("an image of {N} channels"),
    )
}

pub(crate) fn labels(inputs: &Inputs, name: &str) -> Result<Vec<Label>, InputError> {
    let label = |d: &u8| [Label::Static, Label::Dynamic][usize::from(*d != 0)];
    Ok(inputs.bytes(name)?.iter().map(label).collect())
}

/// Numbers in place of labels: 1 for dynamic.
pub(crate) fn codes(labels: &[Label]) -> impl Iterator<Item = bool> {
    labels.iter().map(|l| *l == Label::Dynamic)
}

/// Rotation from a quaternion (w, x, y, z).
pub(crate) fn rotation(wxyz: [f64; 4]) -> Result<So3, Error> {
    let [w, x, y, z] = wxyz;
    Ok(So3::from_quaternion(w, x, y, z).ok_or("a quaternion without direction")?)
}

/// Poses from rotation matrices, row by row, and translations.
pub(crate) fn poses(
    inputs: &Inputs,
    rotation: &str,
    translation: &str,
) -> Result<Vec<Se3>, InputError> {
    let pairs = inputs.rows::<9>(rotation)?.into_iter();
    let pairs = pairs.zip(vectors::<3>(inputs, translation)?);
    let pose = |(r, t): ([f64; 9], Vector3<f64>)| {
        Se3::new(So3::from_matrix(&Matrix3::from_row_slice(&r)), t)
    };
    Ok(pairs.map(pose).collect())
}

/// Row by row.
pub(crate) fn matrix<const R: usize, const C: usize>(m: &SMatrix<f64, R, C>) -> [[f64; C]; R] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

/// NaN stands for what is missing.
pub(crate) fn known(value: f64) -> Option<f64> {
    (!value.is_nan()).then_some(value)
}

/// Whether an input is there.
pub(crate) fn has(inputs: &Inputs, name: &str) -> bool {
    inputs.get(name).is_some()
}
