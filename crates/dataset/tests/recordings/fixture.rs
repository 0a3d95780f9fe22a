//! A small valid recording, to be damaged.

use std::fs;
use std::path::{Path, PathBuf};

use garad_dataset::{Dataset, DatasetError, OpenOptions};
use image::{DynamicImage, ImageBuffer, Luma, Rgb};
use tempfile::TempDir;

/// Columns and rows.
pub(crate) const SIZE: (u32, u32) = (8, 6);
/// Colour of pixel (x, y) of frame i.
pub(crate) fn colour(i: u32, x: u32, y: u32) -> [u8; 3] {
    [i, 10 * x, 10 * y].map(|v| u8::try_from(v).expect("small"))
}
/// Raw depth of pixel (x, y) of frame i.
pub(crate) fn raw_depth(i: u32, x: u32, y: u32) -> u16 {
    u16::try_from(1000 * i + 100 * y + x).expect("small")
}

/// Colour at 1.00, 1.10, ...; depth 5 ms later; camera.txt; three poses.
pub(crate) struct Recording {
    folder: TempDir,
}

impl Recording {
    pub(crate) fn new(frames: u32) -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        let this = Self { folder };
        for sub in ["rgb", "depth"] {
            fs::create_dir(this.at(sub)).expect("made");
        }
        let (mut rgb, mut depth) = ("# colour\n".to_owned(), "# depth\n".to_owned());
        for i in 0..frames {
            let (a, b) = (format!("1.{i}0"), format!("1.{i}05"));
            rgb += &format!("{a} rgb/{a}.png\n");
            depth += &format!("{b} depth/{b}.png\n");
            let (w, h) = SIZE;
            ImageBuffer::from_fn(w, h, |x, y| Rgb(colour(i, x, y)))
                .save(this.at(&format!("rgb/{a}.png")))
                .expect("saved");
            ImageBuffer::from_fn(w, h, |x, y| Luma([raw_depth(i, x, y)]))
                .save(this.at(&format!("depth/{b}.png")))
                .expect("saved");
        }
        this.write("rgb.txt", rgb);
        this.write("depth.txt", depth);
        this.write("camera.txt", "# comment\n8 6 10 11 3.5 2.5 5000 30\n");
        this.write("groundtruth.txt", "1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n");
        this
    }

    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn at(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.at(name), bytes).expect("written");
    }

    pub(crate) fn save(&self, name: &str, image: impl Into<DynamicImage>) {
        image.into().save(self.at(name)).expect("saved");
    }

    pub(crate) fn remove(&self, name: &str) {
        fs::remove_file(self.at(name)).expect("removed");
    }

    pub(crate) fn open(&self) -> Result<Dataset, DatasetError> {
        Dataset::open(self.path(), &OpenOptions::default())
    }

    /// The message of opening or of reading frame i.
    pub(crate) fn error_of(&self, i: usize) -> String {
        let answer = self.open().and_then(|dataset| dataset.read(i));
        let message = answer.expect_err("it is spoilt").to_string();
        assert!(!message.contains('\n'), "one line: {message}");
        message
    }
}
