//! What every committed case must keep to, whatever its stage.

use std::fs;
use std::path::{Path, PathBuf};

use garad_golden::{Case, Dtype, Tensor, npy, tol};

const MAX_FILE_BYTES: u64 = 256 * 1024;

fn subfolders(path: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = fs::read_dir(path)
        .expect("the folder is there")
        .map(|entry| entry.expect("readable").path())
        .filter(|path| path.is_dir() && !path.ends_with("gen") && !path.ends_with("trace"))
        .collect();
    found.sort();
    found
}

#[test]
fn committed_cases_are_sound() {
    let mut problems = Vec::new();
    let mut cases = 0;
    for folder in subfolders(&Case::root()).iter().flat_map(|s| subfolders(s)) {
        let manifest = folder.join("case.json");
        let case = match Case::load(&folder) {
            Ok(case) => case,
            Err(error) => {
                problems.push(error.to_string());
                continue;
            }
        };
        cases += 1;
        if !folder.ends_with(case.name()) {
            problems.push(format!("{}: says it is {}", folder.display(), case.name()));
        }
        if case.why().len() < 10 || case.basis().is_empty() {
            problems.push(format!("{}: 'why' or 'basis' is missing", case.name()));
        }
        // An expected value compared with itself passes, if its tolerance is in the table.
        for (output, expected) in case.outputs() {
            if let Err(error) = case.check(output, &expected.f64()) {
                problems.push(error);
            }
        }
        let text = fs::read_to_string(&manifest).expect("read before");
        for entry in fs::read_dir(&folder).expect("listed before") {
            let path = entry.expect("readable").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let bytes = fs::metadata(&path).expect("readable").len();
            if bytes > MAX_FILE_BYTES {
                problems.push(format!("{}: {bytes} bytes", path.display()));
            }
            if name != "case.json" && !text.contains(&format!("\"{name}\"")) {
                problems.push(format!("{}: no tensor uses it", path.display()));
            }
            if name.ends_with(".npy") {
                let file = fs::read(&path).expect("readable");
                let tensor = npy::decode(&file).expect("loaded before");
                if npy::encode(&tensor) != file {
                    problems.push(format!("{}: not as numpy writes it", path.display()));
                }
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
    assert!(
        cases > 0 && tol::find("exact").is_some(),
        "nothing was looked at"
    );
}

/// Header lengths numpy 2.4 chose, as (shape, offset of the first element).
#[test]
fn header_lengths_are_numpys() {
    let numpy = [
        (vec![0], 128),
        (vec![0, 1], 128),
        (vec![0, 111, 2, 3], 128),
        (vec![0, 1111, 2222, 3333], 128),
        (vec![0, 1111, 2222, 3333, 4], 128),
        (vec![0, 1111, 2222, 3333, 44, 5], 128),
        (vec![0, 1, 2, 3, 4, 5, 6, 7, 8, 9], 128),
        (vec![0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 1, 2, 3], 128),
    ];
    for (shape, offset) in numpy {
        let tensor = Tensor::from_bytes(Dtype::F64, shape.clone(), Vec::new()).expect("empty");
        assert_eq!(npy::encode(&tensor).len(), offset, "{shape:?}");
    }
}
