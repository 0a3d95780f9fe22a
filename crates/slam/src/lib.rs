//! The GARAD-SLAM pipeline: tracker, local map, keyframes, mapper
