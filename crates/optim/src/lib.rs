//! Robust kernels, Levenberg-Marquardt, pose-only optimisation, finite-difference checks
