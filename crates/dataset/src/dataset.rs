//! [`Dataset`]: a recording, opened; [`Frame`]: one moment of it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use garad_core::{DepthImage, FrameId, MaskImage, RgbImage, StampedPose};
use image::ColorType;

use crate::calibration::{Calibration, PRESETS, Preset};
use crate::decode::{self, Origin};
use crate::errors::DatasetError;
use crate::files::{clean_name, read_file};
use crate::layout::{self, Context, Layout, Pair, Remarks, Unpaired};
use crate::list::Entry;
use crate::options::OpenOptions;
use crate::source::{Source, image_size};

/// Images whose size is compared with the camera's before the first frame.
const FIRST_IMAGES: usize = 5;
/// The folder of a recording that holds its masks, if it has any.
pub const MASK_FOLDER: &str = "mask";

/// Colour and depth of one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Position among the frames read, from 0.
    pub id: FrameId,
    /// Time of the colour image, seconds.
    pub t_s: f64,
    /// Time of the depth image by the same clock, seconds: its stamp less the calibration's `depth_delay_s`.
    pub depth_t_s: f64,
    /// Colour, as recorded (distorted).
    pub rgb: RgbImage,
    /// Depth in metres; 0 is missing.
    pub depth: DepthImage,
}

/// Colour images of a recording that are no frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeftOut {
    /// How many.
    pub frames: usize,
    /// What they lack, as `without a depth image within 20 ms`.
    pub why: String,
}

/// A recording: lists read, images paired, camera known. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Dataset {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    path: PathBuf,
    source: Source,
    name: String,
    preset: Option<Preset>,
    calibration: Calibration,
    layout: &'static dyn Layout,
    pairs: Vec<Pair>,
    ground_truth: Option<Vec<StampedPose>>,
    remarks: Remarks,
    left_out: Option<LeftOut>,
}

impl Dataset {
    /// Opens a folder or an archive.
    ///
    /// [`Dataset::layout`] tells how its files are arranged. TUM's colour and depth images are paired by time
    /// ([`associate`](fn@crate::associate)), those of others by number; images without a partner are dropped
    /// and counted in the warnings. The camera comes from the first of: the calibration file of the
    /// options; their preset; `camera.txt` or `calibration.toml` of the recording; its layout; the preset in the
    /// name of the recording. [`Calibration::source`] tells which.
    ///
    /// # Errors
    /// [`DatasetError`] with file and line, when lists or calibration cannot be read or no frame is
    /// left. Images are not decoded here; only the header of the first one is read.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DatasetError> {
        if !(options.max_dt_s >= 0.0 && options.max_dt_s.is_finite()) {
            return Err(DatasetError::Option {
                option: "max_dt_s",
                value: options.max_dt_s.to_string(),
                expected: "seconds, finite and not negative",
            });
        }
        if !options.depth_offset_s.is_finite() {
            return Err(DatasetError::Option {
                option: "depth_offset_s",
                value: options.depth_offset_s.to_string(),
                expected: "seconds, finite",
            });
        }
        let (source, layout) = Source::open(path)?;
        let name = source.name();
        let named = Preset::from_recording_name(&name);
        let (mut calibration, of_layout) =
            choose_calibration(path, &source, layout, named, options)?;
        if let Some(factor) = options.depth_factor {
            calibration = calibration.with_depth_factor(factor)?;
        }
        let mut remarks = Remarks::default();
        let context = Context {
            path,
            source: &source,
            options,
            fps: calibration.fps,
        };
        let all = layout.pairs(&context, &mut remarks)?;
        let (pairs, left_out) = select(path, all, &remarks.unpaired, options)?;
        let ground_truth = layout.truth(&context, &pairs, &mut remarks)?;
        if of_layout && layout.scales_colour() {
            calibration = at_size_of_depth(calibration, &source, &pairs);
        }
        let dataset = Inner {
            path: path.to_path_buf(),
            source,
            name,
            preset: options.preset.or(named),
            calibration,
            layout,
            pairs,
            ground_truth,
            remarks,
            left_out,
        };
        dataset.check_first().map(|inner| Self {
            inner: Arc::new(inner),
        })
    }

    /// Name of the recording: that of its folder, in an archive too.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.inner.name
    }

    /// The preset of the options, or the one in the name of the recording (the calibration may still
    /// come from a file).
    #[must_use]
    pub fn preset(&self) -> Option<Preset> {
        self.inner.preset
    }

    /// The camera.
    #[must_use]
    pub fn calibration(&self) -> &Calibration {
        &self.inner.calibration
    }

    /// How its files are arranged, in words.
    #[must_use]
    pub fn layout(&self) -> &'static str {
        self.inner.layout.name()
    }

    /// Number of frames.
    #[must_use]
    pub fn len(&self) -> usize {
        self.inner.pairs.len()
    }

    /// Colour images listed among the frames that the options choose: [`Dataset::len`] frames and those
    /// of [`Dataset::left_out`]. A time listed twice counts once.
    #[must_use]
    pub fn listed(&self) -> usize {
        self.len() + self.inner.left_out.as_ref().map_or(0, |out| out.frames)
    }

    /// Colour images that are no frame, if there are any: between the first and the last frame that the options
    /// choose, and beyond them at an end of the recording.
    #[must_use]
    pub fn left_out(&self) -> Option<&LeftOut> {
        self.inner.left_out.as_ref()
    }

    /// Never true: a recording without frames is an error.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.inner.pairs.is_empty()
    }

    /// Time of frame i, seconds; `None` past the end.
    #[must_use]
    pub fn timestamp(&self, i: usize) -> Option<f64> {
        self.inner.pairs.get(i).map(|pair| pair.colour.t_s)
    }

    /// The true trajectory as `groundtruth.txt` or its like has it, if there is one. For BONN these are poses
    /// of the marker body, see [`crate::bonn`].
    #[must_use]
    pub fn ground_truth(&self) -> Option<&[StampedPose]> {
        self.inner.ground_truth.as_deref()
    }

    /// Warnings, one sentence each.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.inner.remarks.warnings
    }

    /// What was assumed, one sentence each: times of frames without stamps, for example.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.inner.remarks.notes
    }

    /// Decodes frame i.
    ///
    /// # Errors
    /// [`DatasetError::NoSuchFrame`], [`DatasetError::Absent`], [`DatasetError::Image`],
    /// [`DatasetError::ImageSize`], [`DatasetError::TooLarge`], each with frame and file.
    pub fn read(&self, i: usize) -> Result<Frame, DatasetError> {
        self.inner.read(i)
    }

    /// The mask of frame i from a folder of masks: `<timestamp as in rgb.txt>.png`, or named as
    /// the colour image. 255 moving, 0 static, 128 unknown.
    ///
    /// # Errors
    /// [`DatasetError::NoSuchFrame`], [`DatasetError::NotFound`], [`DatasetError::Image`],
    /// [`DatasetError::ImageSize`].
    pub fn read_mask(&self, dir: &Path, i: usize) -> Result<MaskImage, DatasetError> {
        let read = |name: &str| read_file(&dir.join(name));
        let found = self.inner.find_mask(i, read, |name| dir.join(name))?;
        found.ok_or_else(|| DatasetError::NotFound {
            path: dir.join(self.inner.mask_names(i)[0].as_str()),
            expected: "a mask named by the timestamp of its colour image",
        })
    }

    /// The mask of frame i from a folder of the recording itself, archives included; names and values as
    /// for [`Dataset::read_mask`]. `None` without such a folder or a mask for this frame. The usual folder
    /// is [`MASK_FOLDER`].
    ///
    /// # Errors
    /// [`DatasetError::NoSuchFrame`]; [`DatasetError::UnsafeName`] for a folder outside the
    /// recording; [`DatasetError::Image`], [`DatasetError::ImageSize`], [`DatasetError::TooLarge`],
    /// [`DatasetError::Archive`].
    pub fn read_own_mask(&self, folder: &str, i: usize) -> Result<Option<MaskImage>, DatasetError> {
        let source = &self.inner.source;
        let Some(folder) = clean_name(folder) else {
            return Err(DatasetError::UnsafeName {
                path: self.inner.path.clone(),
                name: folder.to_owned(),
            });
        };
        let inside = |name: &str| format!("{folder}/{name}");
        let read = |name: &str| source.read(&inside(name));
        self.inner
            .find_mask(i, read, |name| source.locate(&inside(name)))
    }

    /// Whether the recording has a folder of this name, such as [`MASK_FOLDER`].
    #[must_use]
    pub fn has_folder(&self, folder: &str) -> bool {
        clean_name(folder).is_some_and(|folder| self.inner.source.has_folder(&folder))
    }
}

impl Inner {
    fn pair(&self, i: usize) -> Result<&Pair, DatasetError> {
        self.pairs.get(i).ok_or_else(|| DatasetError::NoSuchFrame {
            path: self.path.clone(),
            frame: i,
            len: self.pairs.len(),
        })
    }

    /// Possible file names of the mask of frame i, which must exist; the preferred one first.
    fn mask_names(&self, i: usize) -> [String; 2] {
        let colour = &self.pairs[i].colour;
        let stem = Path::new(&colour.file).file_stem().unwrap_or_default();
        [
            format!("{}.png", colour.stamp),
            format!("{}.png", stem.to_string_lossy()),
        ]
    }

    /// The first mask that `read` finds, decoded; `locate` gives the path for messages.
    fn find_mask(
        &self,
        i: usize,
        read: impl Fn(&str) -> Result<Option<Vec<u8>>, DatasetError>,
        locate: impl Fn(&str) -> PathBuf,
    ) -> Result<Option<MaskImage>, DatasetError> {
        self.pair(i)?;
        for name in self.mask_names(i) {
            if let Some(bytes) = read(&name)? {
                let origin = Origin {
                    frame: Some(i),
                    path: &locate(&name),
                };
                let mask = decode::mask(&bytes, origin)?;
                self.check_size(origin, mask.size())?;
                return Ok(Some(mask));
            }
        }
        Ok(None)
    }

    fn read(&self, i: usize) -> Result<Frame, DatasetError> {
        let Pair { colour, depth, .. } = self.pair(i)?;
        let at = |path| Origin {
            frame: Some(i),
            path,
        };
        let [rgb_list, depth_list] = self.layout.lists();
        let scales = self.layout.scales_colour();
        let path = self.source.locate(&colour.file);
        let mut rgb = decode::colour(&self.image_bytes(i, colour, rgb_list)?, at(&path))?;
        if !scales {
            self.check_size(at(&path), rgb.size())?;
        }

        let depth_path = self.source.locate(&depth.file);
        let depth_t_s = depth.t_s - self.calibration.depth_delay_s;
        let depth = decode::depth(
            &self.image_bytes(i, depth, depth_list)?,
            at(&depth_path),
            self.calibration.depth_factor,
            self.calibration.missing_from(),
        )?;
        let size = self.frame_size(i, rgb.size(), depth.size())?;
        if size != rgb.size() {
            rgb = decode::shrink(&rgb, size);
        }
        at(&depth_path).check_size(depth.size(), size, "the colour image")?;
        self.check_size(at(&path), rgb.size())?;
        Ok(Frame {
            id: FrameId(u32::try_from(i).unwrap_or(u32::MAX)), // lists hold at most a million
            t_s: colour.t_s,
            depth_t_s,
            rgb,
            depth,
        })
    }

    fn image_bytes(
        &self,
        frame: usize,
        entry: &Entry,
        list: &str,
    ) -> Result<Vec<u8>, DatasetError> {
        self.source
            .read(&entry.file)?
            .ok_or_else(|| DatasetError::Absent {
                frame,
                path: self.source.locate(&entry.file),
                list: self.source.locate(list),
                line: entry.line,
            })
    }

    /// Size of frame i by those of its images: that of depth, where a larger colour image is scaled down to it.
    fn frame_size(
        &self,
        i: usize,
        colour: (usize, usize),
        depth: (usize, usize),
    ) -> Result<(usize, usize), DatasetError> {
        const REFERENCE: &str = "the colour image, which is scaled down to depth of the same proportions; export both at one size";
        if !self.layout.scales_colour() {
            return Ok(colour);
        }
        if decode::can_shrink(colour, depth) {
            return Ok(depth);
        }
        let path = self.source.locate(&self.pairs[i].depth.file);
        let origin = Origin {
            frame: Some(i),
            path: &path,
        };
        origin.check_size(depth, colour, REFERENCE).map(|()| colour)
    }

    fn check_size(&self, origin: Origin<'_>, size: (usize, usize)) -> Result<(), DatasetError> {
        let camera = &self.calibration.camera;
        let reference = format!("the calibration ({})", self.calibration.source);
        origin.check_size(size, (camera.width, camera.height), &reference)
    }

    /// Checks the size of the first images against the camera: an error if none of them has it. Warns if the kind of
    /// the first is converted. An image that cannot be read, or has another size than others, is left to
    /// [`Inner::read`].
    fn check_first(mut self) -> Result<Self, DatasetError> {
        let mut first_error = None;
        for i in 0..self.pairs.len().min(FIRST_IMAGES) {
            let file = &self.pairs[i].colour.file;
            let path = self.source.locate(file);
            let origin = Origin {
                frame: Some(i),
                path: &path,
            };
            let Ok(Some(bytes)) = self.source.read(file) else {
                continue;
            };
            let Ok(kind) = decode::probe_colour(&bytes, origin) else {
                continue;
            };
            let size = match image_size(&self.source, &self.pairs[i].depth.file) {
                Ok(Some(depth)) => self.frame_size(i, kind.size, depth),
                _ => Ok(kind.size),
            };
            let checked = size.and_then(|size| self.check_size(origin, size));
            if let Err(error) = checked {
                first_error.get_or_insert(error);
                continue;
            }
            let conversion = match kind.color {
                ColorType::Rgba8 => "its alpha is dropped",
                ColorType::L8 => "grey is used for all three colours",
                ColorType::La8 => "grey is used for all three colours, its alpha is dropped",
                _ => return Ok(self),
            };
            let kind = decode::describe(kind);
            let warning = format!("{}: {kind}; {conversion}", path.display());
            self.remarks.warnings.push(warning);
            return Ok(self);
        }
        first_error.map_or(Ok(self), Err)
    }
}

/// The camera, and whether the layout says it.
fn choose_calibration(
    path: &Path,
    source: &Source,
    layout: &dyn Layout,
    named: Option<Preset>,
    options: &OpenOptions,
) -> Result<(Calibration, bool), DatasetError> {
    if let Some(calibration) = given_calibration(source, options)? {
        return Ok((calibration, false));
    }
    if let Some(calibration) = layout.calibration(source)? {
        return Ok((calibration, true));
    }
    let Some(preset) = named else {
        return Err(DatasetError::NoCalibration {
            path: path.to_path_buf(),
            file: layout.camera_file(),
            presets: PRESETS,
        });
    };
    let mut calibration = preset.calibration();
    calibration.source = format!("preset {}, from the recording's name", preset.name());
    Ok((calibration, false))
}

/// The calibration of the options, or of a file of ours in the recording.
fn given_calibration(
    source: &Source,
    options: &OpenOptions,
) -> Result<Option<Calibration>, DatasetError> {
    if let Some(file) = &options.calibration {
        return Calibration::read(file).map(Some);
    }
    if let Some(preset) = options.preset {
        return Ok(Some(preset.calibration()));
    }
    for file in ["camera.txt", "calibration.toml"] {
        if let Some(bytes) = source.read(file)? {
            return Calibration::parse(&source.locate(file), &bytes).map(Some);
        }
    }
    Ok(None)
}

/// The frames that the options leave, and the colour images among them that are none.
fn select(
    path: &Path,
    pairs: Vec<Pair>,
    unpaired: &Unpaired,
    options: &OpenOptions,
) -> Result<(Vec<Pair>, Option<LeftOut>), DatasetError> {
    let first = options.first_frame;
    if first >= pairs.len() {
        return Err(DatasetError::NoSuchFrame {
            path: path.to_path_buf(),
            frame: first,
            len: pairs.len(),
        });
    }
    if options.max_frames == Some(0) {
        return Err(DatasetError::Option {
            option: "max_frames",
            value: "0".to_owned(),
            expected: "at least 1",
        });
    }
    let count = options.max_frames.unwrap_or(usize::MAX);
    let (total, until) = (pairs.len(), first.saturating_add(count));
    let chosen: Vec<Pair> = pairs.into_iter().skip(first).take(count).collect();
    let inside = |t_s: f64| {
        (first == 0 || t_s > chosen[0].colour.t_s)
            && (until >= total || t_s < chosen[chosen.len() - 1].colour.t_s)
    };
    let frames = unpaired.times_s.iter().filter(|t_s| inside(**t_s)).count();
    let left_out = (frames > 0).then(|| LeftOut {
        frames,
        why: unpaired.why.clone(),
    });
    Ok((chosen, left_out))
}

/// A layout's camera for images that are all scaled down to the size of the depth images.
fn at_size_of_depth(calibration: Calibration, source: &Source, pairs: &[Pair]) -> Calibration {
    let mut first = pairs.iter().take(FIRST_IMAGES);
    let size = first.find_map(|pair| image_size(source, &pair.depth.file).ok().flatten());
    match size {
        Some(size) => layout::scale_to(calibration, size),
        None => calibration,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames at 1, 2, 4, 5, 7 s; images without depth at 0, 3, 3.5, 6, 8, 9 s.
    #[test]
    fn images_left_out_are_counted_in_the_range_that_is_chosen() {
        let entry = |t_s: f64| Entry {
            t_s,
            stamp: String::new(),
            file: String::new(),
            line: 1,
        };
        let pair = |t_s| Pair {
            colour: entry(t_s),
            depth: entry(t_s),
            number: 0,
        };
        let unpaired = Unpaired {
            why: "without depth".to_owned(),
            times_s: vec![0.0, 3.0, 3.5, 6.0, 8.0, 9.0],
        };
        for (first_frame, max_frames, frames, left_out) in [
            (0, None, 5, 6),
            (0, Some(9), 5, 6),
            (0, Some(5), 5, 6),
            (0, Some(4), 4, 3), // 0, 3, 3.5; 6 is after the last frame chosen
            (0, Some(2), 2, 1),
            (1, None, 4, 5),
            (1, Some(2), 2, 2),
            (2, Some(2), 2, 0),
            (4, None, 1, 2),
        ] {
            let options = OpenOptions {
                first_frame,
                max_frames,
                ..OpenOptions::default()
            };
            let all = [1.0, 2.0, 4.0, 5.0, 7.0].map(pair).to_vec();
            let (chosen, found) =
                select(Path::new("rec"), all, &unpaired, &options).expect("inside");
            let expected = (left_out > 0).then(|| LeftOut {
                frames: left_out,
                why: "without depth".to_owned(),
            });
            let what = format!("{max_frames:?} from {first_frame}");
            assert_eq!((chosen.len(), found), (frames, expected), "{what}");
        }
    }
}
