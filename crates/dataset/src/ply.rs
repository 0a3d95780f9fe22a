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
//!

//! Files of other programs:
//!
//! | file | read as |
//! |---|---|
//! | numbers of any type, other elements and properties, lists | by name; the others are skipped |
//! | no `scale_2` or one of -inf (2D Gaussian Splatting); `scale_0` alone | flat; a sphere |
//! | `red green blue` and no `f_dc` | the same colour from everywhere; bytes are 0 to 255, floats 0 to 1 |
//! | `opacity` of +-inf | a logit of +-40 |
//! | quaternions of any finite length but 0 | as they are, those beyond 1e9 or below 1e-9 normalised |
//! | `packed_position` and so on, as SuperSplat writes it | unpacked |

mod columns;
mod packed;
mod property;
mod read;
mod write;

pub use read::{parse_ply, read_ply};
pub use write::{PlyOptions, format_ply, write_ply};

#[cfg(test)]
mod tests;
