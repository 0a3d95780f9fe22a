//! The `garad` program as its users meet it: what it writes, and what it says of bad input.
//!
//! The recordings are tiny and made by `garad synth`; each test damages a copy of its own.

mod archives;
mod bad_frames;
mod bad_maps;
mod bad_recordings;
mod golden;
mod judging;
mod labelling;
mod rendering;
mod results;
mod session;
mod settings;
mod support;
mod synthesis;
mod usage;
