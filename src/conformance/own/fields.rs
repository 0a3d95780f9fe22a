//! What a case holds, in the types of the stages.

use garad_core::{Camera, GrayImage, Image, Real, Se3, So3};
use garad_golden::{Case, Dtype, Tensor};
use nalgebra::Vector3;

use super::OwnError;

/// A case whose fields are asked for by name and type.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fields<'a>(pub(super) &'a Case);

impl<'a> Fields<'a> {
    pub(super) fn wrong(&self, problem: impl std::fmt::Display) -> OwnError {
        OwnError(format!("{}: {problem}", self.0.name()))
    }

    fn param<T>(
        &self,
        name: &str,
        read: impl Fn(&'a serde_json::Value) -> Option<T>,
    ) -> Result<T, OwnError> {
        let value = self.0.param(name).and_then(read);
        value.ok_or_else(|| self.wrong(format!("no parameter '{name}' of the type expected")))
    }

    pub(super) fn number(&self, name: &str) -> Result<f64, OwnError> {
        self.param(name, serde_json::Value::as_f64)
    }

    pub(super) fn count(&self, name: &str) -> Result<usize, OwnError> {
        self.param(name, |v| usize::try_from(v.as_u64()?).ok())
    }

    pub(super) fn word(&self, name: &str) -> Result<&'a str, OwnError> {
        self.param(name, serde_json::Value::as_str)
    }

    pub(super) fn switch(&self, name: &str) -> Result<bool, OwnError> {
        self.param(name, serde_json::Value::as_bool)
    }

    /// Whether the case has such an output.
    pub(super) fn asks(&self, name: &str) -> bool {
        self.0.output_names().any(|output| output == name)
    }

    pub(super) fn tensor(&self, name: &str) -> Result<&'a Tensor, OwnError> {
        let tensor = self.0.try_input(name);
        tensor.ok_or_else(|| self.wrong(format!("no input '{name}'")))
    }

    pub(super) fn reals(&self, name: &str) -> Result<Vec<f64>, OwnError> {
        Ok(self.tensor(name)?.f64())
    }

    /// As reals, in triples and the like.
    pub(super) fn rows<const N: usize>(&self, name: &str) -> Result<Vec<[f64; N]>, OwnError> {
        let values = self.reals(name)?;
        match values.as_chunks::<N>() {
            (rows, []) => Ok(rows.to_vec()),
            _ => Err(self.wrong(format!("'{name}' is not made of rows of {N}"))),
        }
    }

    /// Exactly one row.
    pub(super) fn row<const N: usize>(&self, name: &str) -> Result<[f64; N], OwnError> {
        match self.rows::<N>(name)?.as_slice() {
            [row] => Ok(*row),
            _ => Err(self.wrong(format!("'{name}' is not one row of {N}"))),
        }
    }

    pub(super) fn bytes(&self, name: &str) -> Result<Vec<u8>, OwnError> {
        let tensor = self.tensor(name)?;
        match tensor.dtype() {
            Dtype::U8 | Dtype::Bool => Ok(tensor.bytes().to_vec()),
            other => Err(self.wrong(format!("'{name}' is {}, not bytes", other.name()))),
        }
    }

    /// Height and width of a picture.
    fn size(&self, name: &str) -> Result<(usize, usize), OwnError> {
        match *self.tensor(name)?.shape() {
            [height, width, ..] => Ok((width, height)),
            _ => Err(self.wrong(format!("'{name}' is no picture"))),
        }
    }

    pub(super) fn gray(&self, name: &str) -> Result<GrayImage, OwnError> {
        let (width, height) = self.size(name)?;
        GrayImage::from_vec(width, height, self.bytes(name)?)
            .ok_or_else(|| self.wrong(format!("'{name}' is no grey picture")))
    }

    pub(super) fn plane<T: Real>(&self, name: &str) -> Result<Image<T>, OwnError> {
        let (width, height) = self.size(name)?;
        let values = self.reals(name)?.into_iter().map(T::from_f64).collect();
        Image::from_vec(width, height, values)
            .ok_or_else(|| self.wrong(format!("'{name}' has more than one channel")))
    }

    pub(super) fn picture<T: Real>(&self, name: &str) -> Result<Image<[T; 3]>, OwnError> {
        let (width, height) = self.size(name)?;
        let rows = self.rows::<3>(name)?.into_iter();
        Image::from_vec(width, height, rows.map(|c| c.map(T::from_f64)).collect())
            .ok_or_else(|| self.wrong(format!("'{name}' has no three channels")))
    }

    /// `intrinsics` and the size in `width`, `height`.
    pub(super) fn camera(&self) -> Result<Camera, OwnError> {
        let size = (self.count("width")?, self.count("height")?);
        Camera::pinhole(size, self.row("intrinsics")?).map_err(|error| self.wrong(error))
    }

    /// `camera_from_world_q` and `_t`, with a suffix.
    pub(super) fn pose(&self, suffix: &str) -> Result<Se3, OwnError> {
        let [w, x, y, z] = self.row(&format!("camera_from_world_q{suffix}"))?;
        let t = self.row::<3>(&format!("camera_from_world_t{suffix}"))?;
        let rotation = So3::from_quaternion(w, x, y, z);
        let rotation = rotation.ok_or_else(|| self.wrong("the pose has no rotation"))?;
        Ok(Se3::new(rotation, Vector3::from(t)))
    }
}
