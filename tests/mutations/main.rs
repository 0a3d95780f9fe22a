//! The kept list of slips has not rotted: each text is still there, once, to be replaced.
//!
//! Whether the tests notice the slips takes `tests/mutations/run.py` half an hour; `results.csv` has its answer.

use std::fs;
use std::path::Path;

use serde::Deserialize;

/// One slip of `slips.toml`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Slip {
    #[serde(rename = "crate")]
    folder: String,
    file: String,
    what: String,
    find: String,
    replace: String,
}

#[derive(Debug, Deserialize)]
struct Slips {
    slip: Vec<Slip>,
}

#[test]
fn every_slip_can_still_be_made() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let list = fs::read_to_string(root.join("tests/mutations/slips.toml")).expect("the list");
    let Slips { slip: slips } = toml::from_str(&list).expect("the list's form");
    assert!(slips.len() >= 40, "only {} slips", slips.len());
    let mut wrong = Vec::new();
    for (i, slip) in slips.iter().enumerate() {
        let text = fs::read_to_string(root.join(&slip.file)).unwrap_or_default();
        let count = text.matches(&slip.find).count();
        let inside = slip
            .file
            .starts_with(&format!("crates/{}/src/", slip.folder));
        let twice = slips[..i]
            .iter()
            .any(|s| s.file == slip.file && s.find == slip.find && s.replace == slip.replace);
        if count != 1 || slip.find == slip.replace || !inside || twice {
            wrong.push(format!(
                "{}: `{}` found {count} times ({})",
                slip.file, slip.find, slip.what
            ));
        }
    }
    assert!(
        wrong.is_empty(),
        "code has changed under these slips; mend tests/mutations/slips.toml:\n{}",
        wrong.join("\n")
    );
}
