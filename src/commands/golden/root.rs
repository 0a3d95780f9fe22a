//! Where the cases are. No path of the machine this program was built on is in it.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use garad_golden::Case;

/// Names the folder of the cases, for programs that are started elsewhere.
const VARIABLE: &str = "GARAD_GOLDEN";

/// The folder with STAGE/CASE/case.json: the one asked for, the one of the variable, `tests/golden` here or above.
pub(super) fn root(asked: Option<&Path>) -> Result<PathBuf> {
    find(asked, std::env::var_os(VARIABLE), &std::env::current_dir()?)
}

fn find(asked: Option<&Path>, variable: Option<OsString>, here: &Path) -> Result<PathBuf> {
    if let Some(asked) = asked {
        return Ok(asked.to_owned());
    }
    if let Some(named) = variable.filter(|v| !v.is_empty()).map(PathBuf::from) {
        if !named.is_dir() {
            bail!("{VARIABLE}={}: no such folder", named.display());
        }
        return Ok(named);
    }
    let Some(found) = Case::root_above(here) else {
        bail!(
            "no golden cases: name their folder with --cases DIR or with the variable {VARIABLE}, or start in a checkout \
             (tests/golden is neither in {} nor above it)",
            here.display()
        );
    };
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_to_the_command_counts() {
        let temporary = tempfile::tempdir().expect("a folder");
        let [checkout, elsewhere] = ["checkout", "elsewhere"].map(|n| temporary.path().join(n));
        let golden = checkout.join("tests/golden");
        let deep = golden.join("sh/one");
        let other = checkout.join("python/tests/golden");
        for folder in [&deep, &elsewhere, &other] {
            std::fs::create_dir_all(folder).expect("made");
        }
        std::fs::write(golden.join("tolerances.json"), "{}").expect("written");
        let set = Some(elsewhere.clone().into_os_string());
        let nowhere = || Some(OsString::from("/nowhere"));
        let asked = Some(Path::new("asked"));
        for (asked, variable, here, found) in [
            (asked, set.clone(), &checkout, Path::new("asked")),
            (None, set.clone(), &checkout, &elsewhere),
            (None, Some(OsString::new()), &checkout, &golden),
            (None, None, &checkout, &golden),
            (None, None, &deep, &golden),
            (None, None, &checkout.join("python"), &golden),
        ] {
            let what = format!("{asked:?} {variable:?} {here:?}");
            assert_eq!(find(asked, variable, here).expect(&what), found, "{what}");
        }
        for (variable, words) in [
            (nowhere(), &["GARAD_GOLDEN=/nowhere"][..]),
            (None, &["--cases", "GARAD_GOLDEN", "tests/golden"]),
        ] {
            let error = find(None, variable, &elsewhere).expect_err("nothing there");
            let said = error.to_string();
            assert!(words.iter().all(|word| said.contains(word)), "{said}");
        }
    }
}
