//! Golden cases against a backend: a port that is a program, a folder of its outputs, or this
//! project's own stages.
//!
//! ```text
//! case ─→ port::run (a program) ┐
//!      ─→ own::answers (ours)   ┼─→ golden::judge ─→ golden::report
//!      ─→ a folder of .npy      ┘
//! ```

pub mod own;
pub mod port;
