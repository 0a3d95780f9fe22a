//! Fixtures of the unit tests: a small camera in front of a wall, and its frames.

    /// Everything here stands in front of a wall so far away, metres, or is it.
    const WALL_M: f32 = 3.0;

    /// A camera of 160 x 120 pixels at the origin.
    pub(crate) fn slam(config: Config) -> Slam {
        let camera = Camera::pinhole((160, 120), [120.0, 120.0, 79.5, 59.5]).expect("valid");
        Slam::new(camera, config, 0, Par::Seq).expect("valid")
    }

    /// Blots of 3 x 3 pixels.
    pub(crate) fn texture() -> GrayImage {
        let mut rng = Rng::new(11);
        let blots = GrayImage::from_fn(60, 41, |_, _| {
            40 + u8::try_from(rng.below(170)).expect("u8")
        });
        GrayImage::from_fn(160, 120, |x, y| blots[(x / 3, y / 3)])
    }

    pub(crate) fn wall() -> DepthImage {
        DepthImage::new(160, 120, WALL_M)
    }

    /// A box half way to the wall that covers these columns and rows.
    pub(crate) fn wall_behind(box_px: [[usize; 2]; 2]) -> DepthImage {
        DepthImage::from_fn(160, 120, |x, y| match is_in(box_px, x, y) {
            true => 0.5 * WALL_M,
            false => WALL_M,
        })
    }

    pub(crate) fn is_in([[x0, x1], [y0, y1]]: [[usize; 2]; 2], x: usize, y: usize) -> bool {
        (x0..x1).contains(&x) && (y0..y1).contains(&y)
    }

    /// Every 8th pixel each way: 20 columns of 15 keypoints.
    pub(crate) fn places() -> Vec<[usize; 2]> {
        let columns = (4..160).step_by(8);
        columns
            .flat_map(|x| (4..120).step_by(8).map(move |y| [x, y]))
            .collect()
    }

    /// A picture with a keypoint at each of [`places`].
    pub(crate) fn frame(slam: &Slam, id: u32, depth: &DepthImage) -> Frame {
        let keypoints: Vec<Keypoint> = places()
            .into_iter()
            .map(|[x, y]| Keypoint {
                x: x as f32,
                y: y as f32,
                level: 0,
                angle_deg: 0.0,
                response: 1.0,
            })
            .collect();
        Frame::new(
            FrameId(id),
            f64::from(id) / 30.0,
            keypoints,
            vec![Descriptor::default(); places().len()],
            depth,
            None,
            &slam.camera,
            &Levels::new((160, 120), 1.2, 8, true),
            &slam.config,
        )
    }

    /// Makes the frame a keyframe and its depth a witness.
    pub(crate) fn keep(slam: &mut Slam, frame: Frame, depth: &DepthImage) -> KeyframeId {
        let id = slam.map.add_keyframe(frame);
        slam.witnesses.insert(id, Witness::new(depth, 8.0));
        id
    }

