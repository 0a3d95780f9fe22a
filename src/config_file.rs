//! `config.toml` and its layers: read with the line of every mistake, written as used.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use garad_slam::Config;
use garad_slam::config::RENAMED_KEYS;

/// Some keys of a configuration, as TOML.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layer {
    /// Where they come from, for messages: a file, or a profile.
    pub name: String,
    /// Tables and keys.
    pub text: String,
}

impl Layer {
    /// The text of a file.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("{name}: cannot read the configuration"))?;
        Ok(Self { name, text })
    }
}

/// The defaults, overridden by each layer in turn; tables and keys that a layer does not name stay as they
/// are.
///
/// # Errors
/// A key that does not exist, a value of the wrong kind (with its line), or a value outside its range.
pub fn layered(layers: &[Layer]) -> Result<Config> {
    layers.iter().try_fold(Config::default(), |below, layer| {
        let config = overridden(&below, layer)?;
        config.validate().with_context(|| layer.name.clone())?;
        Ok(config)
    })
}

/// `below`, overridden by the keys of a layer at any depth. Serde alone would fill a nested table with that
/// table's own defaults instead of those below.
fn overridden(below: &Config, layer: &Layer) -> Result<Config> {
    let Layer { name, text } = layer;
    if let Some(key) = text.parse().ok().as_ref().and_then(first_nan) {
        bail!("{name}: {key} is NaN; expected a number");
    }
    let merge = || -> Option<Config> {
        let mut config = toml::Table::try_from(below).ok()?;
        let mut given = text.parse().ok()?;
        for (old, new) in RENAMED_KEYS {
            rename(&mut given, old, new);
        }
        override_table(&mut config, given);
        config.try_into().ok()
    };
    match merge() {
        Some(config) => Ok(config),
        // Invalid: only parsing the text itself tells the line.
        None => toml::from_str(text).map_err(|error: toml::de::Error| {
            let line = line_of(text, error.span().map_or(0, |span| span.start));
            // A message may quote a key or a value that spans lines.
            anyhow!("{name}:{line}: {}", error.message().replace('\n', " "))
        }),
    }
}

/// The first key with a NaN, which is in no range, but passes where a key has none.
fn first_nan(table: &toml::Table) -> Option<String> {
    let is_nan = |value: &toml::Value| value.as_float().is_some_and(f64::is_nan);
    table.iter().find_map(|(key, value)| match value {
        toml::Value::Table(inner) => Some(format!("{key}.{}", first_nan(inner)?)),
        toml::Value::Array(items) => items.iter().any(is_nan).then(|| key.clone()),
        value => is_nan(value).then(|| key.clone()),
    })
}

/// Moves a value to its key of today, unless that is given, too.
fn rename(given: &mut toml::Table, old: &str, new: &str) {
    let (table, old_key) = old.rsplit_once('.').unwrap_or(("", old));
    let new_key = new.rsplit_once('.').map_or(new, |(_, key)| key);
    let tables = table.split('.').filter(|key| !key.is_empty());
    let table = tables
        .into_iter()
        .try_fold(given, |table, key| table.get_mut(key)?.as_table_mut());
    let Some(table) = table.filter(|table| !table.contains_key(new_key)) else {
        return;
    };
    if let Some(value) = table.remove(old_key) {
        tracing::warn!(
            "the configuration key {old} is {new} since 0.2.0; the old name is read for one version more"
        );
        table.insert(new_key.to_owned(), value);
    }
}

fn override_table(base: &mut toml::Table, given: toml::Table) {
    for (key, value) in given {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(base)), toml::Value::Table(given)) => {
                override_table(base, given)
            }
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

/// The line, from 1, that holds byte `at`.
fn line_of(text: &str, at: usize) -> usize {
    let before = text.bytes().take(at);
    1 + before.filter(|byte| *byte == b'\n').count()
}

/// The configuration as TOML text.
///
/// # Errors
/// A value without a TOML representation (none of ours).
pub fn write(config: &Config) -> Result<String> {
    toml::to_string(config).context("cannot write the configuration as TOML")
}

#[cfg(test)]
mod tests {
    use garad_slam::config::LinearSolver;

    use super::*;

    fn parse(text: &str) -> Result<Config> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("config.toml");
        std::fs::write(&path, text)?;
        layered(&[Layer::read(&path)?])
    }

    #[test]
    fn a_layer_overrides_those_below_key_by_key() {
        let layer = |name: &str, text: &str| Layer {
            name: name.to_owned(),
            text: text.to_owned(),
        };
        let low = layer(
            "low",
            "[crf.kernels]\nsigma_m = 0.3\nsigma_px = 9.0\n[flow]\nenabled = false\n",
        );
        let high = layer("high", "[crf.kernels]\nsigma_m = 0.4\n");
        let mut expected = Config::default();
        expected.crf.kernels.sigma_m = 0.4;
        expected.crf.kernels.sigma_px = 9.0;
        expected.flow.enabled = false;
        let config = layered(&[low.clone(), high]).expect("valid");
        assert_eq!(config, expected, "the last one that names a key");
        let wrong = layer("high", "\n[flow]\nenabled = 3\n");
        let error = layered(&[low.clone(), wrong]).expect_err("not a boolean");
        assert!(error.to_string().starts_with("high:3: "), "{error}");
        let range = layer("high", "[flow]\nchi2 = -1.0\n");
        let error = format!("{:#}", layered(&[low, range]).expect_err("negative"));
        assert!(error.starts_with("high: "), "{error}");
    }

    #[test]
    fn round_trip() {
        let mut config = Config::default();
        config.features.count = 700;
        let text = write(&config).expect("TOML");
        assert_eq!(parse(&text).expect("valid"), config, "round trip");
        assert_eq!(parse("").expect("valid"), Config::default(), "all defaults");
    }

    #[test]
    fn nested_keys_leave_other_defaults_alone() {
        let text = "[crf.kernels]\nsigma_m = 0.3\n[crf.unary.depth]\nmean = 3.0\n\
                    [labels.noise]\nfloor_m = 0.02\n";
        let mut expected = Config::default();
        expected.crf.kernels.sigma_m = 0.3;
        expected.crf.unary.depth.mean = 3.0;
        expected.labels.noise.floor_m = 0.02;
        assert_eq!(parse(text).expect("valid"), expected, "three keys, no more");
        let mut tail = Config::default();
        tail.crf.mean_field.method = garad_crf::Method::Reference;
        let text = "[crf.mean_field]\nmethod = \"reference\"\n";
        assert_eq!(parse(text).expect("valid"), tail, "a string for a table");
    }

    #[test]
    fn solvers_are_named() {
        let mut expected = Config::default();
        expected.loops.linear_solver = LinearSolver::Faer;
        let text = "[loops]\nlinear_solver = \"faer\"\n";
        assert_eq!(parse(text).expect("valid"), expected, "by name");
        let written = write(&expected).expect("TOML");
        assert_eq!(parse(&written).expect("valid"), expected, "round trip");
        let error = parse("[loops]\nlinear_solver = \"fear\"\n").expect_err("no such solver");
        let error = format!("{error:#}");
        assert!(
            error.contains("config.toml:2: ") && error.contains("portable"),
            "{error}"
        );
    }

    #[test]
    fn keys_of_before_are_still_read() {
        let text = "[seed]\nopacity = 0.5\n[refine]\nkeyframes = 7\n[surface.noise]\nfloor_m = 0.02\n\
                    [features]\nmost_times = 3.0\n[train]\nrefine = 9\n[densify]\npull = 0.5\n\
                    [labels]\nsecond_sight = false\nhindsight = false\n\
                    [labels.displacement]\nsigma_px = 2.0\n";
        let mut expected = Config::default();
        expected.insertion.opacity = 0.5;
        expected.subpixel.keyframes = 7;
        expected.depth_planes.noise.floor_m = 0.02;
        expected.features.max_oversampling = 3.0;
        expected.train.final_iterations = 9;
        expected.densify.grad_threshold = 0.5;
        expected.labels.bootstrap_restart = false;
        expected.labels.mask_freed_space = false;
        expected.labels.patch_motion.sigma_px = 2.0;
        assert_eq!(
            parse(text).expect("valid"),
            expected,
            "all the renamed keys"
        );
        let by_alias: Config = toml::from_str(text).expect("valid");
        assert_eq!(by_alias.insertion, expected.insertion, "serde alone, too");
        let both = "[seed]\nopacity = 0.5\n[insertion]\nopacity = 0.6\n";
        let error = format!("{:#}", parse(both).expect_err("given twice"));
        assert!(error.contains("insertion"), "{error}");
    }

    #[test]
    fn mistakes_are_reported_with_their_line() {
        let unknown = format!(
            "{:#}",
            parse("[tracking]\nbff = 40.0").expect_err("no such key")
        );
        assert!(
            unknown.contains("config.toml:2: ") && unknown.contains("bff"),
            "{unknown}"
        );
        for (text, line) in [
            ("bff = 1", 1),
            ("[insertion]\n\nopacity = true\n", 3),
            ("[insertion\n", 1),
            ("[insertion]\nopacity =", 2),
            ("\"un\\nknown\" = 1", 1),
            ("[loops]\n\nlinear_solver = \"fear\\nless\"", 3),
        ] {
            let message = format!("{:#}", parse(text).expect_err(text));
            assert!(
                message.contains(&format!("config.toml:{line}: ")) && !message.contains('\n'),
                "{text:?}: {message}"
            );
        }
        // Keys with and without a range.
        for (text, key) in [
            ("[tracking]\nbf = nan", "tracking.bf"),
            (
                "[keyframes]\ntracked_share = -nan",
                "keyframes.tracked_share",
            ),
        ] {
            let message = format!("{:#}", parse(text).expect_err(text));
            assert!(
                message.contains(&format!("config.toml: {key} is NaN")),
                "{message}"
            );
        }
        let range = format!(
            "{:#}",
            parse("[insertion]\nopacity = 2.0").expect_err("not in (0, 1)")
        );
        assert!(range.contains("insertion.opacity"), "{range}");
    }
}
