//! `garad golden check --exec-batch`: one process for all cases; see [`port::run_all`] for what it is told.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use garad_conformance::port::{self, Ended, Job};
use garad_golden::Case;
use garad_golden::answers::read_answers;
use garad_golden::judge::judge;
use garad_golden::verdict::{CaseVerdict, Outcome};

use super::{clean_folder, full_path};

/// Verdicts on all cases; `timeout` is that of all together.
pub(super) fn check(
    cases: &[Case],
    words: &[String],
    root: &Path,
    timeout: Duration,
    allow_missing: bool,
) -> Result<Vec<CaseVerdict>> {
    let folders = |case: &Case| -> Result<[PathBuf; 2]> {
        let out = clean_folder(root, case)?;
        Ok([full_path(case.folder())?, full_path(&out)?])
    };
    let folders: Vec<[PathBuf; 2]> = cases.iter().map(folders).collect::<Result<_>>()?;
    let jobs: Vec<Job<'_>> = cases
        .iter()
        .zip(&folders)
        .map(|(case, [folder, out])| Job {
            stage: case.stage(),
            case: folder,
            out,
        })
        .collect();
    let whole = port::run_all(words, &jobs, &full_path(root)?, timeout)
        .with_context(|| format!("--exec-batch: {} cannot be started", words[0]))?;
    let complete = |i: usize| {
        let there = |name: &String| jobs[i].out.join(format!("{name}.npy")).is_file();
        cases[i].outputs().keys().all(there)
    };
    let ended = port::ended_each(&jobs, &whole, complete);
    let verdict = |((case, job), ended): ((&Case, &Job<'_>), Option<Ended>)| {
        let outcome = match ended {
            Some(Ended::Done) => {
                return judge(case, &read_answers(case, job.out), allow_missing);
            }
            Some(Ended::Unsupported) => Outcome::Unsupported,
            Some(Ended::Crash(why)) => Outcome::Crash(why),
            Some(Ended::Timeout(why)) => Outcome::Timeout(why),
            None => Outcome::Missing,
        };
        CaseVerdict::without_outputs(case, outcome)
    };
    Ok(cases.iter().zip(&jobs).zip(ended).map(verdict).collect())
}
