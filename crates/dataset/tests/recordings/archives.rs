//! Recordings inside archives, and hostile archives.

use std::fs::{self, File};
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use garad_dataset::{Dataset, DatasetError, MASK_FOLDER, OpenOptions};
use image::{ImageBuffer, ImageFormat, Luma};
use tempfile::TempDir;
use zip::write::SimpleFileOptions;

use crate::fixture::{Recording, SIZE};

const FILES: [&str; 8] = [
    "rgb.txt",
    "depth.txt",
    "camera.txt",
    "groundtruth.txt",
    "rgb/1.00.png",
    "rgb/1.10.png",
    "depth/1.005.png",
    "depth/1.105.png",
];

fn open(path: &Path) -> Result<Dataset, DatasetError> {
    Dataset::open(path, &OpenOptions::default())
}

fn error_of(path: &Path) -> String {
    let message = open(path).expect_err("it is damaged").to_string();
    assert!(!message.contains('\n'), "one line: {message}");
    message
}

/// One tar entry with an unchecked name.
fn append(tar: &mut tar::Builder<Vec<u8>>, kind: tar::EntryType, name: &str, bytes: &[u8]) {
    let mut header = tar::Header::new_ustar();
    header.set_entry_type(kind);
    header.set_size(bytes.len() as u64);
    header.set_mode(0o644);
    header.as_mut_bytes()[..name.len()].copy_from_slice(name.as_bytes());
    header.set_cksum();
    tar.append(&header, bytes).expect("memory takes everything");
}

fn good_tar(prefix: &str) -> tar::Builder<Vec<u8>> {
    let recording = Recording::new(2);
    let mut tar = tar::Builder::new(Vec::new());
    append(&mut tar, tar::EntryType::Directory, "./", b"");
    for name in FILES {
        let bytes = fs::read(recording.at(name)).expect("there");
        append(
            &mut tar,
            tar::EntryType::Regular,
            &format!("{prefix}{name}"),
            &bytes,
        );
    }
    tar
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).expect("memory takes everything");
    encoder.finish().expect("memory takes everything")
}

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("temporary folder"))
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, bytes).expect("written");
        path
    }

    /// A zip of (name, Unix mode, bytes).
    fn zip(&self, name: &str, entries: &[(String, u32, Vec<u8>)]) -> PathBuf {
        let path = self.0.path().join(name);
        let mut zip = zip::ZipWriter::new(File::create(&path).expect("made"));
        for (name, mode, bytes) in entries {
            let options = SimpleFileOptions::default().unix_permissions(*mode);
            if mode & 0o170_000 == 0o120_000 {
                let target = String::from_utf8_lossy(bytes).into_owned();
                zip.add_symlink(name, target, options).expect("added");
            } else {
                zip.start_file(name, options).expect("started");
                zip.write_all(bytes).expect("written");
            }
        }
        zip.finish().expect("written");
        path
    }
}

fn good_entries(prefix: &str) -> Vec<(String, u32, Vec<u8>)> {
    let recording = Recording::new(2);
    let entry = |name: &&str| {
        let bytes = fs::read(recording.at(name)).expect("there");
        (format!("{prefix}{name}"), 0o644, bytes)
    };
    FILES.iter().map(entry).collect()
}

#[test]
fn archives_read_like_folders() {
    let recording = Recording::new(2);
    let direct = recording.open().expect("good");
    let folder = Folder::new();
    let tar = good_tar("some/rgbd_room/").into_inner().expect("finished");
    let archives = [
        (folder.file("a.tar", &tar), "rgbd_room"),
        (folder.file("a.tar.gz", &gzip(&tar)), "rgbd_room"),
        (folder.file("named_wrongly.zip", &gzip(&tar)), "rgbd_room"),
        (
            folder.zip("a.zip", &good_entries("rgbd_room/")),
            "rgbd_room",
        ),
        (folder.zip("flat.zip", &good_entries("")), "flat"),
        (
            folder.file(
                "room.tgz",
                &gzip(&good_tar("./").into_inner().expect("finished")),
            ),
            "room",
        ),
    ];
    for (path, name) in archives {
        let dataset = open(&path).expect("good");
        assert_eq!(dataset.name(), name, "{}", path.display());
        assert_eq!(dataset.len(), 2, "frames");
        assert_eq!(dataset.ground_truth(), direct.ground_truth(), "truth");
        assert_eq!(
            dataset.calibration().camera,
            direct.calibration().camera,
            "camera"
        );
        for i in 0..2 {
            let frame = dataset.read(i).expect("good");
            assert_eq!(
                frame,
                direct.read(i).expect("good"),
                "{} {i}",
                path.display()
            );
        }
        assert_eq!(
            dataset.frames(2).filter(Result::is_ok).count(),
            2,
            "on another thread"
        );
        let left: Vec<_> = fs::read_dir(folder.0.path()).expect("listed").collect();
        assert_eq!(left.len(), 6, "nothing is unpacked");
    }
}

/// Masks inside a folder and inside any archive.
#[test]
fn masks_are_read_from_inside() {
    let mut png = Vec::new();
    ImageBuffer::from_fn(SIZE.0, SIZE.1, |x, _| {
        Luma([[0u8, 128, 255][x as usize % 3]])
    })
    .write_to(&mut Cursor::new(&mut png), ImageFormat::Png)
    .expect("written");
    let recording = Recording::new(2);
    fs::create_dir(recording.at("mask")).expect("made");
    recording.write("mask/1.00.png", &png);
    let with_mask = |prefix: &str| {
        let mut tar = good_tar(prefix);
        let name = format!("{prefix}mask/1.00.png");
        append(&mut tar, tar::EntryType::Regular, &name, &png);
        tar.into_inner().expect("finished")
    };
    let mut entries = good_entries("rgbd_room/");
    entries.push(("rgbd_room/mask/1.00.png".to_owned(), 0o644, png.clone()));
    let folder = Folder::new();
    let recordings = [
        recording.path().to_path_buf(),
        folder.file("a.tar", &with_mask("")),
        folder.file("a.tgz", &gzip(&with_mask("some/rgbd_room/"))),
        folder.zip("a.zip", &entries),
    ];
    for path in recordings {
        let dataset = open(&path).expect("good");
        let at = path.display();
        assert!(dataset.has_folder(MASK_FOLDER), "{at}");
        let mask = dataset.read_own_mask(MASK_FOLDER, 0).expect("good");
        let mask = mask.expect("frame 0 has one");
        assert_eq!(mask.row(3)[..4], [0, 128, 255, 0], "{at}");
        let from_outside = dataset.read_mask(&recording.at("mask"), 0);
        assert_eq!(from_outside.expect("good"), mask, "{at}: one convention");
        let second = dataset.read_own_mask(MASK_FOLDER, 1).expect("no fault");
        assert_eq!(second, None, "{at}: frame 1 has none");
        let past = dataset.read_own_mask(MASK_FOLDER, 2).expect_err("2 frames");
        assert!(matches!(past, DatasetError::NoSuchFrame { .. }), "{past}");
        assert!(!dataset.has_folder("mas"), "{at}: half a name");
        let other = dataset.read_own_mask("masks", 0).expect("no fault");
        assert_eq!(other, None, "{at}: another folder");
        for climbing in ["..", "/mask", "mask/../..", ""] {
            let error = dataset.read_own_mask(climbing, 0).expect_err(climbing);
            assert!(matches!(error, DatasetError::UnsafeName { .. }), "{error}");
            assert!(!dataset.has_folder(climbing), "{climbing}");
        }
    }
    let bare = folder.file("bare.tar", &good_tar("").into_inner().expect("finished"));
    assert!(!open(&bare).expect("good").has_folder(MASK_FOLDER), "none");
}

/// A bad mask is reported with archive and frame.
#[test]
fn bad_masks_are_reported() {
    let mut entries = good_entries("");
    entries.push(("mask/1.10.png".to_owned(), 0o644, b"no picture".to_vec()));
    let folder = Folder::new();
    let dataset = open(&folder.zip("a.zip", &entries)).expect("opens");
    let error = dataset.read_own_mask(MASK_FOLDER, 1).expect_err("spoilt");
    let message = error.to_string();
    assert!(message.contains("a.zip/mask/1.10.png"), "{message}");
    assert!(message.contains("frame 1"), "{message}");
}

#[test]
fn long_names_are_read() {
    let folder = Folder::new();
    let deep = format!("{}/", "a_long_folder_name_".repeat(8));
    // GNU long names, as `tar` writes them ...
    let mut gnu = tar::Builder::new(Vec::new());
    let recording = Recording::new(2);
    for name in FILES {
        gnu.append_path_with_name(recording.at(name), format!("{deep}{name}"))
            .expect("appended");
    }
    let path = folder.file("gnu.tar", &gnu.into_inner().expect("finished"));
    assert!(open(&path).expect("good").read(1).is_ok(), "GNU");
    // ... and pax records.
    let mut pax = tar::Builder::new(Vec::new());
    append(
        &mut pax,
        tar::EntryType::XGlobalHeader,
        "global",
        b"18 comment=whatever\n",
    );
    for name in FILES {
        let full = format!("{deep}{name}");
        pax.append_pax_extensions([("mtime", b"1.5".as_slice()), ("path", full.as_bytes())])
            .expect("appended");
        let bytes = fs::read(recording.at(name)).expect("there");
        append(&mut pax, tar::EntryType::Regular, "short", &bytes);
    }
    let path = folder.file("pax.tgz", &gzip(&pax.into_inner().expect("finished")));
    assert!(open(&path).expect("good").read(1).is_ok(), "pax");
}

#[test]
fn names_that_lead_outside_are_refused() {
    let folder = Folder::new();
    for name in [
        "../evil.txt",
        "/etc/passwd",
        "a/../../evil.png",
        "a\\..\\evil",
        "C:/evil.txt",
    ] {
        let mut tar = good_tar("x/");
        append(&mut tar, tar::EntryType::Regular, name, b"gotcha");
        let tar = tar.into_inner().expect("finished");
        let mut entries = good_entries("x/");
        entries.push((name.to_owned(), 0o644, b"gotcha".to_vec()));
        for path in [
            folder.file("a.tar", &tar),
            folder.file("a.tgz", &gzip(&tar)),
            folder.zip("a.zip", &entries),
        ] {
            let message = error_of(&path);
            assert!(
                message.contains("refused") && message.contains("evil")
                    || message.contains("passwd"),
                "{message}"
            );
        }
    }
    // Quoted in part.
    let mut entries = good_entries("x/");
    entries.push((format!("../evil{}", "/a".repeat(30_000)), 0o644, Vec::new()));
    let message = error_of(&folder.zip("a.zip", &entries));
    assert!(
        message.contains("../evil/a") && message.len() < 300,
        "{message}"
    );
    // A long name is a name too.
    let mut tar = good_tar("x/");
    append(
        &mut tar,
        tar::EntryType::GNULongName,
        "././@LongLink",
        b"../evil.txt\0",
    );
    append(&mut tar, tar::EntryType::Regular, "fine.txt", b"gotcha");
    let path = folder.file("long.tar", &tar.into_inner().expect("finished"));
    assert!(error_of(&path).contains("evil"), "long name");
    let mut tar = good_tar("x/");
    tar.append_pax_extensions([("path", b"/evil.txt".as_slice())])
        .expect("appended");
    append(&mut tar, tar::EntryType::Regular, "fine.txt", b"gotcha");
    let path = folder.file("pax.tar", &tar.into_inner().expect("finished"));
    assert!(error_of(&path).contains("evil"), "pax name");
}

#[test]
fn links_and_devices_are_refused() {
    let folder = Folder::new();
    let kinds = [
        (tar::EntryType::Symlink, "link"),
        (tar::EntryType::Link, "link"),
        (tar::EntryType::Char, "device"),
        (tar::EntryType::Block, "device"),
        (tar::EntryType::Fifo, "pipe"),
        (tar::EntryType::GNUSparse, "special file"),
    ];
    for (kind, word) in kinds {
        let mut tar = good_tar("x/");
        append(&mut tar, kind, "x/rgb/1.20.png", b"");
        let tar = tar.into_inner().expect("finished");
        for path in [
            folder.file("a.tar", &tar),
            folder.file("a.tgz", &gzip(&tar)),
        ] {
            let message = error_of(&path);
            assert!(
                message.contains(word) && message.contains("1.20.png"),
                "{message}"
            );
        }
    }
    let mut entries = good_entries("x/");
    entries.push(("x/evil.png".to_owned(), 0o120_777, b"/etc/passwd".to_vec()));
    let message = error_of(&folder.zip("a.zip", &entries));
    assert!(
        message.contains("link") && message.contains("evil"),
        "{message}"
    );
}

#[test]
fn decompression_bombs_are_refused() {
    let folder = Folder::new();
    // 60 MiB of nothing in 60 kB; passed over as a file, counted as a bomb.
    let mut tar = good_tar("x/");
    append(
        &mut tar,
        tar::EntryType::Regular,
        "x/zeros.bin",
        &vec![0; 60 << 20],
    );
    let mut tar = tar.into_inner().expect("finished");
    let message = error_of(&folder.file("a.tgz", &gzip(&tar)));
    assert!(message.contains("per packed byte"), "{message}");
    // As a plain tar it is no bomb.
    assert!(
        open(&folder.file("a.tar", &tar)).is_ok(),
        "sixty megabytes on disk"
    );
    tar.clear();

    let mut entries = good_entries("x/");
    entries.push(("x/rgb/zeros.png".to_owned(), 0o644, vec![0; 60 << 20]));
    entries[0].2 = b"1.00 rgb/zeros.png\n".to_vec(); // rgb.txt
    let dataset = open(&folder.zip("a.zip", &entries)).expect("not looked into yet");
    let message = dataset.read(0).expect_err("a bomb").to_string();
    assert!(message.contains("per packed byte"), "{message}");

    // A file that claims more than fits, and a long name that does.
    let mut tar = good_tar("x/");
    let mut header = tar::Header::new_ustar();
    header.set_size(65 << 20);
    header.set_path("x/rgb/huge.png").expect("short");
    header.set_cksum();
    tar.append(&header, &b""[..])
        .expect("memory takes everything");
    let path = folder.file("huge.tar", &tar.into_inner().expect("finished"));
    assert!(
        matches!(open(&path), Err(DatasetError::TooLarge { .. })),
        "65 MiB"
    );
    let mut tar = good_tar("x/");
    append(
        &mut tar,
        tar::EntryType::GNULongName,
        "././@LongLink",
        &vec![b'a'; 70_000],
    );
    let path = folder.file("name.tar", &tar.into_inner().expect("finished"));
    assert!(error_of(&path).contains("long name"), "70 kB of name");
}

#[test]
fn broken_archives_are_reported() {
    let folder = Folder::new();
    let tar = good_tar("x/").into_inner().expect("finished");
    let packed = gzip(&tar);
    let zip = fs::read(folder.zip("whole.zip", &good_entries("x/"))).expect("there");
    let cases: [(&str, &[u8], &str); 7] = [
        ("cut.tgz", &packed[..packed.len() / 2], "broken archive"),
        ("cut.tar", &tar[..1536 + 512 + 10], "cut.tar"),
        ("cut.zip", &zip[..zip.len() / 2], "broken archive"),
        ("text.tgz", b"hello", "neither gzip, zip nor tar"),
        ("empty.zip", b"", "neither gzip, zip nor tar"),
        (
            "other.tgz",
            &gzip(b"not a tar, although long enough to be looked at"),
            "other.tgz",
        ),
        (
            "none.zip",
            b"PK\x05\x06\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0",
            "rgb.txt",
        ),
    ];
    for (name, bytes, expected) in cases {
        let message = error_of(&folder.file(name, bytes));
        assert!(message.contains(expected), "{name}: {message}");
    }
    // A file that is passed over does not hide that the rest is missing.
    let mut tar = good_tar("x/");
    append(
        &mut tar,
        tar::EntryType::Regular,
        "x/README.md",
        &[b'a'; 2000],
    );
    append(&mut tar, tar::EntryType::Regular, "x/rgb/1.20.png", b"");
    let tar = tar.into_inner().expect("finished");
    let cut = &tar[..tar.len() - 1024 - 512 - 1000];
    for path in [
        folder.file("end.tar", cut),
        folder.file("end.tgz", &gzip(cut)),
    ] {
        assert!(
            error_of(&path).contains("broken archive"),
            "cut in README.md"
        );
    }
    // A name of two lines in the message of the reader: a size that is no number.
    let mut tar = good_tar("x/").into_inner().expect("finished");
    tar.truncate(tar.len() - 1024);
    let mut header = tar::Header::new_ustar();
    header.as_mut_bytes()[..3].copy_from_slice(b"a\nb");
    header.as_mut_bytes()[124..136].fill(b'z');
    header.set_cksum();
    tar.extend_from_slice(header.as_bytes());
    for path in [
        folder.file("size.tar", &tar),
        folder.file("size.tgz", &gzip(&tar)),
    ] {
        let message = error_of(&path);
        assert!(
            message.contains("size.t") && message.contains("not a number"),
            "{message}"
        );
    }
    let mut twice = good_entries("a/");
    twice.extend(good_entries("b/"));
    let message = error_of(&folder.zip("twice.zip", &twice));
    assert!(message.contains("several recordings"), "{message}");
}

/// A damaged archive gives a recording or an error, never a panic.
#[test]
fn damaged_archives_do_not_panic() {
    let folder = Folder::new();
    let tar = good_tar("x/").into_inner().expect("finished");
    let zip = fs::read(folder.zip("whole.zip", &good_entries("x/"))).expect("there");
    let good = [gzip(&tar), tar, zip];
    let mut refused = 0;
    for case in 0..300u64 {
        let mut rng = garad_core::Rng::keyed(5, &[case]);
        let mut bytes = good[rng.below(3)].clone();
        for _ in 0..=rng.below(3) {
            let at = rng.below(bytes.len());
            match rng.below(3) {
                0 => bytes[at] ^= 1 << rng.below(8),
                1 => bytes[at] = 0xFF,
                _ => bytes.truncate(at.max(1)),
            }
        }
        let path = folder.file("damaged", &bytes);
        match open(&path) {
            Ok(dataset) => refused += dataset.frames(0).filter(Result::is_err).count(),
            Err(_) => refused += 1,
        }
    }
    assert!(refused > 30, "damage is noticed, {refused} times");
}
