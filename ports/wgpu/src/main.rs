//! garad's map part on a GPU, judged by the golden cases:
//!
//! ```text
//! garad golden check --exec 'garad-wgpu {case} {out}'
//! garad golden check --exec-batch 'garad-wgpu list {list}'
//! ```
//!
//! Exit code, or status, 77 says that a stage is not ported.

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
const USAGE: &str = "usage:
    garad-wgpu CASE OUT            answers a golden case
    garad-wgpu list LIST           answers those of a list (golden check --exec-batch)
    garad-wgpu train CASE OUT      trains over a case of the stage train_step
    garad-wgpu time CASE TIMES     milliseconds of a case
    garad-wgpu device              the device that would be used";

fn answer(folder: &Path, out: &Path) -> Result<ExitCode, Error> {
    let case = Case::read(folder)?;
    let Some(stage) = stages::of(&case) else {
        return Ok(ExitCode::from(NOT_PORTED));
    };
    stage(&Gpu::new()?, &case)?.write(out)?;
    Ok(ExitCode::SUCCESS)
}

/// Cases one after the other on one device. A line of the list is STAGE, CASE and OUT with tabs between; what one case
/// ended with is the file OUT/status.
fn list(path: &Path) -> Result<ExitCode, Error> {
    let gpu = Gpu::new()?;
    let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    for line in text.lines() {
        let [_, folder, out] = line.split('\t').collect::<Vec<_>>()[..] else {
            return Err(format!("{}: not three fields: {line}", path.display()));
        };
        let done = Case::read(Path::new(folder)).and_then(|case| match stages::of(&case) {
            Some(stage) => stage(&gpu, &case)?.write(Path::new(out)).map(|()| true),
            None => Ok(false),
        });
        let status = match done {
            Ok(true) => "0".to_owned(),
            Ok(false) => NOT_PORTED.to_string(),
            Err(error) => format!("1 {error}"),
        };
        let file = Path::new(out).join("status");
        std::fs::write(&file, status).map_err(|e| format!("{}: {e}", file.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Milliseconds of the stage, from the files of the case to outputs in the memory of the host, `times` times on one device;
/// the first has the compilation of the kernels in it.
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

/// Writes the trained map, the loss of each iteration and the PSNR of each view, dB.
fn train_map(folder: &Path, out: &Path) -> Result<ExitCode, Error> {
    let start = std::time::Instant::now();
    train::run(&Gpu::new()?, &Case::read(folder)?)?.write(out)?;
    println!("{:.1} s", start.elapsed().as_secs_f64());
    Ok(ExitCode::SUCCESS)
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let done = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["device"] => Gpu::new().map(|gpu| {
            println!("{}", gpu.name);
            ExitCode::SUCCESS
        }),
        ["list", path] => list(Path::new(path)),
        ["train", folder, out] => train_map(Path::new(folder), Path::new(out)),
        ["time", folder, times] => time(Path::new(folder), times),
        [folder, out] => answer(Path::new(folder), Path::new(out)),
        _ => Err(USAGE.to_owned()),
    };
    done.unwrap_or_else(|error| {
        eprintln!("garad-wgpu: {error}");
        ExitCode::FAILURE
    })
}
