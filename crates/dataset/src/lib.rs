//! TUM and BONN RGB-D recordings, archives, calibration, trajectories and PLY maps
