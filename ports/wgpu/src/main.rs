//! garad's map part on a GPU, judged by the golden cases:
//!
//! ```text
//! garad golden check --exec 'garad-wgpu {case} {out}'
//! ```
//!
//! Exit code 77 says that a stage is not ported.

mod adam;
mod case;
mod field;
mod gpu;
mod losses;
mod render;
mod stages;
mod sums;
mod train;

use std::path::Path;
use std::process::ExitCode;

use case::Case;
use gpu::Gpu;

/// What went wrong, in words.
type Error = String;

const NOT_PORTED: u8 = 77;

fn answer(folder: &Path, out: &Path) -> Result<ExitCode, Error> {
    let case = Case::read(folder)?;
    let Some(stage) = stages::of(&case) else {
        return Ok(ExitCode::from(NOT_PORTED));
    };
    stage(&Gpu::new()?, &case)?.write(out)?;
    Ok(ExitCode::SUCCESS)
}

/// Milliseconds of the stage, from inputs in memory of the host to outputs there, `times` times on one device.
fn time(folder: &Path, times: &str) -> Result<ExitCode, Error> {
    let case = Case::read(folder)?;
    let stage = stages::of(&case).ok_or("this stage is not ported")?;
    let gpu = Gpu::new()?;
    for _ in 0..times.parse().map_err(|e| format!("{times}: {e}"))? {
        let start = std::time::Instant::now();
        stage(&gpu, &case)?;
        println!("{:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    }
    Ok(ExitCode::SUCCESS)
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let done = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["device"] => Gpu::new().map(|gpu| {
            println!("{}", gpu.name);
            ExitCode::SUCCESS
        }),
        ["time", folder, times] => time(Path::new(folder), times),
        [folder, out] => answer(Path::new(folder), Path::new(out)),
        _ => Err("usage: garad-wgpu CASE OUT | garad-wgpu device".to_owned()),
    };
    done.unwrap_or_else(|error| {
        eprintln!("garad-wgpu: {error}");
        ExitCode::FAILURE
    })
}
