//! The `garad` command line.
fn main() {}
