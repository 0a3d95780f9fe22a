//! The documents against the code: every file, function, test, golden case, link and image named in them exists, and the
//! examples run.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::process::Command;

use garad_core::pyramid::halve;
use garad_core::{
    Camera, GaussianMap, GrayImage, KeyframeId, Label, NewGaussian, Par, Real, Se3, So3,
};
use garad_crf::unary::log_odds;
use garad_crf::{Crf, CrfConfig, Cues, Node};
use garad_features::fast9::{CIRCLE, corners};
use garad_golden::stages::STAGES;
use garad_optim::RobustKernel;
use garad_raster::losses::opacity_penalty;
use garad_raster::{RenderOptions, render};
use nalgebra::{Vector2, Vector3};

const MAX_IMAGES_BYTES: u64 = 3 * 1024 * 1024;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn source() -> PathBuf {
    root().join("docs/book/src")
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// File name and text of each page.
fn pages() -> Vec<(String, String)> {
    let mut pages: Vec<(String, String)> = fs::read_dir(source())
        .expect("the book's folder")
        .map(|entry| entry.expect("readable").path())
        .filter(|path| path.extension().is_some_and(|e| e == "md"))
        .map(|path| {
            let name = path.file_name().expect("a name").to_string_lossy();
            (name.into_owned(), read(&path))
        })
        .collect();
    pages.sort();
    pages
}

/// The pages without the preface.
fn chapters() -> Vec<(String, String)> {
    let mut pages = pages();
    pages.retain(|(name, _)| name != "README.md");
    assert!(pages.len() >= 16, "only {} chapters", pages.len());
    pages
}

/// Every file below a folder with one of these endings; build outputs and hidden folders are left out.
fn files_below(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("readable").path();
        let name = path.file_name().expect("a name").to_string_lossy();
        let is_wanted = |ending: &&str| path.extension().is_some_and(|e| e == *ending);
        if path.is_dir() && !name.starts_with('.') && !["target", "out"].contains(&&*name) {
            found.extend(files_below(&path, endings));
        } else if path.is_file() && endings.iter().any(is_wanted) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Path below the root and text of every Markdown file.
fn documents() -> Vec<(String, String)> {
    let files = files_below(root(), &["md"]);
    let named = files.into_iter().map(|path| {
        let name = path.strip_prefix(root()).expect("below the root");
        (name.to_string_lossy().into_owned(), read(&path))
    });
    let documents: Vec<_> = named.collect();
    assert!(documents.len() >= 40, "only {} documents", documents.len());
    documents
}

/// All Rust code, in one string.
fn rust_code() -> String {
    let folders = ["crates", "src", "tests", "benches", "examples"];
    let files = folders.map(|folder| files_below(&root().join(folder), &["rs"]));
    files.concat().iter().map(|path| read(path)).collect()
}

fn has_function(code: &str, name: &str) -> bool {
    ["(", "<"]
        .iter()
        .any(|end| code.contains(&format!("fn {name}{end}")))
}

/// What is between backticks, blocks of code left out.
fn quoted(text: &str) -> Vec<&str> {
    let prose = text.split("```").step_by(2);
    prose
        .flat_map(|part| part.split('`').skip(1).step_by(2))
        .collect()
}

/// Link targets, those of images included.
fn links(text: &str) -> Vec<&str> {
    let prose = text.split("```").step_by(2);
    prose
        .flat_map(|part| part.split("](").skip(1))
        .filter_map(|rest| rest.split(')').next())
        .collect()
}

/// The part of a chapter under a heading.
fn section<'t>(text: &'t str, heading: &str) -> Option<&'t str> {
    let start = text.find(&format!("\n## {heading}\n"))?;
    let body = &text[start + 4 + heading.len()..];
    Some(body.find("\n## ").map_or(body, |end| &body[..end]))
}

/// `a/../b` as `b`.
fn tidy(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => {
                out.pop();
            }
            part => out.push(part),
        }
    }
    out
}

fn is_file_of_code(name: &str) -> bool {
    let kinds = [".rs", ".py", ".md", ".toml"];
    name.contains('/') && kinds.iter().any(|kind| name.ends_with(kind)) && !name.contains("//")
}

fn none(problems: &[String]) {
    assert!(problems.is_empty(), "\n{}", problems.join("\n"));
}

/// In the history of changes old names are right; two documents leave out `crates/slam/src`.
#[test]
fn files_that_are_named_exist() {
    let mut problems = Vec::new();
    for (page, text) in documents() {
        if page == "CHANGELOG.md" {
            continue;
        }
        let folder = match page.as_str() {
            "docs/paper_map.md" | "ARCHITECTURE.md" => root().join("crates/slam/src"),
            _ => root().join(&page).parent().expect("a folder").to_owned(),
        };
        let is_named = |name: &&str| is_file_of_code(name) && !name.contains(['{', '*', ' ', '$']);
        for name in quoted(&text).into_iter().filter(is_named) {
            if !root().join(name).is_file() && !folder.join(name).is_file() {
                problems.push(format!("{page}: no file {name}"));
            }
        }
    }
    none(&problems);
}

/// The cells of each row of the tables under a heading, the rows of titles left out.
fn table(text: &str, heading: &str) -> Vec<Vec<String>> {
    let body = section(text, heading).unwrap_or_else(|| panic!("no section {heading:?}"));
    let rows = body.lines().filter(|line| line.starts_with("| "));
    let cells = rows.map(|row| row.split('|').map(|cell| cell.trim().to_owned()).collect());
    let all: Vec<Vec<String>> = cells.collect();
    assert!(all.len() > 10, "{heading}: only {} rows", all.len());
    all[1..].to_vec()
}

/// A path of the map from the paper.
fn path_of_map(name: &str) -> PathBuf {
    let below = [root().join(name), root().join("crates/slam/src").join(name)];
    let found = below.iter().find(|path| path.exists());
    found
        .cloned()
        .unwrap_or_else(|| panic!("paper_map.md: no {name}"))
}

/// The documentation of a function: the lines of comment right above it.
fn documentation(code: &str, name: &str) -> Option<String> {
    let lines: Vec<&str> = code.lines().collect();
    let at = lines.iter().position(|line| has_function(line, name))?;
    let above = lines[..at].iter().rev().map(|line| line.trim_start());
    let block = above.take_while(|line| line.starts_with("///") || line.starts_with("#["));
    Some(block.collect::<Vec<_>>().join("\n"))
}

/// Each equation has a row; its functions are in the files named before them, and their documentation says `Eq. N`.
#[test]
fn equations_have_functions_that_say_so() {
    let mut problems = Vec::new();
    let mut equations = BTreeSet::new();
    for row in table(&read(&root().join("docs/paper_map.md")), "Equations") {
        let (number, functions) = (&row[1], &row[4]);
        if number.is_empty() || !number.chars().all(|c| c.is_ascii_digit()) {
            continue;
        }
        let (mut code, mut named) = (String::new(), false);
        for name in quoted(functions) {
            if is_file_of_code(name) {
                code = read(&path_of_map(name));
                continue;
            }
            let Some(says) = documentation(&code, name) else {
                problems.push(format!("eq. {number}: no function {name}"));
                continue;
            };
            let numbers = says.to_lowercase();
            let mut after = numbers.split("eq. ").skip(1);
            named |= after.any(|rest| {
                let digits = rest.find(|c: char| !c.is_ascii_digit());
                rest[..digits.unwrap_or(rest.len())] == **number
            });
        }
        if !named {
            problems.push(format!("eq. {number}: no function says Eq. {number}"));
        }
        equations.insert(number.clone());
    }
    none(&problems);
    let expected = [1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 15, 16].map(|n: u32| n.to_string());
    assert_eq!(equations, expected.into(), "one row per equation");
}

/// Every path, test and golden stage of the map from the paper.
#[test]
fn the_map_from_the_paper_names_what_exists() {
    let (map, code) = (read(&root().join("docs/paper_map.md")), rust_code());
    let mut problems = Vec::new();
    let rows = |heading, columns: [usize; 3]| {
        let rows = table(&map, heading).into_iter();
        rows.map(move |row| columns.map(|column| row[column].clone()))
    };
    for [paths, tests, stages] in rows("Equations", [5, 6, 7]).chain(rows("Sections", [3, 4, 5])) {
        let is_path = |name: &&str| is_file_of_code(name) || name.contains('/');
        for name in quoted(&paths).into_iter().filter(is_path) {
            path_of_map(name);
        }
        for name in quoted(&tests) {
            if !code.contains(&format!("fn {name}(")) {
                problems.push(format!("no test {name}"));
            }
        }
        for name in quoted(&stages) {
            if !STAGES.iter().any(|stage| stage.name == name) {
                problems.push(format!("no golden stage {name}"));
            }
        }
    }
    none(&problems);
}

/// Each function that the sentences of the paper are given is in the file named before it.
#[test]
fn sentences_of_the_paper_have_functions() {
    let map = read(&root().join("docs/paper_map.md"));
    let (mut problems, mut named) = (Vec::new(), 0);
    for row in table(&map, "Sentence by sentence") {
        for cell in &row[2..4] {
            let mut code = String::new();
            for name in quoted(cell) {
                if name.ends_with(".rs") {
                    code = read(&path_of_map(name));
                } else if !name.contains('.') {
                    named += 1;
                    if !has_function(&code, name) {
                        problems.push(format!("{}: no function {name}", row[1]));
                    }
                }
            }
        }
    }
    none(&problems);
    assert!(named > 40, "only {named} functions");
}

/// A derivation names the function or the module that computes it, behind a dash in its title.
#[test]
fn derivations_name_functions() {
    let (code, mut problems, mut names) = (rust_code(), Vec::new(), 0);
    let files = files_below(&root().join("crates"), &["rs"]);
    for page in ["docs/math.md", "docs/math_crf.md"] {
        let text = read(&root().join(page));
        for title in text.lines().filter(|line| line.starts_with("### ")) {
            let (_, named) = title.split_once(" — ").unwrap_or((title, ""));
            for name in quoted(named) {
                names += 1;
                let last = name.rsplit("::").next().expect("a name");
                let is_module = |path: &PathBuf| path.file_stem().is_some_and(|stem| stem == last);
                let is_module_folder = |path: &PathBuf| path.ends_with(format!("{last}/mod.rs"));
                let is_type = code.contains(&format!("struct {last}"));
                let module = files
                    .iter()
                    .any(|path| is_module(path) || is_module_folder(path));
                if !(module || is_type || has_function(&code, last)) {
                    problems.push(format!("{page}: {title:?} names no code"));
                }
            }
        }
    }
    none(&problems);
    assert!(names > 40, "only {names} names");
}

/// A line under "Pinned by" names a file and tests in it (several, parted by semicolons), or golden
/// cases.
#[test]
fn tests_and_golden_cases_that_are_named_exist() {
    let (mut problems, mut tests, mut cases) = (Vec::new(), 0, BTreeSet::new());
    for (page, text) in chapters() {
        let Some(pinned) = section(&text, "Pinned by") else {
            problems.push(format!("{page}: no section \"Pinned by\""));
            continue;
        };
        for part in pinned.split("\n- ").flat_map(|item| item.split(';')) {
            let mut file = None;
            for name in quoted(part) {
                if is_file_of_code(name) {
                    file = Some((name, read(&root().join(name))));
                } else if let Some((path, code)) = &file {
                    tests += 1;
                    if !code.contains(&format!("fn {name}(")) {
                        problems.push(format!("{page}: no test {name} in {path}"));
                    }
                } else if name.contains('/') {
                    let case = root().join("tests/golden").join(name);
                    if !["case.json", "trace.json"]
                        .iter()
                        .any(|f| case.join(f).is_file())
                    {
                        problems.push(format!("{page}: no golden case {name}"));
                    }
                    cases.extend(name.split('/').next().map(str::to_owned));
                }
            }
        }
    }
    none(&problems);
    assert!(tests > 80, "only {tests} tests are named");
    let unnamed: Vec<&str> = (STAGES.iter().map(|stage| stage.name))
        .filter(|name| !cases.contains(*name))
        .collect();
    assert!(unnamed.is_empty(), "stages in no chapter: {unnamed:?}");
}

#[test]
fn links_have_targets() {
    let mut problems = Vec::new();
    for (page, text) in documents() {
        for link in links(&text) {
            let local = link.split('#').next().unwrap_or_default();
            if link.starts_with("https://") || local.is_empty() {
                continue;
            }
            let folder = root().join(&page).parent().expect("a folder").to_owned();
            let target = tidy(&folder.join(local));
            if !target.starts_with(root()) || !target.exists() {
                problems.push(format!("{page}: {link} has no target"));
            }
        }
    }
    none(&problems);
}

/// Every document below docs, once, under its own title.

#[test]
fn the_summary_lists_every_document_once() {
    let summary = read(&root().join("docs/SUMMARY.md"));
    let listed = links(&summary);
    let mut problems = Vec::new();
    for (page, text) in documents() {
        let Some(path) = page.strip_prefix("docs/").filter(|p| *p != "SUMMARY.md") else {
            continue;
        };
        let times = listed.iter().filter(|link| **link == path).count();
        if times != 1 {
            problems.push(format!("{page}: {times} times in the summary"));
        }
        let title = text.lines().next().unwrap_or_default();
        if !title.starts_with("# ") {
            problems.push(format!("{page}: starts without a title"));
        } else if times == 1 && !summary.contains(&format!("[{}]", &title[2..])) {
            problems.push(format!("{page}: the summary has another title"));
        }
    }
    none(&problems);
}

#[test]
fn chapters_have_their_parts() {
    let mut problems = Vec::new();
    for (page, text) in chapters() {
        let mut parts = vec!["By hand", "Read", "Pinned by"];
        if page != "porting.md" {
            parts.push("On a GPU");
        }
        for part in parts {
            if section(&text, part).is_none_or(|body| body.len() < 100) {
                problems.push(format!("{page}: no section \"{part}\""));
            }
        }
    }
    none(&problems);
}

#[test]
fn images_exist_are_small_and_used() {
    let all: String = pages().into_iter().map(|(_, text)| text).collect();
    let mut bytes = 0;
    for entry in fs::read_dir(source().join("images")).expect("images") {
        let path = entry.expect("readable").path();
        let name = path.file_name().expect("a name").to_string_lossy();
        assert!(all.contains(&format!("](images/{name})")), "{name}: unused");
        let file = fs::read(&path).expect("readable");
        assert!(image::load_from_memory(&file).is_ok(), "{name}: no image");
        bytes += file.len() as u64;
    }
    assert!(bytes > 0, "no image at all");
    assert!(bytes <= MAX_IMAGES_BYTES, "{bytes} bytes of images");
}

fn near(got: f64, expected: f64, what: &str) {
    // As many digits as the book prints.
    let tolerance = 6e-4 * expected.abs().max(1.0);
    assert!(
        (got - expected).abs() < tolerance,
        "{what}: {got}, the book says {expected}"
    );
}

/// The examples by hand of the first half of the book that are no test elsewhere.
#[test]
fn examples_by_hand_of_images_and_poses() {
    let camera = Camera::pinhole((640, 480), [525.0, 525.0, 319.5, 239.5]).expect("a camera");
    let p = Vector3::new(0.2, -0.1, 2.0);
    for (level, expected) in [(0, [372.0, 213.25]), (1, [186.0, 106.625])] {
        let uv = camera.level(level).project(&p).expect("in front");
        near(uv.x, expected[0], "u");
        near(uv.y, expected[1], "v");
    }
    let turned = So3::exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2)) * Vector3::x();
    assert!(
        (turned - Vector3::y()).norm() < 1e-15,
        "x goes to y: {turned}"
    );

    let mut image = GrayImage::new(16, 16, 0);
    image[(4, 4)] = 255;
    let half = halve(&image);
    assert_eq!((half[(2, 2)], half[(1, 2)]), (36, 6), "one white pixel");

    let mut corner = GrayImage::new(7, 7, 100);
    let pixel = |k: usize| {
        let (x, y) = CIRCLE[k];
        ((x + 3).unsigned_abs(), (y + 3).unsigned_abs())
    };
    for k in 0..9 {
        corner[pixel(k)] = 130;
    }
    let scores = |image: &GrayImage, t| corners(image, t, true).iter().map(|c| c.score).collect();
    let found: Vec<u8> = scores(&corner, 20);
    assert_eq!(found, [29], "nine brighter by 30");
    corner[pixel(4)] = 115;
    let (none, weak): (Vec<u8>, Vec<u8>) = (scores(&corner, 20), scores(&corner, 7));
    assert_eq!((none, weak), (vec![], vec![14]), "one of them by 15");

    let huber = RobustKernel::Huber {
        delta: 5.991f64.sqrt(),
    };
    near(huber.rho(6.25), 6.247, "Huber's cost");
    near(huber.weight(6.25), 0.979, "Huber's weight");
    let by_point = camera.project_jacobian(&p);
    let row = Vector3::new(by_point.m11, by_point.m12, by_point.m13);
    let turn = p.cross(&row);
    for (k, expected) in [262.5, 0.0, -26.25, 2.625, 530.25, 26.25]
        .into_iter()
        .enumerate()
    {
        near(
            if k < 3 { row[k] } else { turn[k - 3] },
            expected,
            "row of u",
        );
    }
}

/// The same for the paper's loop: three Gaussians of one person, the depth of the second unknown.
#[test]
fn examples_by_hand_of_the_papers_loop() {
    let cues = |depth_residual| Cues {
        reproj_px: Some(0.0),
        depth_residual,
        observations: Some(1),
        epipolar_px: None,
    };
    let mut config = CrfConfig::default();
    config.unary.min_observations = 1;
    near(log_odds(&cues(Some(5.0)), &config.unary), 0.263, "weight 1");
    config.unary.depth.weight = 8.0;
    near(log_odds(&cues(Some(5.0)), &config.unary), 1.437, "weight 8");
    near(log_odds(&cues(None), &config.unary), -1.259, "no depth");
    let nodes: Vec<Node> = [Some(5.0), None, Some(5.0)]
        .into_iter()
        .enumerate()
        .map(|(i, residual)| Node {
            p_world: Vector3::new(0.1 * i as f64, 0.0, 2.0),
            uv_px: Some(Vector2::new(15.0 * i as f64, 0.0)),
            cues: cues(residual),
            previous: None,
        })
        .collect();
    for (iterations, expected) in [
        (1, [0.903, 0.363]),
        (2, [0.958, 0.584]),
        (5, [0.994, 0.912]),
    ] {
        config.mean_field.iterations = iterations;
        let crf = Crf::new(config.clone()).expect("valid");
        let beliefs = crf.infer(&nodes, Par::Seq).expect("finite");
        near(beliefs.dynamic[0], expected[0], "first");
        near(beliefs.dynamic[1], expected[1], "second");
        near(beliefs.dynamic[2], expected[0], "third");
    }
}

/// The same for splats, losses and sums.
#[test]
fn examples_by_hand_of_splats_and_losses() {
    let mut map = GaussianMap::<f64>::new(0);
    map.push(&NewGaussian {
        mean: [0.05, -0.03, 1.5],
        sigma_m: 0.1,
        opacity: 0.77,
        color: [0.5 + 0.282_094_79 * 0.7, 0.4, 0.5],
        landmark: None,
        born: KeyframeId(0),
    });
    map.quaternions[0] = [0.9, 0.2, -0.3, 0.25];
    map.log_scales[0] = [0.22, 0.09, 0.05].map(Real::ln);
    let options = RenderOptions::default();
    let draw = |map: &GaussianMap<f64>, size, k: [f64; 4]| {
        let camera = Camera::pinhole(size, k).expect("a camera");
        let drawn = render(map, &camera, &Se3::identity(), &options, Par::Seq);
        drawn.expect("an image").projected[0]
    };
    let splat = draw(&map, (24, 18), [25.0, 27.0, 11.5, 8.5]);
    near(splat.mean_px[0], 12.333, "u");
    near(splat.mean_px[1], 7.96, "v");
    near(splat.color[0], 0.697, "red");
    near(splat.opacity, 0.77, "opacity");
    let f = splat.footprint;
    assert_eq!(
        (splat.radius_px, f.x0, f.x1, f.y0, f.y1),
        (9, 0, 24, 0, 16),
        "footprint"
    );

    map.means[0] = [0.0, 0.0, 2.0];
    map.log_scales[0] = [0.1f64; 3].map(Real::ln);
    let round = draw(&map, (64, 48), [100.0, 100.0, 31.5, 23.5]);
    near(1.0 / round.inv_var_y, 25.3, "variance of a round splat");
    assert_eq!(round.radius_px, 16, "its radius");

    let penalty = opacity_penalty(&[3.0f64], &[Label::Dynamic], None).expect("one label each");
    near(
        penalty.opacity_logits[0],
        0.086,
        "gradient of an opaque one",
    );
    let [large, one] = [1e8f32, 1.0];
    let sums = [(large + one) - large, (large - large) + one];
    assert!(
        sums[0] < 0.5 && sums[1] > 0.5,
        "the order matters: {sums:?}"
    );
}

/// Runs an example of this package, built as the tests are; what it printed.
fn run_example(name: &str, args: &[&str]) -> String {
    let mut cargo = Command::new(env!("CARGO"));
    cargo
        .current_dir(root())
        .args(["run", "--quiet", "--offline"]);
    if !cfg!(debug_assertions) {
        cargo.arg("--release");
    }
    cargo.args(["--example", name, "--"]).args(args);
    let output = cargo.output().expect("cargo starts");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{name}: {error}");
    String::from_utf8(output.stdout).expect("text")
}

/// The last number of the line that holds `words`.
fn number_after(text: &str, words: &str) -> f64 {
    let line = text.lines().find(|line| line.contains(words));
    let line = line.unwrap_or_else(|| panic!("no line with {words:?}:\n{text}"));
    let rest = line.split(words).nth(1).unwrap_or_default();
    let word = rest.split_whitespace().next().unwrap_or_default();
    let number = word.trim_end_matches([',', ':']).parse();
    number.unwrap_or_else(|_| panic!("no number after {words:?}:\n{text}"))
}

/// The numbers in a text. A superscript is a number of its own, ½ is 0.5.
fn numbers(text: &str) -> Vec<f64> {
    let mut plain = String::new();
    let mut raised = false;
    for c in text.replace('½', " 0.5 ").chars() {
        let digit = "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().position(|s| s == c);
        if raised != digit.is_some() {
            plain.push(' ');
        }
        raised = digit.is_some();
        match digit {
            Some(d) => plain.push_str(&d.to_string()),
            None => plain.push(c),
        }
    }
    let word = |c: char| !(c.is_alphanumeric() || ".-_".contains(c));
    let mut found = Vec::new();
    for word in plain.split(word) {
        // A minus belongs to an exponent or to nothing.
        let whole = word.trim_matches(['-', '.']).parse::<f64>();
        match whole {
            Ok(number) => found.push(number.abs()),
            Err(_) => {
                let parts = word.split('-');
                found.extend(parts.filter_map(|part| part.trim_matches('.').parse::<f64>().ok()));
            }
        }
    }
    found
}

#[test]
fn numbers_are_found() {
    let text = "T < 1e-4, 0.01² px, 2⁻²⁰, ½ of x_3, 16-bit, (2y2) k = -5..5.";
    let expected = [1e-4, 0.01, 2.0, 2.0, 20.0, 0.5, 16.0];
    let found = numbers(text);
    assert!(
        expected.iter().all(|e| found.contains(e)) && !found.contains(&3.0),
        "{found:?}"
    );
}

/// Python without its strings of several lines and its comments.
fn code_of(python: &str) -> String {
    let outside = python.split("\"\"\"").step_by(2);
    let lines = outside.flat_map(str::lines);
    let code = lines.filter_map(|line| line.split('#').next());
    code.collect::<Vec<_>>().join("\n")
}

/// The port in numpy is written from the book alone: each of its thresholds, factors and taps is in the chapters
/// of its file. Numbers below 10 without a fraction are indices as often as not.
#[test]
fn the_book_states_every_number_of_the_example_port() {
    let mut problems = Vec::new();
    for (file, named) in [
        ("harmonics", ["splatting", "backward"]),
        ("splats", ["splatting", "backward"]),
        ("render", ["splatting", "backward"]),
        ("losses", ["losses", "losses"]),
        ("adam", ["training", "training"]),
        ("train", ["training", "losses"]),
        ("flow", ["lucas_kanade", "features"]),
    ] {
        let stated: Vec<f64> = named
            .iter()
            .flat_map(|chapter| numbers(&read(&source().join(format!("{chapter}.md")))))
            .collect();
        let path = root().join(format!("examples/adapter_numpy/{file}.py"));
        let used = numbers(&code_of(&read(&path)));
        assert!(used.len() > 3, "{file}: {used:?}");
        for number in used {
            let small = number < 10.0 && number.fract().abs() < f64::EPSILON;
            if !small && !stated.iter().any(|s| s.total_cmp(&number).is_eq()) {
                problems.push(format!("{file}.py has {number}, its chapters do not"));
            }
        }
    }
    none(&problems);
}

#[test]
fn the_examples_run_and_print_what_they_should() {
    let text = run_example("track_two_frames", &[]);
    assert!(
        number_after(&text, "with depth,") > 150.0,
        "inliers:\n{text}"
    );
    assert!(
        number_after(&text, "the pose is off by") < 10.0,
        "mm:\n{text}"
    );

    let text = run_example("solve_pnp", &[]);
    assert!(number_after(&text, "matches that agree:") > 50.0, "{text}");
    assert!(number_after(&text, "pose is off by") < 5.0, "mm:\n{text}");

    let text = run_example("run_crf", &[]);
    let alone = number_after(&text, "alone,");
    let together = number_after(&text, "after asking the neighbours,");
    assert!(together < 0.4 * alone, "the field helps:\n{text}");

    let text = run_example("check_gradient", &[]);
    for name in [
        "means",
        "log-scales",
        "quaternions",
        "opacities",
        "harmonics",
        "pose",
    ] {
        let row = text.lines().find(|line| line.starts_with(name));
        let worst = row.and_then(|row| row.split_whitespace().last()?.parse::<f64>().ok());
        assert!(worst.is_some_and(|worst| worst < 1e-6), "{name}:\n{text}");
    }

    let text = run_example("render_ply", &[]);
    assert!(text.contains("120 of them visible"), "{text}");
    assert!(
        text.lines().any(|line| line.contains('@')),
        "an image:\n{text}"
    );
}

/// The committed images are those of today's code, byte for byte (ten seconds in release).
#[test]
#[ignore = "ten seconds in a release build, minutes in a debug build"]
fn images_are_those_of_the_code() {
    let folder = tempfile::tempdir().expect("a folder");
    run_example("book_pictures", &[folder.path().to_str().expect("UTF-8")]);
    for entry in fs::read_dir(source().join("images")).expect("images") {
        let name = entry.expect("readable").file_name();
        let fresh = fs::read(folder.path().join(&name)).expect("drawn");
        let committed = fs::read(source().join("images").join(&name)).expect("readable");
        assert!(fresh == committed, "{}: draw it again", name.display());
    }
}
