//! `garad golden`: any backend against the golden cases.

mod list;
mod root;
mod tolerances;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand, ValueEnum};
use garad::progress;
use garad_conformance::port::{self, Ended, Job};
use garad_conformance::{Outputs, Width};
use garad_dataset::write_bytes_atomically;
use garad_golden::answers::read_answers;
use garad_golden::judge::judge;
use garad_golden::verdict::{CaseVerdict, Outcome};
use garad_golden::{Case, npy, report, stages, table};

use super::{make_folder, say};

/// Exit code when a case fails.
const FAILED: u8 = 1;
/// Exit code of a port that does not do a stage; [`port::UNSUPPORTED`].
const UNSUPPORTED: u8 = 77;

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// The cases: what goes in, what must come out, where that is from.
    List(ListArgs),
    /// Compare a port's outputs, or a port itself, with the expected ones. Exit code 0: all
    /// pass, 1: some fail, 2: the command is wrong.
    Check(CheckArgs),
    /// Write this project's outputs of one case as OUTPUT.npy: what a port would write.
    Answer(AnswerArgs),
    /// The tolerances and the reasons for them.
    Tolerances(TolerancesArgs),
}

#[derive(Debug, Args)]
struct At {
    /// Folder that holds STAGE/CASE/case.json [default: GARAD_GOLDEN of the environment, else tests/golden here or in a
    /// folder above].
    #[arg(long, value_name = "DIR")]
    cases: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct Filter {
    #[command(flatten)]
    at: At,
    /// Only this stage; may be given several times.
    #[arg(long, value_name = "S")]
    stage: Vec<String>,
    /// Only cases of this name; may be given several times.
    #[arg(long = "case", value_name = "NAME")]
    name: Vec<String>,
    /// Only cases with this flag or this basis.
    #[arg(long, value_name = "T")]
    tag: Option<String>,
}

#[derive(Debug, Args)]
pub(crate) struct ListArgs {
    #[command(flatten)]
    filter: Filter,
    /// As JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct TolerancesArgs {
    #[command(flatten)]
    at: At,
    /// As JSON, with classes, units and the rule for float32: tests/golden/tolerances.json.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    filter: Filter,
    #[command(flatten)]
    backend: Backend,
    /// Outputs that are not there do not fail, nor cases without any.
    #[arg(long)]
    allow_missing: bool,
    /// With --exec: seconds per case.
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    timeout: f64,
    /// With --exec: keep what the port writes, as DIR/STAGE/CASE/OUTPUT.npy.
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Write every verdict as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
struct Backend {
    /// Folder with STAGE/CASE/OUTPUT.npy.
    #[arg(long, value_name = "DIR")]
    actual: Option<PathBuf>,
    /// Program to start per case; {case} is the folder of the case, {out} the folder for
    /// OUTPUT.npy, {stage} the stage. Exit code 77 says "not this stage". No shell is involved.
    #[arg(long, value_name = "CMD")]
    exec: Option<String>,
    /// This project's own stages, in f64 or with --self=f32 in f32.
    #[arg(long = "self", value_name = "WIDTH", num_args = 0..=1, require_equals = true, default_missing_value = "f64")]
    own: Option<OwnWidth>,
}

#[derive(Debug, Args)]
pub(crate) struct AnswerArgs {
    /// Folder of the case.
    case: PathBuf,
    /// Folder for the outputs.
    out: PathBuf,
    /// In f64, or in f32 where a stage has both.
    #[arg(long, value_enum, default_value = "f64")]
    width: OwnWidth,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum OwnWidth {
    F64,
    F32,
}

impl From<OwnWidth> for Width {
    fn from(width: OwnWidth) -> Self {
        match width {
            OwnWidth::F64 => Self::F64,
            OwnWidth::F32 => Self::F32,
        }
    }
}

pub(crate) fn run(command: &Command) -> Result<ExitCode> {
    match command {
        Command::List(args) => list::list(&args.filter.load()?, args.json)?,
        Command::Check(args) => return check(args),
        Command::Answer(args) => return answer(args),
        Command::Tolerances(args) => {
            let cases = Case::load_root(&args.at.root()?)?;
            match args.json {
                true => say(table::text(&cases)?.trim_end())?,
                false => tolerances::tolerances(&cases)?,
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

impl At {
    fn root(&self) -> Result<PathBuf> {
        root::root(self.cases.as_deref())
    }
}

impl Filter {
    /// The cases asked for, in the order of the data.
    fn load(&self) -> Result<Vec<Case>> {
        let root = self.at.root()?;
        let all = Case::load_root(&root)?;
        let known: Vec<&str> = all.iter().map(Case::stage).collect();
        for stage in &self.stage {
            if !known.contains(&stage.as_str()) {
                let mut known = known.clone();
                known.dedup();
                bail!("no stage '{stage}'; there is {}", known.join(", "));
            }
        }
        let asked =
            |names: &[String], name: &str| names.is_empty() || names.iter().any(|n| n == name);
        let mut cases: Vec<Case> = all
            .into_iter()
            .filter(|c| asked(&self.stage, c.stage()) && asked(&self.name, c.case()))
            .filter(|c| {
                let tag = self.tag.as_deref();
                tag.is_none_or(|tag| c.inputs().has_flag(tag) || c.basis() == tag)
            })
            .collect();
        if cases.is_empty() {
            bail!("{}: no such case", root.display());
        }
        cases.sort_by_key(|c| (stages::rank(c.stage()), c.name()));
        Ok(cases)
    }
}

/// The outputs of this project's own stage, which sees the inputs alone.
fn own(case: &Case, width: Width) -> Result<Option<Outputs>> {
    garad_conformance::answer(case.inputs(), width).map_err(anyhow::Error::from_boxed)
}

/// Exit code 77 for a stage that is not ours, as for any port.
fn answer(args: &AnswerArgs) -> Result<ExitCode> {
    let case = Case::load(&args.case)?;
    let Some(outputs) = own(&case, args.width.into())? else {
        let known: Vec<&str> = garad_conformance::STAGES.iter().map(|s| s.0).collect();
        progress::note(&format!(
            "{}: not one of {}",
            case.stage(),
            known.join(", ")
        ));
        return Ok(ExitCode::from(UNSUPPORTED));
    };
    make_folder(&args.out)?;
    for (name, tensor) in outputs.tensors() {
        let path = args.out.join(format!("{name}.npy"));
        write_bytes_atomically(&path, &npy::encode(tensor))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn check(args: &CheckArgs) -> Result<ExitCode> {
    if !(args.timeout.is_finite() && args.timeout > 0.0 && args.timeout <= 1e6) {
        bail!("--timeout {}: expected seconds, more than 0", args.timeout);
    }
    let cases = args.filter.load()?;
    let verdicts = match &args.backend {
        Backend {
            actual: Some(folder),
            ..
        } => from_folder(&cases, folder, args.allow_missing)?,
        Backend {
            exec: Some(line), ..
        } => from_port(&cases, line, args)?,
        Backend { own, .. } => from_own(&cases, *own)?,
    };
    let passed = !verdicts.iter().any(|v| v.fails(args.allow_missing));
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&report::to_json(&verdicts, passed))?;
        write_bytes_atomically(path, text.as_bytes())?;
    }
    say(report::table(&verdicts).trim_end())?;
    Ok(if passed {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(FAILED)
    })
}

fn from_folder(cases: &[Case], folder: &Path, allow_missing: bool) -> Result<Vec<CaseVerdict>> {
    if !folder.is_dir() {
        bail!("{}: no such folder", folder.display());
    }
    let verdict = |case: &Case| {
        let answers = read_answers(case, &folder.join(case.stage()).join(case.case()));
        judge(case, &answers, allow_missing)
    };
    let verdicts: Vec<_> = cases.iter().map(verdict).collect();
    let missing = verdicts
        .iter()
        .filter(|v| v.outcome == Outcome::Missing)
        .count();
    if missing == verdicts.len() {
        progress::note(&format!(
            "nothing found; expected files like {}/{}/OUTPUT.npy",
            folder.display(),
            cases[0].name()
        ));
    }
    Ok(verdicts)
}

fn from_port(cases: &[Case], line: &str, args: &CheckArgs) -> Result<Vec<CaseVerdict>> {
    let words = port::split(line).map_err(|why| anyhow::anyhow!("--exec: {why}"))?;
    let temporary = std::env::temp_dir().join(format!("garad-golden-{}", std::process::id()));
    let root = args.keep.as_ref().unwrap_or(&temporary);
    let verdicts = cases
        .iter()
        .map(|case| one_by_port(case, &words, root, args))
        .collect();
    if args.keep.is_none() {
        // A folder that stays behind in the system's temporary one is no error.
        let _ = std::fs::remove_dir_all(&temporary);
    }
    verdicts
}

fn one_by_port(
    case: &Case,
    words: &[String],
    root: &Path,
    args: &CheckArgs,
) -> Result<CaseVerdict> {
    let out = root.join(case.stage()).join(case.case());
    make_folder(&out)?;
    // What an earlier run left behind is no answer.
    for name in case.outputs().keys() {
        let _ = std::fs::remove_file(out.join(format!("{name}.npy")));
    }
    let absolute = |path: &Path| {
        let full = std::path::absolute(path);
        full.with_context(|| format!("{}: no such folder", path.display()))
    };
    let (folder, out) = (absolute(case.folder())?, absolute(&out)?);
    let job = Job {
        stage: case.stage(),
        case: &folder,
        out: &out,
    };
    let ended = port::run(words, job, Duration::from_secs_f64(args.timeout));
    let outcome = match ended.with_context(|| format!("--exec: {} cannot be started", words[0]))? {
        Ended::Done => return Ok(judge(case, &read_answers(case, &out), args.allow_missing)),
        Ended::Unsupported => Outcome::Unsupported,
        Ended::Crash(why) => Outcome::Crash(why),
        Ended::Timeout(why) => Outcome::Timeout(why),
    };
    Ok(CaseVerdict::without_outputs(case, outcome))
}

fn from_own(cases: &[Case], width: Option<OwnWidth>) -> Result<Vec<CaseVerdict>> {
    let width = width.unwrap_or(OwnWidth::F64).into();
    let verdict = |case: &Case| -> Result<CaseVerdict> {
        Ok(match own(case, width)? {
            Some(outputs) => judge(case, &outputs.answers(), false),
            None => CaseVerdict::without_outputs(case, Outcome::Unsupported),
        })
    };
    cases.iter().map(verdict).collect()
}
