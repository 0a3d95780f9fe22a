use garad_core::{Image, Real, RgbImage, Rng, Se3, So3, StampedPose};
use nalgebra::Vector3;

use super::*;
use crate::metrics::{JitterMetrics, RpeMetrics};
use crate::{Ate, AteOptions, ImageQuality, Metrics, StageTiming, ate};

/// A walk, an estimate of it that is lost for a while, and all that belongs on the page.
struct Sample {
    metrics: Metrics,
    ate: Ate,
    frames: Vec<FrameState>,
    image: RgbImage,
    warnings: Vec<String>,
}

fn sample() -> Sample {
    let mut rng = Rng::new(5);
    let pose = |t_s: f64, off: Vector3<f64>| {
        let (sin, cos) = Real::sin_cos(0.5 * t_s);
        let at = Vector3::new(1.6 * cos, sin * cos, 0.2 * sin);
        StampedPose {
            t_s,
            world_from_camera: Se3::new(So3::identity(), at + off),
        }
    };
    let times: Vec<f64> = (0..240).map(|i| f64::from(i) / 30.0).collect();
    let truth: Vec<_> = times.iter().map(|&t| pose(t, Vector3::zeros())).collect();
    let mut drift = Vector3::zeros();
    let estimate: Vec<_> = times
        .iter()
        .map(|&t| {
            drift += Vector3::from_fn(|_, _| 0.004 * rng.normal());
            pose(t, drift)
        })
        .collect();
    let lost = 130..150;
    let frames = (0..240).map(|i| FrameState {
        t_s: times[i],
        tracked: !lost.contains(&i),
        keyframe: i % 14 == 0,
        track_ms: Some(24.0 + 6.0 * rng.uniform() + if i % 14 == 0 { 14.0 } else { 0.0 }),
    });
    let frames: Vec<_> = frames.collect();
    let found: Vec<_> = (0..240)
        .filter(|i| !lost.contains(i))
        .map(|i| estimate[i])
        .collect();
    let ate = ate(&truth, &found, &AteOptions::default()).expect("220 pairs");
    let mut metrics = Metrics::new("0.1.0", "rgbd_bonn_<crowd> & more");
    (metrics.frames, metrics.tracked, metrics.threads) = (240, 220, 2);
    metrics.listed = 243;
    metrics.ate = (&ate).into();
    metrics.rpe = RpeMetrics {
        trans_rmse_m_per_s: Some(0.0213),
        rot_rmse_deg_per_s: Some(0.64),
    };
    metrics.jitter = JitterMetrics {
        rms_m: Some(0.001_54),
        ground_truth_rms_m: Some(0.001_62),
    };
    metrics.render.psnr_db = Some(19.4);
    metrics.render.ssim = Some(0.71);
    metrics.render_static.psnr_db = Some(23.8);
    metrics.render_static.ssim = Some(0.842);
    metrics.labels.keypoints.f1 = Some(0.83);
    metrics.labels.keypoints.precision = Some(0.88);
    metrics.labels.keypoints.recall = Some(0.79);
    metrics.labels.pixels.iou = Some(0.61);
    metrics.map.gaussians = Some(124_532);
    metrics.map.dynamic = Some(8_214);
    metrics.wall_s = Some(83.2);
    metrics.peak_rss_mb = Some(412.0);
    for (name, median_ms, p95_ms, calls) in [
        ("orb", 9.1, 11.2, 240),
        ("flow", 4.3, 6.1, 239),
        ("pose", 2.2, 4.0, 239),
        ("local_map", 6.4, 9.9, 239),
        ("bundle_adjustment", 61.0, 88.4, 18),
        ("crf", 12.9, 19.2, 18),
        ("train", 173.0, 240.7, 18),
    ] {
        let timing = StageTiming {
            median_ms,
            p95_ms,
            calls,
            total_ms: calls as f64 * median_ms,
        };
        metrics.timing.insert(name.to_owned(), timing);
    }
    let byte = |v: usize| u8::try_from(v % 256).unwrap_or(0);
    Sample {
        metrics,
        ate,
        frames,
        image: Image::from_fn(160, 120, |x, y| [byte(x), byte(2 * y), byte(x * y / 16)]),
        warnings: vec!["2 frames of the recording could not be read <skipped>".to_owned()],
    }
}

const PROTOCOL: &str = "rigid alignment, nearest time within 0.02 s, raw ground truth";

fn page(sample: &Sample, judged: bool) -> String {
    let strip = |frame| Strip {
        frame,
        t_s: 1.5,
        input: &sample.image,
        render: Some(&sample.image),
        labels: Some(&sample.image),
        quality: Some(ImageQuality {
            psnr_db: 22.84,
            ssim: 0.812,
            pixels: 19_200,
        }),
        outside_mask: true,
    };
    let unjudged = Metrics::new("0.1.0", "my recording");
    html(&ReportData {
        metrics: if judged { &sample.metrics } else { &unjudged },
        protocol: if judged {
            PROTOCOL
        } else {
            "cannot be judged: no ground truth"
        },
        ate: judged.then_some(&sample.ate),
        frames: &sample.frames,
        strips: &[strip(45), strip(120)],
        warnings: &sample.warnings,
        config_toml: "[flow]\nmodel = \"residual\"\n",
    })
}

/// Every element that is opened is closed, in order; all void elements are known.
fn assert_well_formed(html: &str) {
    let mut open: Vec<&str> = Vec::new();
    let style = html.find("</style>").expect("a style");
    for tag in html[style..].split('<').skip(1) {
        let (tag, _) = tag.split_once('>').expect("a tag ends");
        let name = tag.split_whitespace().next().unwrap_or("");
        if let Some(name) = name.strip_prefix('/') {
            match open.pop() {
                Some(opened) => assert_eq!(opened, name, "closing tag"),
                // What was opened before the style.
                None => assert!(["style", "head", "html"].contains(&name), "{name}"),
            }
        } else if !["img", "meta", "br"].contains(&name) && !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
}

#[test]
fn a_whole_page() {
    let sample = sample();
    let html = page(&sample, true);
    // To look at it: GARAD_WRITE_SAMPLE=report.html cargo test -p garad-eval report
    if let Some(path) = std::env::var_os("GARAD_WRITE_SAMPLE") {
        std::fs::write(path, &html).expect("the sample is written");
    }
    assert_well_formed(&html);
    for expected in [
        "<h1>rgbd_bonn_&lt;crowd&gt; &amp; more</h1>",
        "1 min 23 s",
        PROTOCOL,
        "90.5 %",
        "220 of 243 frames listed",
        "2.13 cm/s",
        "1.54 mm",
        "ground truth 1.62 mm",
        "124\u{202f}532",
        "could not be read &lt;skipped&gt;",
        "lost: 20",
        "keyframes: 18",
        "bundle_adjustment",
        "data:image/jpeg;base64,/9j/",
        "frame 45 · 1.50 s · 22.8 dB · SSIM 0.812",
        "model = &quot;residual&quot;",
    ] {
        assert!(html.contains(expected), "'{expected}' is missing");
    }
    assert_eq!(html.matches("<svg").count(), 4, "two views, error, time");
    for foreign in ["<script", "http://www.w3.org/1999", "https://", "NaN"] {
        assert!(!html.contains(foreign), "'{foreign}' on the page");
    }
    assert_eq!(html, page(&sample, true), "same data, same text");
}

#[test]
fn a_page_without_ground_truth_says_so() {
    let html = page(&sample(), false);
    assert_well_formed(&html);
    assert!(html.contains("cannot be judged: no ground truth"), "why");
    assert!(
        !html.contains("judged by"),
        "no protocol without a judgement"
    );
    assert_eq!(html.matches("<svg").count(), 1, "tracking time is known");
}

#[test]
fn an_empty_page_is_a_page() {
    let html = html(&ReportData {
        metrics: &Metrics::new("", ""),
        protocol: "",
        ate: None,
        frames: &[],
        strips: &[],
        warnings: &[],
        config_toml: "",
    });
    assert_well_formed(&html);
    assert!(html.contains("0 of 0 frames listed"), "tracked");
}

#[test]
fn broken_parts_become_sentences() {
    let mut sample = sample();
    sample.image = Image::new(0, 0, [0; 3]);
    sample.frames[3].track_ms = Some(f64::NAN);
    let html = page(&sample, true);
    assert_well_formed(&html);
    assert!(html.contains("No image: 0 x 0 pixels."), "image");
    assert!(html.contains("No plot: error 3 is not finite."), "plot");
}

/// Every text that comes from outside: name, version, protocol, warnings, names of stages, configuration.
#[test]
fn text_cannot_become_markup() {
    const TEXT: &str = "</pre><script>alert('\"&')</script>";
    let mut sample = sample();
    sample.metrics.dataset = TEXT.to_owned();
    sample.metrics.version = TEXT.to_owned();
    let timing = sample.metrics.timing["orb"];
    sample.metrics.timing.insert(TEXT.to_owned(), timing);
    let html = html(&ReportData {
        metrics: &sample.metrics,
        protocol: TEXT,
        ate: Some(&sample.ate),
        frames: &sample.frames,
        strips: &[],
        warnings: &[TEXT.to_owned()],
        config_toml: TEXT,
    });
    assert_well_formed(&html);
    assert!(!html.contains("<script"), "no markup from text");
    let escaped = "&lt;/pre&gt;&lt;script&gt;alert('&quot;&amp;')";
    // The name three times (title, heading, figures in JSON aside), the version twice.
    assert_eq!(html.matches(escaped).count(), 8, "every text");
}

#[test]
fn a_page_of_several_runs() {
    let comparison = crate::comparison::tests::sample();
    let image = RgbImage::new(8, 6, [90, 120, 30]);
    let row = |name, pictures| PictureRow { name, pictures };
    let rows = [
        row("input", vec![Some(&image), Some(&image)]),
        row("whole", vec![Some(&image), None]),
        row("broken", vec![None, None]),
    ];
    let html = comparison_html(&comparison, &[4, 9], &rows);
    assert_well_formed(&html);
    for expected in [
        "<h1>walk</h1>",
        "<td>59 of 64</td>",
        "no &lt;map&gt; | none",
        "X-SLAM, published",
        "Measured once.",
        "frame 9: no pose",
        "No picture",
    ] {
        assert!(html.contains(expected), "'{expected}' is missing");
    }
    assert_eq!(html.matches("<img").count(), 3, "pictures");
}
