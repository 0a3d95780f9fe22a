//! [`run`]: a port as a program that is started once per case.

use std::fs::File;
use std::io;
use std::path::Path;
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
    let mut filled = filled.collect::<Vec<_>>().into_iter();
    let log = job.out.join(LOG);
    let file = File::create(&log)?;
    let mut child = Command::new(filled.next().unwrap_or_default())
        .args(filled)
        .stdin(Stdio::null())
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
            let tail = tail(&log);
            return Ok(Ended::Timeout(format!(
                "still running after {} s{tail}",
                timeout.as_secs_f64()
            )));
        }
        thread::sleep(POLL);
    };
    Ok(ended(status, &log))
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
}
