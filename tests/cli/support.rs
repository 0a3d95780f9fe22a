//! Running the program, and recordings to run it on.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use tempfile::TempDir;

/// Exit code and output of the program.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

/// Runs the program; a panic or a signal fails the test at once.
pub(crate) fn garad<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>) -> Answer {
    answer(program().args(args))
}

pub(crate) fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_garad"))
}

pub(crate) fn answer(command: &mut Command) -> Answer {
    let Output {
        status,
        stdout,
        stderr,
    } = command.output().expect("the program starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    let answer = Answer {
        code: status.code(),
        out: text(stdout),
        err: text(stderr),
    };
    assert!(
        matches!(answer.code, Some(0 | 2)) && !answer.err.contains("panicked"),
        "{command:?}: {answer:?}"
    );
    answer
}

impl Answer {
    /// Exit code 0 and no error.
    #[track_caller]
    pub(crate) fn succeeds(self) -> Self {
        assert_eq!(self.code, Some(0), "{self:?}");
        assert!(!self.err.contains("error"), "{self:?}");
        self
    }

    /// Exit code 2 and one line of error that holds every one of `words`.
    #[track_caller]
    pub(crate) fn fails_with(self, words: &[&str]) -> Self {
        assert_eq!(self.code, Some(2), "{self:?}");
        let mut errors = self.err.lines().filter(|line| line.contains("error"));
        let (Some(error), None) = (errors.next(), errors.next()) else {
            panic!("expected one line of error: {self:?}");
        };
        assert!(error.starts_with("error: "), "{error}");
        for word in words {
            assert!(error.contains(word), "`{word}` is not in: {error}");
        }
        self
    }

    /// That error is also the last line.
    #[track_caller]
    pub(crate) fn fails_at_last_with(self, words: &[&str]) -> Self {
        let answer = self.fails_with(words);
        let last = answer.err.lines().last().unwrap_or_default();
        assert!(last.starts_with("error: "), "{answer:?}");
        answer
    }
}

/// A scene of 160x120 pixels, made once.
///
/// It is in the build folder and is rewritten by every run of the tests with the same bytes, each file
/// atomically, so that simultaneous runs do not disturb each other.
pub(crate) fn recording(scene: &str, frames: usize) -> PathBuf {
    let name = format!("{scene}_{frames}");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("cli")
        .join(name);
    let frames = frames.to_string();
    let size = ["--size", "160x120", "--frames", &frames, "--quiet", "-o"];
    answer(program().arg("synth").arg(scene).args(size).arg(&folder)).succeeds();
    folder
}

/// Six frames of a room with little motion. The first is a keyframe, the others are not.
pub(crate) fn short() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| recording("quiet_desk", 6))
}

/// Forty frames of the same, enough for a relative error over a second and several keyframes.
pub(crate) fn long() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| recording("quiet_desk", 40))
}

/// Twelve frames with a person in them.
pub(crate) fn walking() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| recording("walking", 12))
}

/// The same for longer: after the first ten frames it is labelled.
pub(crate) fn walking_on() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| recording("walking", 20))
}

/// The folder of a test: its own recording, to be damaged, and the results.
#[derive(Debug)]
pub(crate) struct Bench {
    folder: TempDir,
}

impl Bench {
    /// With a copy of [`short`].
    pub(crate) fn new() -> Self {
        let bench = Self::empty();
        copy(short(), &bench.rec());
        bench
    }

    /// Without a recording.
    pub(crate) fn empty() -> Self {
        Self {
            folder: tempfile::tempdir().expect("temporary folder"),
        }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The recording.
    pub(crate) fn rec(&self) -> PathBuf {
        self.path("rec")
    }

    /// The results.
    pub(crate) fn out(&self) -> PathBuf {
        self.path("out")
    }

    /// A file of the recording.
    pub(crate) fn read(&self, name: &str) -> String {
        fs::read_to_string(self.rec().join(name)).expect("a text file")
    }

    pub(crate) fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.rec().join(name), bytes).expect("written");
    }

    pub(crate) fn remove(&self, name: &str) {
        fs::remove_file(self.rec().join(name)).expect("removed");
    }

    /// Replaces text in a file of the recording, which must hold it.
    pub(crate) fn replace(&self, name: &str, from: &str, to: &str) {
        let text = self.read(name);
        assert!(text.contains(from), "{name} holds no `{from}`: {text}");
        self.write(name, text.replacen(from, to, 1));
    }

    /// `garad run` on the recording.
    pub(crate) fn run(&self, options: &[&str]) -> Answer {
        self.run_on(&self.rec(), options)
    }

    /// `garad run` on another recording.
    pub(crate) fn run_on(&self, recording: &Path, options: &[&str]) -> Answer {
        run_into(recording, &self.out(), options)
    }
}

/// `garad run RECORDING -o OUT --quiet OPTIONS`.
pub(crate) fn run_into(recording: &Path, out: &Path, options: &[&str]) -> Answer {
    let mut command = program();
    command.arg("run").arg(recording).arg("-o").arg(out);
    answer(command.arg("--quiet").args(options))
}

/// Results that must be the same bytes for the same input.
pub(crate) const STABLE: [&str; 5] = [
    "trajectory.txt",
    "keyframes.txt",
    "map.ply",
    "losses.csv",
    "config.toml",
];

/// Both folders hold the same bytes of [`STABLE`].
#[track_caller]
pub(crate) fn assert_same_results(a: &Path, b: &Path) {
    for name in STABLE {
        let read = |folder: &Path| fs::read(folder.join(name)).expect("a result");
        assert!(
            read(a) == read(b),
            "{name} differs: {} and {}",
            a.display(),
            b.display()
        );
    }
}

/// metrics.json of a folder of results.
pub(crate) fn metrics(out: &Path) -> serde_json::Value {
    let text = fs::read_to_string(out.join("metrics.json")).expect("metrics.json");
    serde_json::from_str(&text).expect("JSON")
}

/// Names of all files below a folder, hidden ones included.
pub(crate) fn files(folder: &Path) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let entry = entry.expect("an entry");
        let name = entry.file_name().into_string().expect("UTF-8");
        if entry.path().is_dir() {
            let below = files(&entry.path());
            names.extend(below.iter().map(|below| format!("{name}/{below}")));
        } else {
            names.insert(name);
        }
    }
    names
}

/// Rows of `frames.csv`, by column, without those that are different in every run.
pub(crate) fn frame_rows(out: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(out.join("frames.csv")).expect("frames.csv");
    let mut lines = text.lines();
    let header = lines.next().expect("a header");
    let stable = "frame,t_s,state,keypoints,moving_share,inliers,keyframe";
    assert!(header.starts_with(stable), "{header}");
    let rows = lines.map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    rows.map(|mut row| {
        assert_eq!(row.len(), 11, "{row:?}: a value in each column");
        row.truncate(7);
        row
    })
    .collect()
}

/// Copies a folder.
pub(crate) fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("made");
    for entry in fs::read_dir(from).expect("a folder") {
        let entry = entry.expect("an entry");
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).expect("copied");
        }
    }
}

/// A path as an argument.
pub(crate) fn arg(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}
