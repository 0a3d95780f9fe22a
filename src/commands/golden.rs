//! `garad golden`: any backend against the golden cases.

mod batch;
mod list;
mod make;
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
    /// Make cases of any size, with the values of this project's f64 reference.
    Make(make::MakeArgs),
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
    /// With --exec and --exec-batch: seconds per case; for a batch, so many times the number of cases in all.
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    timeout: f64,
    /// With --exec and --exec-batch: keep what the port writes, as DIR/STAGE/CASE/OUTPUT.npy.
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
    /// Program to start once for all cases. {list}, also its standard input, is a file with a line
    /// `STAGE TAB CASE-FOLDER TAB OUT-FOLDER` per case, to be done in this order: write OUTPUT.npy into the last folder, then
    /// a file `status` with the exit code that --exec would have given (0, 77, else a crash with a text behind it).
    #[arg(long, value_name = "CMD")]
    exec_batch: Option<String>,
    /// This project's own stages, in f64 or with --self=f32 in f32.
    #[arg(long = "self", value_name = "WIDTH", num_args = 0..=1, require_equals = true, default_missing_value = "f64")]
    own: Option<OwnWidth>,
}

#[derive(Debug, Args)]
pub(crate) struct AnswerArgs {
    /// Folder of the case.
    #[arg(required_unless_present = "list")]
    case: Option<PathBuf>,
    /// Folder for the outputs.
    #[arg(required_unless_present = "list")]
    out: Option<PathBuf>,
    /// Instead: a list of cases, as a port is given by check --exec-batch.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["case", "out"])]
    list: Option<PathBuf>,
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
        Command::Make(args) => make::make(args)?,
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
    if let Some(list) = &args.list {
        return answer_list(list, args.width.into());
    }
    let (Some(folder), Some(out)) = (&args.case, &args.out) else {
        bail!("a case and a folder, or --list");
    };
    let case = Case::load(folder)?;
    if write_answer(&case, out, args.width.into())? {
        return Ok(ExitCode::SUCCESS);
    }
    let known: Vec<&str> = garad_conformance::STAGES.iter().map(|s| s.0).collect();
    let known = known.join(", ");
    progress::note(&format!("{}: not one of {known}", case.stage()));
    Ok(ExitCode::from(UNSUPPORTED))
}

/// Whether the stage is one of ours; then its outputs are written.
fn write_answer(case: &Case, out: &Path, width: Width) -> Result<bool> {
    let Some(outputs) = own(case, width)? else {
        return Ok(false);
    };
    make_folder(out)?;
    for (name, tensor) in outputs.tensors() {
        let path = out.join(format!("{name}.npy"));
        write_bytes_atomically(&path, &npy::encode(tensor))?;
    }
    Ok(true)
}

/// What a port does that is started once for all cases.
fn answer_list(list: &Path, width: Width) -> Result<ExitCode> {
    let text = std::fs::read_to_string(list).with_context(|| list.display().to_string())?;
    for line in text.lines() {
        let fields: Vec<&str> = line.split('\t').collect();
        let [_, folder, out] = fields[..] else {
            bail!("{}: {line:?} is not STAGE TAB CASE TAB OUT", list.display());
        };
        let out = Path::new(out);
        let answered = Case::load(Path::new(folder))
            .map_err(anyhow::Error::from)
            .and_then(|case| write_answer(&case, out, width));
        let status = match answered {
            Ok(true) => "0\n".to_owned(),
            Ok(false) => format!("{UNSUPPORTED}\n"),
            Err(error) => format!("2 {error:#}\n"),
        };
        make_folder(out)?;
        write_bytes_atomically(&out.join(port::STATUS), status.as_bytes())?;
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
        } => from_port(&cases, line, false, args)?,
        Backend {
            exec_batch: Some(line),
            ..
        } => from_port(&cases, line, true, args)?,
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

/// A program per case, or with `batch` one for all.
fn from_port(
    cases: &[Case],
    line: &str,
    batch: bool,
    args: &CheckArgs,
) -> Result<Vec<CaseVerdict>> {
    let option = if batch { "--exec-batch" } else { "--exec" };
    let words = port::split(line).map_err(|why| anyhow::anyhow!("{option}: {why}"))?;
    let temporary = std::env::temp_dir().join(format!("garad-golden-{}", std::process::id()));
    let root = args.keep.as_ref().unwrap_or(&temporary);
    let timeout = Duration::from_secs_f64(args.timeout);
    let verdicts = if batch {
        let all = timeout.saturating_mul(u32::try_from(cases.len()).unwrap_or(u32::MAX));
        batch::check(cases, &words, root, all, args.allow_missing)
    } else {
        cases
            .iter()
            .map(|case| one_by_port(case, &words, root, args))
            .collect()
    };
    if args.keep.is_none() {
        // A folder that stays behind in the system's temporary one is no error.
        let _ = std::fs::remove_dir_all(&temporary);
    }
    verdicts
}

fn full_path(path: &Path) -> Result<PathBuf> {
    let full = std::path::absolute(path);
    full.with_context(|| format!("{}: no such folder", path.display()))
}

/// The folder for a port's outputs of a case. What an earlier run left behind is no answer.
fn clean_folder(root: &Path, case: &Case) -> Result<PathBuf> {
    let out = root.join(case.stage()).join(case.case());
    make_folder(&out)?;
    for name in case.outputs().keys() {
        let _ = std::fs::remove_file(out.join(format!("{name}.npy")));
    }
    let _ = std::fs::remove_file(out.join(port::STATUS));
    Ok(out)
}

fn one_by_port(
    case: &Case,
    words: &[String],
    root: &Path,
    args: &CheckArgs,
) -> Result<CaseVerdict> {
    let out = clean_folder(root, case)?;
    let (folder, out) = (full_path(case.folder())?, full_path(&out)?);
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
