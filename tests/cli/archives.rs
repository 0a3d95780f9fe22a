//! Recordings inside archives, and hostile archives, made byte by byte.

use std::fs;
use std::path::Path;

use crate::support::{Bench, assert_same_results, run_into, short};

/// Name and content of a file.
type Entry = (String, Vec<u8>);

/// The files of [`short`] that a run reads, in a folder `rec/`.
fn entries() -> Vec<Entry> {
    let mut entries = Vec::new();
    for folder in ["", "rgb/", "depth/"] {
        let mut names: Vec<String> = fs::read_dir(short().join(folder))
            .expect("a folder")
            .map(|entry| entry.expect("an entry"))
            .filter(|entry| entry.path().is_file())
            .map(|entry| entry.file_name().into_string().expect("UTF-8"))
            .collect();
        names.sort();
        for name in names {
            let bytes = fs::read(short().join(folder).join(&name)).expect("a file");
            entries.push((format!("rec/{folder}{name}"), bytes));
        }
    }
    entries
}

fn length(n: usize) -> u32 {
    u32::try_from(n).expect("small archives")
}

/// A zip archive with uncompressed entries.
fn zip(entries: &[Entry]) -> Vec<u8> {
    let (mut file, mut directory) = (Vec::new(), Vec::new());
    for (name, bytes) in entries {
        let offset = length(file.len());
        // Version, flags, method, time, date; checksum, sizes, length of the name, of extras.
        let mut common = vec![20, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        for number in [
            crc32fast::hash(bytes),
            length(bytes.len()),
            length(bytes.len()),
        ] {
            common.extend(number.to_le_bytes());
        }
        common.extend(length(name.len()).to_le_bytes()); // two lengths of 16 bits, the second 0
        file.extend(b"PK\x03\x04");
        file.extend(&common);
        file.extend(name.as_bytes());
        file.extend(bytes);
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&common);
        directory.extend([0; 10]); // comment, disk, attributes
        directory.extend(offset.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let count = u16::try_from(entries.len()).expect("few").to_le_bytes();
    let start = length(file.len());
    file.extend(&directory);
    file.extend(b"PK\x05\x06\0\0\0\0");
    file.extend([count, count].concat());
    file.extend(length(directory.len()).to_le_bytes());
    file.extend(start.to_le_bytes());
    file.extend([0, 0]);
    file
}

/// A tar archive; `kind` is the type of every entry, b'0' for files.
fn tar(entries: &[Entry], kind: u8) -> Vec<u8> {
    let mut file = Vec::new();
    for (name, bytes) in entries {
        let mut header = [0u8; 512];
        let mut put = |at: usize, text: &str| {
            header[at..at + text.len()].copy_from_slice(text.as_bytes());
        };
        put(0, name);
        put(100, "0000644\0");
        put(
            124,
            &format!("{:011o}", if kind == b'0' { bytes.len() } else { 0 }),
        );
        put(148, "        "); // the checksum counts itself as blanks
        put(257, "ustar\x0000");
        header[156] = kind;
        if kind == b'2' {
            header[157..168].copy_from_slice(b"/etc/passwd");
        }
        let sum: u32 = header.iter().map(|&byte| u32::from(byte)).sum();
        header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
        file.extend(header);
        if kind == b'0' {
            file.extend(bytes);
            file.resize(file.len().next_multiple_of(512), 0);
        }
    }
    file.resize(file.len() + 1024, 0);
    file
}

/// A gzip stream of stored blocks.
fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut file = b"\x1F\x8B\x08\0\0\0\0\0\0\xFF".to_vec();
    let mut blocks = bytes.chunks(0xFFFF).peekable();
    while let Some(block) = blocks.next() {
        let size = u16::try_from(block.len()).expect("a block");
        file.push(u8::from(blocks.peek().is_none()));
        file.extend(size.to_le_bytes());
        file.extend((!size).to_le_bytes());
        file.extend(block);
    }
    file.extend(crc32fast::hash(bytes).to_le_bytes());
    file.extend(length(bytes.len()).to_le_bytes());
    file
}

/// The three kinds of archive of the same entries.
fn archives(entries: &[Entry]) -> [(&'static str, Vec<u8>); 3] {
    let tar = tar(entries, b'0');
    [
        ("rec.zip", zip(entries)),
        ("rec.tgz", gzip(&tar)),
        ("rec.tar", tar),
    ]
}

#[test]
fn an_archive_gives_the_results_of_its_folder() {
    let bench = Bench::empty();
    run_into(short(), &bench.path("folder"), &[]).succeeds();
    for (name, bytes) in archives(&entries()) {
        fs::write(bench.path(name), bytes).expect("written");
        bench.run_on(&bench.path(name), &[]).succeeds();
        assert_same_results(&bench.path("folder"), &bench.out());
    }
}

#[test]
fn names_that_lead_outside_are_refused() {
    let bench = Bench::empty();
    for outside in ["../stolen.png", "rec/../../stolen.txt", "/tmp/stolen.png"] {
        let mut entries = entries();
        entries.push((outside.to_owned(), b"x".to_vec()));
        for (name, bytes) in archives(&entries) {
            fs::write(bench.path(name), bytes).expect("written");
            let answer = bench.run_on(&bench.path(name), &[]);
            answer.fails_with(&[name, outside, "without `..`"]);
        }
    }
    assert!(!bench.path("stolen.png").exists(), "nothing was unpacked");
    assert!(
        !Path::new("/tmp/stolen.png").exists(),
        "nothing was unpacked"
    );
    assert!(!bench.out().exists(), "nothing was run");
}

#[test]
fn links_in_an_archive_are_refused() {
    let bench = Bench::empty();
    let archive = bench.path("rec.tar");
    fs::write(
        &archive,
        tar(&[("rec/rgb.txt".to_owned(), Vec::new())], b'2'),
    )
    .expect("written");
    bench
        .run_on(&archive, &[])
        .fails_with(&["rec.tar", "rec/rgb.txt", "link"]);
}

#[test]
fn truncated_archives_are_refused() {
    let bench = Bench::empty();
    for (name, bytes) in archives(&entries()) {
        fs::write(bench.path(name), &bytes[..bytes.len() / 2]).expect("written");
        bench
            .run_on(&bench.path(name), &[])
            .fails_with(&[name, "expected a whole"]);
    }
    fs::write(bench.path("rec.zip"), zip(&entries()[..1])).expect("written");
    let words = [
        "rec.zip",
        "without a folder that holds rgb.txt and depth.txt",
    ];
    bench.run_on(&bench.path("rec.zip"), &[]).fails_with(&words);
}

#[test]
fn a_bad_frame_in_an_archive_is_skipped() {
    let bench = Bench::empty();
    let mut entries = entries();
    let damaged = entries
        .iter_mut()
        .find(|(name, _)| name == "rec/rgb/0.066667.png");
    damaged.expect("frame 2").1.truncate(100);
    for (name, bytes) in archives(&entries) {
        fs::write(bench.path(name), bytes).expect("written");
        let answer = bench.run_on(&bench.path(name), &[]).succeeds();
        assert!(answer.out.contains("5 of 6 frames"), "{answer:?}");
        let words = format!("{name}/rec/rgb/0.066667.png");
        assert!(answer.err.contains(&words), "`{words}`: {answer:?}");
    }
}
