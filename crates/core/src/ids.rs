//! Identifiers and labels. Ids only ever grow: none is used twice in a run.

use std::fmt;

use serde::{Deserialize, Serialize};

macro_rules! id {
    ($(#[$doc:meta])* $name:ident, $letter:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
        #[derive(Serialize, Deserialize)]
        pub struct $name(pub u32);

        impl $name {
            /// The id as an index.
            #[inline]
            #[must_use]
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!($letter, "{}"), self.0)
            }
        }
    };
}

id!(
    /// Position of a frame in the recording, from 0.
    FrameId,
    "f"
);
id!(
    /// A keyframe, in order of creation.
    KeyframeId,
    "k"
);
id!(
    /// A landmark: a 3-D point seen by features of several frames.
    LandmarkId,
    "l"
);

/// The paper's L: 0 static, 1 dynamic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[repr(u8)]
pub enum Label {
    /// Does not move.
    #[default]
    Static = 0,
    /// Moves, or moved recently.
    Dynamic = 1,
}
