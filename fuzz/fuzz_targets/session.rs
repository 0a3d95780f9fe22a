//! The state of a session. The checksum of every section is made right first: what is decoded is as hostile
//! as the input. What was loaded is the same when saved and loaded again. It need not make sense, and is not
//! used (decision 008).

#![no_main]

use std::path::Path;
use std::sync::OnceLock;

use garad::recording::Recording;
use garad::run::{Run, RunOptions};
use garad::slam::Slam;
use garad::slam::session::{FORMAT, PROGRAM, SectionReader};
use garad::source::SourceFrame;
use garad::synth::{Scene, SceneConfig, SceneName};
use garad_core::{Camera, Par};
use garad_fuzz::{check_line, within_mib};
use libfuzzer_sys::fuzz_target;

const MAGIC: &[u8] = b"garad session\n";
/// Magic and format.
const HEADER: usize = MAGIC.len() + 4;
const MIB: usize = 256;

/// The section with the index of places: 590 kB even when it is empty, and so not part of the inputs.
static PLACES: OnceLock<Vec<u8>> = OnceLock::new();

/// A section: all its bytes, its name and its value.
struct Section<'a> {
    whole: &'a [u8],
    name: &'a [u8],
    value: &'a [u8],
}

impl<'a> Section<'a> {
    /// The section at the start of these bytes, if it is whole.
    fn first(bytes: &'a [u8]) -> Option<Self> {
        let (length_of_name, rest) = bytes.split_first()?;
        let (name, rest) = rest.split_at_checked(usize::from(*length_of_name))?;
        let (length, rest) = rest.split_first_chunk()?;
        let (_checksum, rest) = rest.split_first_chunk::<4>()?;
        let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
        let (value, rest) = rest.split_at_checked(length)?;
        let whole = &bytes[..bytes.len() - rest.len()];
        Some(Self { whole, name, value })
    }

    fn checksum(&self) -> [u8; 4] {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(self.name);
        hasher.update(self.value);
        hasher.finalize().to_le_bytes()
    }
}

/// The input with the checksum of each whole section made right and the places put in.
fn completed(data: &[u8]) -> Vec<u8> {
    let (mut session, mut rest) = (Vec::new(), data);
    while !rest.is_empty() {
        if rest.starts_with(MAGIC) && rest.len() >= HEADER {
            session.extend(&rest[..HEADER]);
            rest = &rest[HEADER..];
            continue;
        }
        let Some(section) = Section::first(rest) else {
            break;
        };
        if section.name == b"images" {
            session.extend(PLACES.get().expect("made at the start"));
        }
        let at = session.len() + 1 + section.name.len() + 8;
        session.extend(section.whole);
        session[at..at + 4].copy_from_slice(&section.checksum());
        rest = &rest[section.whole.len()..];
    }
    session.extend(rest);
    session
}

/// Whether the images of the session are large: tables of their size are made at once.
fn is_large(session: &[u8]) -> bool {
    let camera = SectionReader::new(session).and_then(|mut from| from.take::<Camera>("camera"));
    camera.is_ok_and(|camera| camera.width.max(camera.height) > 256)
}

/// Writes `seeds/session`: the state before the first frame, and after the first frame of a small scene. Here and
/// not in `seeds.py`, because sessions of another version or format are refused.
fn write_seeds() -> anyhow::Result<()> {
    const FRAMES: usize = 1;
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("seeds/session");
    std::fs::create_dir_all(&folder)?;
    let scene = Scene::new(&SceneConfig {
        frames: FRAMES,
        width: 96,
        height: 64,
        supersample: 1,
        ..SceneConfig::new(SceneName::QuietDesk)
    })?;
    let mut options = RunOptions {
        threads: 1,
        quiet: true,
        ..RunOptions::default()
    };
    options.config.features.count = 60;
    options.config.features.levels = 1;
    options.config.keyframes.first_min_keypoints = 10;
    options.config.tracking.min_inliers = 5;
    options.config.keyframes.max_gap = 1;
    options.config.keyframes.min_gap = 1;
    options.config.schedule.handover_frames = 1;
    options.config.train.per_keyframe = 1;
    for frames in [0, FRAMES] {
        let seed = folder.join(format!("garad_{PROGRAM}_format_{FORMAT}_frames_{frames}"));
        if PLACES.get().is_some() && seed.is_file() {
            continue;
        }
        let mut run = Run::new(&scene.camera(), &options)?;
        let source = (0..frames).map(|i| {
            let frame = scene.frame(i, Par::Seq);
            Ok(SourceFrame {
                t_s: frame.t_s,
                depth_t_s: frame.t_s,
                rgb: frame.rgb,
                depth: frame.depth,
                mask: None,
                truth: None,
            })
        });
        run.process(source, frames);
        let recording = Recording {
            name: "seed".to_owned(),
            given_masks: false,
            times_s: (0..frames).map(|i| scene.timestamp(i)).collect(),
            fingerprints: [None; 2],
        };
        let mut bytes = Vec::new();
        run.save(&mut bytes, &recording)?;
        let at = bytes.windows(7).position(|window| window == b"\x06places");
        let at = at.expect("a section of every session");
        let places = Section::first(&bytes[at..]).expect("whole").whole.to_vec();
        bytes.drain(at..at + places.len());
        PLACES.get_or_init(|| places);
        std::fs::write(seed, bytes)?;
    }
    Ok(())
}

fn saved(slam: &mut Slam) -> Vec<u8> {
    let mut bytes = Vec::new();
    slam.save(&mut bytes).expect("a state that was read");
    bytes
}

fuzz_target!(init: write_seeds().expect("seeds"), |data: &[u8]| {
    let session = completed(data);
    if is_large(&session) {
        return;
    }
    let read = |mut bytes: &[u8]| within_mib(MIB, || Slam::load(&mut bytes, Par::Seq));
    let mut slam = match read(&session) {
        Ok(slam) => slam,
        Err(error) => return check_line(&error.to_string(), ""),
    };
    let first = saved(&mut slam);
    let mut again = read(&first).expect("what was written");
    assert!(saved(&mut again) == first, "round trip");

    let options = RunOptions {
        config: slam.config().clone(),
        threads: 1,
        seed: slam.seed(),
        strict: false,
        quiet: true,
    };
    let run = within_mib(MIB, || {
        Run::resume(&mut &session[..], slam.camera(), &options)
    });
    if let Err(error) = run {
        check_line(&format!("{error:#}"), "");
    }
});
