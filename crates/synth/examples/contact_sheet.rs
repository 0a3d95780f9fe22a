//! Writes every n-th frame of every scene as PPM: colour, and depth, mask and object ids side by side.
//!
//! `cargo run --release -p garad-synth --example contact_sheet -- OUT_DIR [SCENE|all] [EVERY] [WIDTH]`

use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

use garad_core::{Image, Par, RgbImage};
use garad_synth::{Scene, SceneConfig, SceneName};

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let out = args.next().ok_or("expected a folder to write to")?;
    let names = match args.next() {
        Some(name) if name != "all" => vec![name.parse::<SceneName>()?],
        _ => SceneName::all().to_vec(),
    };
    let every: usize = args.next().map_or(Ok(30), |n| n.parse())?;
    let width: usize = args.next().map_or(Ok(640), |n| n.parse())?;
    fs::create_dir_all(&out)?;
    for name in names {
        let config = SceneConfig {
            width,
            height: width * 3 / 4,
            ..SceneConfig::new(name)
        };
        let scene = Scene::new(&config)?;
        for i in (0..scene.len()).step_by(every.max(1)) {
            let started = Instant::now();
            let frame = scene.frame(i, Par::Seq);
            let took = started.elapsed();
            let covered = frame.object.data().iter().filter(|&&id| id > 0).count();
            let share = 100.0 * covered as f64 / frame.object.data().len() as f64;
            writeln!(
                std::io::stdout(),
                "{name} {i}: {} ms, movers {share:.0} %",
                took.as_millis()
            )?;
            let (w, h) = frame.rgb.size();
            write_ppm(
                &Path::new(&out).join(format!("{name}_{i:04}.ppm")),
                &frame.rgb,
            )?;
            let sheet = Image::from_fn(2 * w, h, |x, y| {
                let at = (x % w, y);
                if x < w {
                    #[allow(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "0 to 255"
                    )]
                    let near = (255.0 / (1.0 + frame.depth[at])) as u8;
                    [near; 3]
                } else {
                    [
                        frame.mask[at],
                        frame.object[at].wrapping_mul(60),
                        frame.rgb[at][1] / 2,
                    ]
                }
            });
            write_ppm(
                &Path::new(&out).join(format!("{name}_{i:04}_truth.ppm")),
                &sheet,
            )?;
        }
    }
    Ok(())
}

fn write_ppm(path: &Path, image: &RgbImage) -> std::io::Result<()> {
    let mut bytes = format!("P6\n{} {}\n255\n", image.width(), image.height()).into_bytes();
    bytes.extend(image.data().iter().flatten());
    fs::write(path, bytes)
}
