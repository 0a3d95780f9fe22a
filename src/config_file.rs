//! `config.toml` and its layers: read with the line of every mistake, written as used.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use garad_slam::Config;
use garad_slam::config::RENAMED_KEYS;
use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

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
/// table's own defaults instead of those below, or miss what it does not name.
fn overridden(below: &Config, layer: &Layer) -> Result<Config> {
    let Layer { name, text } = layer;
    if let Some(key) = text.parse().ok().as_ref().and_then(first_nan) {
        bail!("{name}: {key} is NaN; expected a number");
    }
    let below = write(below)?;
    let read = || -> Result<Config, toml::de::Error> {
        let mut given = DeTable::parse(text)?;
        for (old, new) in RENAMED_KEYS {
            rename(given.get_mut(), old, new);
        }
        fill(given.get_mut(), DeTable::parse(&below)?.into_inner());
        Config::deserialize(toml::Deserializer::from(given))
    };
    // Only what is given can be wrong, so a span is one of the text.
    read().map_err(|error| {
        let line = line_of(text, error.span().map_or(0, |span| span.start));
        // A message may quote a key or a value that spans lines.
        anyhow!("{name}:{line}: {}", error.message().replace('\n', " "))
    })
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
fn rename(given: &mut DeTable<'_>, old: &str, new: &'static str) {
    let (table, old_key) = old.rsplit_once('.').unwrap_or(("", old));
    let new_key = new.rsplit_once('.').map_or(new, |(_, key)| key);
    let mut tables = table.split('.').filter(|key| !key.is_empty());
    let table = tables.try_fold(given, |table, key| as_table(table.get_mut(key)?));
    let Some(table) = table.filter(|table| !table.contains_key(new_key)) else {
        return;
    };
    if let Some((key, value)) = table.remove_entry(old_key) {
        tracing::warn!(
            "the configuration key {old} is {new} since 0.2.0; the old name is read for one version more"
        );
        table.insert(Spanned::new(key.span(), new_key.into()), value);
    }
}

fn as_table<'t, 'i>(value: &'t mut Spanned<DeValue<'i>>) -> Option<&'t mut DeTable<'i>> {
    match value.get_mut() {
        DeValue::Table(table) => Some(table),
        _ => None,
    }
}

/// Adds what is not given, in every table.
fn fill<'i>(given: &mut DeTable<'i>, below: DeTable<'i>) {
    for (key, value) in below {
        match given.get_mut(key.get_ref().as_ref()) {
            None => {
                given.insert(key, value);
            }
            Some(given) => {
                if let (Some(given), DeValue::Table(below)) = (as_table(given), value.into_inner())
                {
                    fill(given, below);
                }
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
        // Tables given in part, of which one has a mistake: those without defaults of their own, and a renamed one.
        for (text, line, word) in [
            (
                "[crf.unary.depth]\nweight = 4.0\n\n[crf.unary.alpha]\nweight = 2.0\n",
                4,
                "alpha",
            ),
            ("[crf.unary.depth]\nweight = 4.0\nsigna = 2.0\n", 3, "signa"),
            (
                "[crf.unary.depth]\nmean = 1.0\n[flow]\nenabled = 3\n",
                4,
                "boolean",
            ),
            ("[refine]\nkeyframes = 7\nframz = 1\n", 3, "framz"),
            ("[seed]\n\nopacity = \"much\"\n", 3, "much"),
        ] {
            let message = format!("{:#}", parse(text).expect_err(text));
            let start = format!("config.toml:{line}: ");
            assert!(
                message.contains(&start) && message.contains(word),
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
