//! A port as a program: started once per case ([`run`]), or once for all ([`run_all`]).

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Exit code by which a port says that it does not do a stage.
pub const UNSUPPORTED: i32 = 77;
/// How often a running port is looked at.
const POLL: Duration = Duration::from_millis(2);
/// So many bytes of a port's output are repeated.
const TAIL_BYTES: usize = 400;
/// What a port prints goes here, in the folder of its outputs.
const LOG: &str = "port.log";

/// How a port ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ended {
    /// Exit code 0.
    Done,
    /// Exit code 77.
    Unsupported,
    /// Another exit code, or a signal; with the end of its output.
    Crash(String),
    /// Still running after this time, and ended.
    Timeout(String),
}

/// What a port is told.
#[derive(Debug, Clone, Copy)]
pub struct Job<'a> {
    /// `{stage}`.
    pub stage: &'a str,
    /// `{case}`: the folder with case.json and the inputs.
    pub case: &'a Path,
    /// `{out}`: where it writes OUTPUT.npy.
    pub out: &'a Path,
}

/// Splits a command line at blanks; quotes, single or double, hold a word together. No shell is
/// involved, so nothing else has a meaning.
///
/// # Errors
/// The text of what is wrong: no word at all, or a quote without its end.
pub fn split(line: &str) -> Result<Vec<String>, String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for c in line.chars() {
        match quote {
            Some(end) if c == end => quote = None,
            None if c == '"' || c == '\'' => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            None if c.is_whitespace() => words.extend(word.take()),
            _ => word.get_or_insert_default().push(c),
        }
    }
    if let Some(quote) = quote {
        return Err(format!("{line}: a {quote} without its end"));
    }
    words.extend(word);
    if words.is_empty() {
        return Err("the command is empty".to_owned());
    }
    Ok(words)
}

/// Starts the port for one case and waits, at most for `timeout`. What it prints goes to
/// `port.log` in the folder for its outputs.
///
/// # Errors
/// If it cannot be started, or the log cannot be made.
pub fn run(words: &[String], job: Job<'_>, timeout: Duration) -> io::Result<Ended> {
    let [case, out] = [job.case, job.out].map(|path| path.to_string_lossy().into_owned());
    let filled = words.iter().map(|word| {
        word.replace("{stage}", job.stage)
            .replace("{case}", &case)
            .replace("{out}", &out)
    });
    wait_for(filled.collect(), Stdio::null(), &job.out.join(LOG), timeout)
}

/// Name of the file that a port writes last into the folder of a case, when it is started once for all: the exit code
/// it would have had for this case alone, and, behind a blank, what it has to say.
pub const STATUS: &str = "status";
/// Name of the list of cases.
pub const LIST: &str = "cases.tsv";

/// Starts the port once for all cases and waits, at most for `timeout`. `{list}` in its command, and its standard input,
/// is a file with a line `STAGE TAB FOLDER-OF-THE-CASE TAB FOLDER-FOR-OUTPUTS` for each job, in their order. The list
/// and `port.log` are written to `folder`.
///
/// # Errors
/// If it cannot be started, or the list or the log cannot be made, or a path contains a tab or an end of line.
pub fn run_all(
    words: &[String],
    jobs: &[Job<'_>],
    folder: &Path,
    timeout: Duration,
) -> io::Result<Ended> {
    let mut text = String::new();
    for job in jobs {
        let fields = [
            job.stage,
            &job.case.to_string_lossy(),
            &job.out.to_string_lossy(),
        ];
        if fields
            .iter()
            .any(|field| field.contains(['\t', '\n', '\r']))
        {
            let path = job.case.display();
            let why = format!("{path}: a tab or an end of line in a path");
            return Err(io::Error::new(io::ErrorKind::InvalidInput, why));
        }
        text += &fields.join("\t");
        text.push('\n');
    }
    let list: PathBuf = folder.join(LIST);
    std::fs::write(&list, text)?;
    let name = list.to_string_lossy();
    let filled = words.iter().map(|word| word.replace("{list}", &name));
    let input = Stdio::from(File::open(&list)?);
    wait_for(filled.collect(), input, &folder.join(LOG), timeout)
}

/// How each case of a run over all ended, in their order, from the files and how the port as a whole did.
///
/// A case with a [`STATUS`] ended as it says. Else, where the port ended with 0, its files count; with 77, those
/// cases are unsupported. Where it crashed or was ended, a case `complete` counts as done, the first one that is neither is
/// where it happened, and the ones behind it were not reached (`None`). A crash behind the last case is that case's.
#[must_use]
pub fn ended_each(
    jobs: &[Job<'_>],
    whole: &Ended,
    complete: impl Fn(usize) -> bool,
) -> Vec<Option<Ended>> {
    let failed = matches!(whole, Ended::Crash(_) | Ended::Timeout(_));
    let mut each = Vec::with_capacity(jobs.len());
    let mut named = !failed;
    for (i, job) in jobs.iter().enumerate() {
        let stated = std::fs::read_to_string(job.out.join(STATUS)).ok();
        each.push(match stated {
            Some(text) => Some(from_status(&text)),
            None if failed && complete(i) => Some(Ended::Done),
            None if failed && named => None,
            None => {
                named = true;
                Some(whole.clone())
            }
        });
    }
    if let Some(last) = each.last_mut().filter(|_| !named) {
        *last = Some(match whole {
            Ended::Crash(why) => Ended::Crash(format!("after the last case: {why}")),
            other => other.clone(),
        });
    }
    each
}

/// `CODE` or `CODE text`.
fn from_status(text: &str) -> Ended {
    let text = text.trim();
    let (code, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    match code.parse::<i32>() {
        Ok(0) => Ended::Done,
        Ok(UNSUPPORTED) => Ended::Unsupported,
        Ok(code) if rest.is_empty() => Ended::Crash(format!("status {code}")),
        Ok(code) => Ended::Crash(format!("status {code}: {}", rest.trim())),
        Err(_) => Ended::Crash(format!("its file '{STATUS}' says {text:?}, no exit code")),
    }
}

/// Starts a command and waits, at most for `timeout`; what it prints goes to `log`.
fn wait_for(filled: Vec<String>, input: Stdio, log: &Path, timeout: Duration) -> io::Result<Ended> {
    let mut filled = filled.into_iter();
    let file = File::create(log)?;
    let mut child = Command::new(filled.next().unwrap_or_default())
        .args(filled)
        .stdin(input)
        .stdout(file.try_clone()?)
        .stderr(file)
        .spawn()?;
    let begun = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if begun.elapsed() > timeout {
            // It may have ended in between; then there is nothing to kill.
            let _ = child.kill();
            child.wait()?;
            let tail = tail(log);
            return Ok(Ended::Timeout(format!(
                "still running after {} s{tail}",
                timeout.as_secs_f64()
            )));
        }
        thread::sleep(POLL);
    };
    Ok(ended(status, log))
}

fn ended(status: ExitStatus, log: &Path) -> Ended {
    match status.code() {
        Some(0) => Ended::Done,
        Some(UNSUPPORTED) => Ended::Unsupported,
        _ => Ended::Crash(format!("{status}{}", tail(log))),
    }
}

/// `: ...`, the end of what it printed, on one line.
fn tail(log: &Path) -> String {
    let bytes = std::fs::read(log).unwrap_or_default();
    let tail = &bytes[bytes.len().saturating_sub(TAIL_BYTES)..];
    let text = String::from_utf8_lossy(tail);
    let lines: Vec<&str> = text
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty())
        .collect();
    match lines.as_slice() {
        [] => String::new(),
        lines => format!(": {}", lines.join(" | ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotes_hold_words_together() {
        let words = |line| split(line).unwrap();
        assert_eq!(
            words("python3  a.py {case}"),
            ["python3", "a.py", "{case}"],
            "blanks"
        );
        assert_eq!(
            words("'my port' \"-x y\" ''"),
            ["my port", "-x y", ""],
            "quotes"
        );
        assert_eq!(words("a'b c'd"), ["ab cd"], "inside a word");
        assert!(split("  ").is_err() && split("a 'b").is_err(), "mistakes");
    }

    /// Five cases: with a status 0, without and complete, without and not, and two behind; by how the port ended.
    #[test]
    fn how_each_case_of_a_run_ended() {
        let folder = tempfile::tempdir().unwrap();
        let outs: Vec<PathBuf> = (0..5).map(|i| folder.path().join(i.to_string())).collect();
        outs.iter()
            .for_each(|out| std::fs::create_dir(out).unwrap());
        let job = |out| Job {
            stage: "sh",
            case: folder.path(),
            out,
        };
        let jobs: Vec<Job<'_>> = outs.iter().map(|out| job(out.as_path())).collect();
        std::fs::write(outs[0].join(STATUS), "0\n").unwrap();
        let crash = Ended::Crash("signal 9".to_owned());
        let each = |whole: &Ended| ended_each(&jobs, whole, |i| i < 2);
        let (done, skipped) = (Some(Ended::Done), Some(Ended::Unsupported));
        let expected = [done.clone(), done.clone(), Some(crash.clone()), None, None];
        assert_eq!(each(&crash), expected, "the third is named");
        assert_eq!(each(&Ended::Done), vec![done.clone(); 5], "files count");
        let expected = [&[done.clone()][..], &vec![skipped.clone(); 4]].concat();
        assert_eq!(each(&Ended::Unsupported), expected, "all but the first");
        for (i, text) in ["77", "3 no memory\n", "what"].iter().enumerate() {
            std::fs::write(outs[i + 2].join(STATUS), text).unwrap();
        }
        let crashed = |why: &str| Some(Ended::Crash(why.to_owned()));
        let mut expected = [
            done.clone(),
            done,
            skipped,
            crashed("status 3: no memory"),
            crashed("its file 'status' says \"what\", no exit code"),
        ];
        assert_eq!(each(&Ended::Done), expected, "as stated");
        expected[4] = crashed("after the last case: signal 9");
        assert_eq!(each(&crash), expected, "nothing is left to name");
    }
}
