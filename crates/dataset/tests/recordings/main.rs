//! Recordings, good and spoilt, in folders and archives.

mod archives;
mod fixture;
mod folders;
mod frames;
mod images;
mod layouts;
