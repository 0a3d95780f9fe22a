//! Dynamic RGB-D scenes with exact poses, depth, flow and masks
