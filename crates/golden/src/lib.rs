//! Golden cases: format, .npy codec, tolerance table, comparators
