//! garad
