//! Scenes checked from outside: geometry against poses and depth, colours against geometry, moving objects
//! against the twin, bits against threads.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates inside an image"
)]

mod bits;
mod geometry;
mod masks;
mod promises;
mod support;
