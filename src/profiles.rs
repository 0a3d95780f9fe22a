//! [`PROFILES`]: named configurations, TOML files in `profiles/` that are part of the program.

use crate::config_file::Layer;

/// A named configuration. Keys that its file does not name keep their defaults.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Profile {
    /// Name on the command line.
    pub name: &'static str,
    /// What it is, in a line.
    pub about: &'static str,
    /// The text of its file.
    pub toml: &'static str,
}

/// Every profile: a line here and a file in `profiles/`.
#[rustfmt::skip]
pub const PROFILES: &[Profile] = &[
    Profile { name: "default", about: "the best settings we know", toml: include_str!("../profiles/default.toml") },
    Profile { name: "paper", about: "the paper's system, every reading as printed", toml: include_str!("../profiles/paper.toml") },
    Profile { name: "paper_tuned", about: "the paper's loop, its free choices made on recordings", toml: include_str!("../profiles/paper_tuned.toml") },
    Profile { name: "orb_slam", about: "static tracking, no map: the role of ORB-SLAM3", toml: include_str!("../profiles/orb_slam.toml") },
    Profile { name: "photo_slam", about: "static tracking and mapping, no labels: the role of Photo-SLAM", toml: include_str!("../profiles/photo_slam.toml") },
    Profile { name: "nid_slam", about: "labels from optical flow alone, mapping: the role of NID-SLAM", toml: include_str!("../profiles/nid_slam.toml") },
    Profile { name: "splatam", about: "tracking by rendering, no features, no labels: the role of SplaTAM", toml: include_str!("../profiles/splatam.toml") },
];

impl Profile {
    /// The profile of that name.
    ///
    /// # Errors
    /// The names there are.
    pub fn find(name: &str) -> Result<&'static Self, String> {
        let found = PROFILES.iter().find(|profile| profile.name == name);
        found.ok_or_else(|| {
            let names: Vec<&str> = PROFILES.iter().map(|profile| profile.name).collect();
            format!("no such profile; expected one of {}", names.join(", "))
        })
    }

    /// Its text as a layer of a configuration.
    #[must_use]
    pub fn layer(&self) -> Layer {
        Layer {
            name: format!("profile {}", self.name),
            text: self.toml.to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use garad_slam::Config;

    use super::*;
    use crate::config_file;

    fn config(name: &str) -> Config {
        let profile = Profile::find(name).expect("a profile");
        config_file::layered(&[profile.layer()]).expect("valid")
    }

    #[test]
    fn every_profile_is_valid_and_its_own() {
        for (i, profile) in PROFILES.iter().enumerate() {
            let is_default = config(profile.name) == Config::default();
            assert_eq!(is_default, profile.name == "default", "{}", profile.name);
            for other in &PROFILES[..i] {
                assert_ne!(config(profile.name), config(other.name), "{}", other.name);
            }
            let head = profile.toml.lines().next();
            assert!(
                head.is_some_and(|line| line.starts_with("# ")),
                "{}: a comment first",
                profile.name
            );
        }
    }

    /// A file names only keys that it changes.
    #[test]
    fn profiles_repeat_no_default() {
        for profile in PROFILES {
            let given: toml::Table = profile.toml.parse().expect("TOML");
            let defaults = toml::Table::try_from(Config::default()).expect("a table");
            assert_differs(profile.name, &given, &defaults);
        }
    }

    fn assert_differs(path: &str, given: &toml::Table, defaults: &toml::Table) {
        for (key, value) in given {
            let path = format!("{path}.{key}");
            match (value, defaults.get(key)) {
                (toml::Value::Table(given), Some(toml::Value::Table(defaults))) => {
                    assert_differs(&path, given, defaults);
                }
                (value, default) => assert_ne!(Some(value), default, "{path}"),
            }
        }
    }

    #[test]
    fn unknown_names_are_answered_with_the_known_ones() {
        let error = Profile::find("orb_slam9").expect_err("none");
        for profile in PROFILES {
            assert!(error.contains(profile.name), "{error}");
        }
    }
}
