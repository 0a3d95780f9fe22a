//! Frames decoded ahead.

use garad_dataset::DatasetError;

use crate::fixture::Recording;

#[test]
fn prefetching_does_not_change_the_frames() {
    let recording = Recording::new(6);
    let dataset = recording.open().expect("good");
    let direct: Vec<_> = (0..6).map(|i| dataset.read(i).expect("good")).collect();
    for prefetch in [0, 1, 2, 100] {
        let frames = dataset.frames(prefetch);
        assert_eq!(frames.len(), 6, "length is known");
        let frames: Result<Vec<_>, _> = frames.collect();
        assert_eq!(frames.expect("good"), direct, "{prefetch} ahead");
        for first in [0, 4, 6, 9] {
            let rest: Result<Vec<_>, _> = dataset.frames_from(first, prefetch).collect();
            let expected = &direct[first.min(6)..];
            assert_eq!(
                rest.expect("good"),
                expected,
                "from {first}, {prefetch} ahead"
            );
        }
    }
}

#[test]
fn a_bad_frame_is_an_error_and_the_next_follows() {
    let recording = Recording::new(4);
    recording.remove("rgb/1.20.png");
    let dataset = recording.open().expect("opens");
    for prefetch in [0, 3] {
        let ids: Vec<_> = dataset
            .frames(prefetch)
            .map(|frame| frame.map(|f| f.id.index()))
            .collect();
        assert!(
            matches!(ids[0], Ok(0)) && matches!(ids[1], Ok(1)),
            "{ids:?}"
        );
        assert!(
            matches!(ids[2], Err(DatasetError::Absent { frame: 2, .. })),
            "{ids:?}"
        );
        assert!(matches!(ids[3], Ok(3)) && ids.len() == 4, "{ids:?}");
    }
}

/// The drop waits for the thread, which a full channel would otherwise block for ever.
#[test]
fn dropping_early_ends_the_thread() {
    let recording = Recording::new(8);
    let dataset = recording.open().expect("good");
    for taken in 0..3 {
        let mut frames = dataset.frames(1);
        for _ in 0..taken {
            frames.next().expect("there").expect("good");
        }
        drop(frames);
    }
    let mut frames = dataset.frames(2);
    assert_eq!(frames.by_ref().count(), 8, "all");
    assert!(
        frames.next().is_none() && frames.next().is_none(),
        "and none after"
    );
}
