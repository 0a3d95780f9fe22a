//! Recordings in archives. Gzip and zip are read as they are; anything else is taken for a tar, whose header
//! checksums are made right, and is read plain and gzipped: both must be the same recording.

#![no_main]

use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use garad_dataset::{Dataset, Frame, MASK_FOLDER};
use garad_fuzz::{check_error, folder, open, within_mib, write};
use libfuzzer_sys::fuzz_target;

const BLOCK: usize = 512;

/// Sets the checksum of every block that looks like a header.
fn with_checksums(data: &[u8]) -> Vec<u8> {
    let mut tar = data.to_vec();
    for header in tar
        .chunks_exact_mut(BLOCK)
        .filter(|b| &b[257..262] == b"ustar")
    {
        header[148..156].fill(b' ');
        let sum: u32 = header.iter().map(|b| u32::from(*b)).sum();
        header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    }
    tar
}

/// Opens an archive and reads all of it.
fn read(path: &Path) -> Option<(Dataset, Vec<Option<Frame>>)> {
    // The archive in memory, up to 16 MiB more of its content, one image decoded.
    within_mib(256, || {
        let dataset = open(path, false)?;
        let frames = 0..dataset.len().min(8);
        let frames = frames.map(|i| {
            let mask = dataset.read_own_mask(MASK_FOLDER, i);
            let _ = mask.inspect_err(|error| check_error(error, path));
            let frame = dataset.read(i);
            frame.inspect_err(|error| check_error(error, path)).ok()
        });
        let frames = frames.collect();
        Some((dataset, frames))
    })
}

fuzz_target!(|data: &[u8]| {
    let folder = folder();
    let path = folder.path();
    if data.starts_with(b"PK") || data.starts_with(b"\x1F\x8B") {
        write(path, "a", data);
        let _ = read(&path.join("a"));
        return;
    }
    let tar = with_checksums(data);
    let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
    gzip.write_all(&tar).expect("memory");
    write(path, "a.tar", &tar);
    write(path, "a.tgz", &gzip.finish().expect("memory"));
    let plain = read(&path.join("a.tar"));
    let gzipped = read(&path.join("a.tgz"));
    if let (Some((a, frames_a)), Some((b, frames_b))) = (plain, gzipped) {
        assert_eq!(a.len(), b.len(), "frames");
        assert_eq!(a.name(), b.name(), "name");
        assert_eq!(a.calibration().camera, b.calibration().camera, "camera");
        assert_eq!(a.ground_truth(), b.ground_truth(), "ground truth");
        assert!(frames_a == frames_b, "images");
    }
});
