//! Maps as PLY files in the layout of 3D Gaussian Splatting, which splat viewers open.
//!
//! One element `vertex`, 62 floats for each Gaussian; written as `binary_little_endian` (248 bytes a
//! vertex), read in any encoding:
//!
//! | properties | meaning |
//! |---|---|
//! | `x y z` | centre in the world, metres |
//! | `nx ny nz` | 0, unused; viewers expect them |
//! | `f_dc_0..2` | SH coefficient 0 of red, green, blue |
//! | `f_rest_0..44` | SH coefficients 1..15 of red, then of green, then of blue |
//! | `opacity` | before the sigmoid |
//! | `scale_0..2` | ln of the standard deviations, ln(metres) |
//! | `rot_0..3` | quaternion w, x, y, z, any length but 0 |
//!
//! Colours of a lower degree are padded with zeros, because some viewers accept only 62 floats.
//! [`PlyOptions::label`] appends a 63rd property, `uchar label` (0 static, 1 dynamic), for readers that
//! find properties by name. Landmark, parent and keyframe of a Gaussian are not in the file.

mod read;
mod write;

pub use read::{parse_ply, read_ply};
pub use write::{PlyOptions, format_ply, write_ply};

#[cfg(test)]
mod tests;
