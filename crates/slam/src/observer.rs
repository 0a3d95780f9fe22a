//! [`Observer`]: how timings leave a library that knows no clock.

/// A stage of the pipeline, as reports name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Keypoints and descriptors of a new frame.
    Orb,
    /// Landmarks of the last frame or a keyframe found in the new one, and the first pose.
    TrackMotion,
    /// What moves in the frame: samples, random field, flow check.
    Label,
    /// The local map projected into the frame, and the final pose.
    TrackLocalMap,
    /// The pose found by rendering the map.
    TrackRender,
    /// A lost camera searched for among the keyframes.
    Relocalise,
    /// A keyframe and its landmarks added, weak landmarks dropped.
    Keyframe,
    /// The random field over the landmarks of a keyframe.
    LabelMap,
    /// Local bundle adjustment.
    LocalBa,
    /// Loop closing.
    Loop,
    /// Tracking waits for a mapping job that is due (one thread: the job itself).
    Handover,
    /// Gaussians labelled by a keyframe.
    Relabel,
    /// Gaussians inserted for a keyframe.
    Insert,
    /// One training iteration.
    Train,
}

impl Stage {
    /// The name in reports and `metrics.json`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Orb => "orb",
            Self::TrackMotion => "track_motion",
            Self::Label => "label",
            Self::TrackLocalMap => "track_local_map",
            Self::TrackRender => "track_render",
            Self::Relocalise => "relocalise",
            Self::Keyframe => "keyframe",
            Self::LabelMap => "label_map",
            Self::LocalBa => "local_ba",
            Self::Loop => "loop",
            Self::Handover => "handover",
            Self::Relabel => "relabel",
            Self::Insert => "insert",
            Self::Train => "train",
        }
    }
}

/// Called when a stage begins and ends. Stages of one thread do not nest.
pub trait Observer {
    /// The stage begins.
    fn begin(&mut self, stage: Stage);
    /// The stage is over.
    fn end(&mut self, stage: Stage);
}

/// Observes nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Observer for Silent {
    fn begin(&mut self, _: Stage) {}
    fn end(&mut self, _: Stage) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_stages_share_a_name() {
        use Stage::{
            Handover, Insert, Keyframe, Label, LabelMap, LocalBa, Loop, Orb, Relabel, Relocalise,
            TrackLocalMap, TrackMotion, TrackRender, Train,
        };
        let names = [
            (Orb, "orb"),
            (TrackMotion, "track_motion"),
            (Label, "label"),
            (TrackLocalMap, "track_local_map"),
            (TrackRender, "track_render"),
            (Relocalise, "relocalise"),
            (Keyframe, "keyframe"),
            (LabelMap, "label_map"),
            (LocalBa, "local_ba"),
            (Loop, "loop"),
            (Handover, "handover"),
            (Relabel, "relabel"),
            (Insert, "insert"),
            (Train, "train"),
        ];
        assert!(
            names.is_sorted_by_key(|(stage, _)| *stage),
            "in the order of a frame"
        );
        for (stage, name) in names {
            assert_eq!(stage.name(), name, "{stage:?}");
        }
    }
}
