//! The `garad` program: its results, and its messages about bad input.
//!
//! The recordings are tiny and made by `garad synth`; each test damages its own copy.

mod archives;
mod bad_frames;
mod bad_maps;
mod bad_recordings;
mod comparing;
mod golden;
mod interrupting;
mod judging;
mod labelling;
mod layouts;
mod outputs;
mod plausibility;
mod ports;
mod rendering;
mod results;
mod session;
mod settings;
mod support;
mod synthesis;
mod usage;
