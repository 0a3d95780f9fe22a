//! Limits that keep a hostile or broken file from filling the memory. Each is checked before memory is
//! allocated.

/// Columns and rows of an image.
pub const IMAGE_SIDE_PX: u32 = garad_core::camera::MAX_SIDE_PX;
/// Bytes of a decoded image, and of the memory its decoder needs.
pub const IMAGE_DECODED_BYTES: u64 = 64 << 20;
/// Bytes of one file: an image, a list, a trajectory.
pub const FILE_BYTES: u64 = 64 << 20;
/// Bytes of a whole archive, unpacked.
pub const ARCHIVE_BYTES: u64 = 4 << 30;
/// Unpacked bytes per packed byte; PNG is already compressed, so real recordings are below 2.
pub const ARCHIVE_RATIO: u64 = 200;
/// [`ARCHIVE_RATIO`] is checked after this many unpacked bytes.
pub const ARCHIVE_RATIO_FROM_BYTES: u64 = 16 << 20;
/// Entries of an archive.
pub const ARCHIVE_ENTRIES: usize = 1_000_000;
/// Bytes of an archive's long name (GNU or pax record).
pub const ARCHIVE_NAME_BYTES: u64 = 64 << 10;
/// Lines of a list or trajectory.
pub const LIST_LINES: usize = 1_000_000;
/// Bytes of a line of text.
pub const LINE_BYTES: usize = 4 << 10;
/// Gaussians of a map: 4 GB at degree 3.
pub const GAUSSIANS: u64 = 16_000_000;
/// Bytes of a PLY header.
pub const PLY_HEADER_BYTES: usize = 64 << 10;
/// Latest time of a recording, seconds. A larger number is most likely in nanoseconds.
pub const TIME_S: f64 = 1e11;
