//! The committed cases of the stage `pyramid`: both pyramids as OpenCV computes them.

use garad_core::GrayImage;
use garad_core::pyramid::{GrayPyramid, level_scales};
use garad_golden::Case;

fn check(case: &Case, name: &str, level: &GrayImage) {
    let expected = case.output(name).shape();
    assert_eq!(
        expected,
        [level.height(), level.width()],
        "{}: size of {name}",
        case.name()
    );
    let got: Vec<f64> = level.data().iter().copied().map(f64::from).collect();
    case.check(name, &got)
        .unwrap_or_else(|report| panic!("{report}"));
}

#[test]
fn both_pyramids_are_opencvs() {
    for case in Case::load_all("pyramid") {
        let tensor = case.input("image");
        let (height, width) = (tensor.shape()[0], tensor.shape()[1]);
        let image = GrayImage::from_vec(width, height, tensor.u8()).expect("as the shape says");
        let halved = GrayPyramid::halved(image.clone(), 3);
        for l in 1..=3 {
            check(&case, &format!("half_{l}"), &halved.levels()[l]);
        }
        let scaled = GrayPyramid::scaled(image, 1.2, 8);
        for l in 1..8 {
            check(&case, &format!("orb_{l}"), &scaled.levels()[l]);
        }
        let scales: Vec<f64> = level_scales(1.2, 8).into_iter().map(f64::from).collect();
        case.check("scales", &scales)
            .unwrap_or_else(|report| panic!("{report}"));
    }
}
