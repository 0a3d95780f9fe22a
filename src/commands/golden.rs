//! `garad golden`: any backend against the golden cases.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand, ValueEnum};
use garad::conformance::own::{self, Width};
use garad::conformance::port::{self, Ended, Job};
use garad::progress;
use garad_golden::judge::{Answers, CaseVerdict, Outcome, judge, read_answers};
use garad_golden::{Case, Class, Dtype, npy, report, stages, tol};
use serde_json::{Value, json};

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
    Tolerances,
}

#[derive(Debug, Args)]
struct Filter {
    /// Folder that holds STAGE/CASE/case.json [default: tests/golden of the checkout].
    #[arg(long, value_name = "DIR")]
    cases: Option<PathBuf>,
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
        Command::List(args) => list(args)?,
        Command::Check(args) => return check(args),
        Command::Answer(args) => return answer(args),
        Command::Tolerances => tolerances()?,
    }
    Ok(ExitCode::SUCCESS)
}

impl Filter {
    /// The cases asked for, in the order of the data.
    fn load(&self) -> Result<Vec<Case>> {
        let root = match &self.cases {
            Some(root) => root.clone(),
            None => default_root()?,
        };
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
                tag.is_none_or(|tag| c.has_flag(tag) || c.basis() == tag)
            })
            .collect();
        if cases.is_empty() {
            bail!("{}: no such case", root.display());
        }
        cases.sort_by_key(|c| (stages::rank(c.stage()), c.name()));
        Ok(cases)
    }
}

/// `tests/golden` here, or in the checkout this program was built from.
fn default_root() -> Result<PathBuf> {
    let here = PathBuf::from("tests/golden");
    let roots = [here, Case::root()];
    let found = roots.into_iter().find(|root| root.is_dir());
    found.context("tests/golden: no such folder; start in a checkout, or name it with --cases")
}

fn tensors<'a>(case: &'a Case, names: impl Iterator<Item = &'a str>, inputs: bool) -> Vec<Value> {
    let entry = |name: &str| {
        let tensor = if inputs {
            case.input(name)
        } else {
            case.output(name)
        };
        let tolerance = case.tolerance(name).ok().filter(|_| !inputs);
        json!({
            "name": name,
            "dtype": tensor.dtype().name(),
            "shape": tensor.shape(),
            "tolerance": tolerance.map(|t| t.name),
        })
    };
    names.map(entry).collect()
}

fn list(args: &ListArgs) -> Result<()> {
    let cases = args.filter.load()?;
    if args.json {
        let entry = |case: &Case| {
            json!({
                "stage": case.stage(),
                "case": case.case(),
                "folder": case.folder(),
                "why": case.why(),
                "basis": case.basis(),
                "equations": case.equations(),
                "flags": case.flags(),
                "params": case.param_names().map(|n| (n, case.param(n))).collect::<BTreeMap<_, _>>(),
                "inputs": tensors(case, case.input_names(), true),
                "outputs": tensors(case, case.output_names(), false),
            })
        };
        let list: Vec<Value> = cases.iter().map(entry).collect();
        return say(&serde_json::to_string_pretty(&list)?);
    }
    let mut stage = "";
    for case in &cases {
        if case.stage() != stage {
            stage = case.stage();
            let about = stages::find(stage).map_or("", |s| s.about);
            say(&format!("{stage}: {about}"))?;
        }
        let equations = match case.equations() {
            [] => String::new(),
            some => format!(" · {}", some.join(", ")),
        };
        say(&format!("  {} · {}{equations}", case.case(), case.basis()))?;
        say(&format!("      {}", case.why()))?;
        let shape = |name: &str, tensor: &garad_golden::Tensor| {
            format!("{name} {}{:?}", tensor.dtype().name(), tensor.shape())
        };
        let inputs = case.input_names().map(|n| shape(n, case.input(n)));
        let outputs = case.output_names().map(|n| shape(n, case.output(n)));
        say(&format!(
            "      in   {}",
            inputs.collect::<Vec<_>>().join(", ")
        ))?;
        say(&format!(
            "      out  {}",
            outputs.collect::<Vec<_>>().join(", ")
        ))?;
    }
    say(&format!("{} cases", cases.len()))?;
    for (part, why) in stages::MISSING {
        say(&format!("without a case: {part} ({why})"))?;
    }
    Ok(())
}

/// Largest share of each tolerance that this project's own stages use, in both widths.
fn margins() -> Result<BTreeMap<String, f64>> {
    let mut margins = BTreeMap::new();
    let cases = Case::load_root(&default_root()?)?;
    for width in [Width::F64, Width::F32] {
        for case in &cases {
            let Some(answers) = own::answers(case, width)? else {
                continue;
            };
            for output in judge(case, &answers, false).outputs {
                let Some(comparison) = output.comparison else {
                    continue;
                };
                let narrow = output.dtype == Some(Dtype::F32)
                    && case.output(&output.name).dtype() == Dtype::F64
                    && tol::find(comparison.tolerance.name) != Some(&comparison.tolerance);
                let suffix = if narrow { SCALED } else { "" };
                let name = format!("{}{suffix}", comparison.tolerance.name);
                let seen = margins.entry(name).or_insert(0.0f64);
                *seen = seen.max(comparison.worst);
            }
        }
    }
    Ok(margins)
}

/// Marks a tolerance of f64 that was widened for f32.
const SCALED: &str = " x 2^29";

fn tolerances() -> Result<()> {
    let margins = margins()?;
    let seen = |name: &str| {
        margins
            .get(name)
            .map_or("-".to_owned(), |m| format!("{m:.3}"))
    };
    say(&format!("{:36} {:28} seen   reason", "name", "allowed"))?;
    for t in tol::TABLE {
        let part = |abs: f64, rel: f64, of: &str| match (abs > 0.0, rel > 0.0) {
            (true, false) => format!("{abs:e}"),
            (false, _) => format!("{rel:e} {of}"),
            (true, true) => format!("{abs:e} + {rel:e} {of}"),
        };
        let rule = match t.class {
            Class::Exact => "exact".to_owned(),
            Class::Ulp(n) => format!("{n} ulp"),
            Class::AbsRel { abs, rel } => part(abs, rel, "|x|"),
            Class::Vector { abs, rel } => part(abs, rel, "max |x|"),
            Class::Banded { tight, share, hard } => {
                format!("{tight:e}; {} %: {hard:e}", 100.0 * share)
            }
        };
        say(&format!(
            "{:36} {rule:28} {:6} {}",
            t.name,
            seen(t.name),
            t.reason
        ))?;
        let scaled = format!("{}{SCALED}", t.name);
        if margins.contains_key(&scaled) {
            say(&format!(
                "{scaled:36} {:28} {:6} as above, for f32",
                "",
                seen(&scaled)
            ))?;
        }
    }
    say(
        "seen: the largest share of it that this project's own stages use; -: they are not run here",
    )?;
    say("f32 without an entry of its own: 2^29 times the tolerance, if that is at most 1e-12")
}

/// Exit code 77 for a stage that is not among [`own::STAGES`], as for any port.
fn answer(args: &AnswerArgs) -> Result<ExitCode> {
    let case = Case::load(&args.case)?;
    let Some(answers) = own::answers(&case, args.width.into())? else {
        let known = own::STAGES.join(", ");
        progress::note(&format!("{}: not one of {known}", case.stage()));
        return Ok(ExitCode::from(UNSUPPORTED));
    };
    make_folder(&args.out)?;
    for name in case.output_names() {
        if let Some(Ok(tensor)) = answers.get(name) {
            let path = args.out.join(format!("{name}.npy"));
            std::fs::write(&path, npy::encode(tensor))
                .with_context(|| format!("{}: cannot write", path.display()))?;
        }
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
        std::fs::write(path, text).with_context(|| format!("{}: cannot write", path.display()))?;
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
    for name in case.output_names() {
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
        let answers: Option<Answers> = own::answers(case, width)?;
        Ok(answers.map_or_else(
            || CaseVerdict::without_outputs(case, Outcome::Unsupported),
            |answers| judge(case, &answers, false),
        ))
    };
    cases.iter().map(verdict).collect()
}
