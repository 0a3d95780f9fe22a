//! Gaussian splat rasterizer on the CPU
