//! [`ResultFolder`]: the folder that a command writes its results into.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{ErrorKind, Write as _};
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, Error, Result, bail};
use garad_dataset::{temporary_of, write_bytes_atomically};

use crate::reason::reason;

/// The list of what garad wrote into a folder: a line `COMMAND NAME` per file.
pub const LIST: &str = "garad_files.txt";
/// First line of the list.
const HEADER: &str =
    "# Files written by garad. The next run of the same command into this folder replaces them.";

/// A folder for results, tried before the work and written after it.
///
/// - Each file is whole or absent. One that cannot be written keeps no other from being written;
///   [`ResultFolder::finish`] names all that failed.
/// - What the same command wrote earlier stays until the first new file is written. From then on files of
///   the same name are replaced one by one, and [`ResultFolder::finish`] removes the others. Only regular
///   files that are in [`LIST`] are removed, none that lies behind a symbolic link.
#[derive(Debug)]
pub struct ResultFolder {
    root: PathBuf,
    /// The command, with `:` and a checksum of its settings if [`ResultFolder::of`] has one.
    command: String,
    /// Command of each file that garad wrote into the folder.
    listed: BTreeMap<String, String>,
    /// Names that an earlier run of the command wrote.
    earlier: BTreeSet<String>,
    written: BTreeSet<String>,
    /// Whether a file was written, or tried.
    begun: bool,
    /// Where the next name is noted.
    list: Option<File>,
    failed: Vec<(String, Error)>,
}

impl ResultFolder {
    /// Makes the folder, and tries that files can be written into it and into the folders that an earlier
    /// run of the command made there.
    ///
    /// # Errors
    /// The folder, and why it cannot be written; a list in it that is not garad's.
    pub fn open(root: &Path, command: &str) -> Result<Self> {
        try_folder(root)?;
        let mut folder = Self {
            root: root.to_path_buf(),
            command: command.to_owned(),
            listed: BTreeMap::new(),
            earlier: BTreeSet::new(),
            written: BTreeSet::new(),
            begun: false,
            list: None,
            failed: Vec::new(),
        };
        folder.read_list()?;
        let parents = folder.earlier.iter().filter_map(|name| plain(root, name));
        let parents = parents.filter_map(|path| path.parent().map(Path::to_path_buf));
        for parent in parents.collect::<BTreeSet<_>>() {
            try_folder(&parent)?;
        }
        Ok(folder)
    }

    /// For a command that writes while it computes: what it wrote with other settings is removed before the
    /// first file, so that old and new files are never beside each other.
    #[must_use]
    pub fn of(mut self, settings: &str) -> Self {
        let checksum = crc32fast::hash(settings.as_bytes());
        self.command = format!("{}:{checksum:08x}", kind(&self.command));
        self
    }

    /// Its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.root
    }

    /// Whether a file could not be written.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        !self.failed.is_empty()
    }

    /// Writes a file; `content` writes it, whole or not at all, to the path it is given. The folders above
    /// it are made.
    pub fn write(&mut self, name: &str, content: impl FnOnce(&Path) -> Result<()>) {
        self.note(name);
        let path = self.root.join(name);
        let parent = path.parent().unwrap_or(&self.root);
        match make_folder(parent).and_then(|()| content(&path)) {
            Ok(()) => {
                self.written.insert(name.to_owned());
            }
            Err(error) => self.fail(name, error),
        }
    }

    /// Writes bytes; see [`ResultFolder::write`].
    pub fn bytes(&mut self, name: &str, bytes: &[u8]) {
        self.write(name, |path| Ok(write_bytes_atomically(path, bytes)?));
    }

    /// A file that cannot be written because its content cannot be computed.
    pub fn fail(&mut self, name: &str, error: Error) {
        self.failed.push((name.to_owned(), error));
    }

    /// The results of a run in a folder in this one. They are part of these results: a later run of the
    /// command that does not make them removes them.
    ///
    /// # Errors
    /// Those of [`ResultFolder::open`].
    pub fn child(&mut self, name: &str) -> Result<Self> {
        let child = Self::open(&self.root.join(name), "run")?;
        let list = format!("{name}/{LIST}");
        self.note(&list);
        self.written.insert(list);
        Ok(child)
    }

    /// Removes what an earlier run of the command wrote and this one did not.
    ///
    /// # Errors
    /// Every file that could not be written or removed, with the reason.
    pub fn finish(mut self) -> Result<()> {
        if !self.written.is_empty() {
            let stale: Vec<_> = self.earlier.difference(&self.written).cloned().collect();
            for name in stale {
                self.remove(&name);
            }
            let command = kind(&self.command);
            let (written, failed) = (&self.written, &self.failed);
            self.listed.retain(|name, by| {
                let still_there = || failed.iter().any(|(n, _)| n == name);
                kind(by) != command || written.contains(name) || still_there()
            });
            let outcome = write_list(&self.root, &self.listed);
            self.expect_list(outcome);
        }
        let path = |name: &str| self.root.join(name).display().to_string();
        match &mut self.failed[..] {
            [] => Ok(()),
            [(name, error)] => {
                let error = std::mem::replace(error, Error::msg(""));
                let named = reason(&error).contains(&*name);
                Err(if named {
                    error
                } else {
                    error.context(path(name))
                })
            }
            several => {
                let mut names: BTreeMap<String, Vec<&str>> = BTreeMap::new();
                for (name, error) in several.iter() {
                    let cause = error.root_cause().to_string();
                    names.entry(cause).or_default().push(name);
                }
                let causes = names.iter();
                let causes = causes.map(|(cause, names)| format!("{}: {cause}", names.join(", ")));
                bail!(
                    "{}: {} files cannot be written: {}",
                    self.root.display(),
                    several.len(),
                    causes.collect::<Vec<_>>().join("; ")
                )
            }
        }
    }

    /// Notes, before a file is written, that it is ours: also a run that is killed leaves no file that the
    /// next one would not know.
    fn note(&mut self, name: &str) {
        if !std::mem::replace(&mut self.begun, true) {
            let outcome = self.begin();
            self.expect_list(outcome);
        }
        if self.listed.get(name) != Some(&self.command) {
            let line = format!("{} {name}\n", self.command);
            self.listed.insert(name.to_owned(), self.command.clone());
            if let Some(list) = &mut self.list {
                let outcome = list.write_all(line.as_bytes()).map_err(Error::from);
                self.expect_list(outcome);
            }
        }
    }

    fn begin(&mut self) -> Result<()> {
        self.read_list()?;
        let other_settings = |name: &&String| self.listed.get(*name) != Some(&self.command);
        let removed: Vec<_> = match self.command.contains(':') {
            true => self
                .earlier
                .iter()
                .filter(other_settings)
                .cloned()
                .collect(),
            false => Vec::new(),
        };
        for name in removed {
            self.remove(&name);
            self.listed.remove(&name);
        }
        for path in temporaries(&self.root, &self.listed) {
            fs::remove_file(path)?;
        }
        write_list(&self.root, &self.listed)?;
        let list = File::options().append(true).open(self.root.join(LIST))?;
        self.list = Some(list);
        Ok(())
    }

    fn read_list(&mut self) -> Result<()> {
        self.listed = read_list(&self.root)?;
        let command = kind(&self.command);
        let earlier = self.listed.iter().filter(|(_, by)| kind(by) == command);
        self.earlier = earlier.map(|(name, _)| name.clone()).collect();
        Ok(())
    }

    fn remove(&mut self, name: &str) {
        if let Err(error) = remove(&self.root, name) {
            self.fail(name, error.context("cannot be removed"));
        }
    }

    /// The list is a file as the others are, reported once.
    fn expect_list(&mut self, outcome: Result<()>) {
        if let Err(error) = outcome
            && !self.failed.iter().any(|(name, _)| name == LIST)
        {
            self.fail(LIST, error);
        }
    }
}

/// Makes a folder for results, with those above it.
///
/// # Errors
/// The path, and why not.
pub fn make_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path).with_context(|| format!("{}: cannot make the folder", path.display()))
}

/// Makes a folder, writes a small file into it and removes it.
///
/// # Errors
/// The path, and why nothing can be written there.
pub fn try_folder(path: &Path) -> Result<()> {
    make_folder(path)?;
    let probe = path.join(format!(".garad_probe{}", std::process::id()));
    let written = fs::write(&probe, "Can files be written here?\n");
    let removed = fs::remove_file(&probe);
    written
        .and(removed)
        .with_context(|| format!("{}: cannot write into the folder", path.display()))
}

/// A command without the checksum of its settings.
fn kind(command: &str) -> &str {
    command.split(':').next().unwrap_or(command)
}

/// The files listed in a folder, each with its command. A last line that was cut off names a file that was
/// never begun.
fn read_list(root: &Path) -> Result<BTreeMap<String, String>> {
    let path = root.join(LIST);
    let text = match fs::read_to_string(&path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(BTreeMap::new()),
        text => text.with_context(|| format!("{}: cannot be read", path.display()))?,
    };
    if text.lines().next() != Some(HEADER) {
        bail!(
            "{}: is not a list made by garad; expected another folder, or none of that name",
            path.display()
        );
    }
    let lines = text.split_inclusive('\n').skip(1);
    let lines = lines.filter_map(|line| line.strip_suffix('\n')?.split_once(' '));
    let lines = lines.filter(|(_, name)| *name != LIST);
    Ok(lines
        .map(|(command, name)| (name.to_owned(), command.to_owned()))
        .collect())
}

fn write_list(root: &Path, listed: &BTreeMap<String, String>) -> Result<()> {
    let lines = listed.iter().map(|(name, by)| format!("{by} {name}\n"));
    let text = format!("{HEADER}\n{}", lines.collect::<String>());
    Ok(write_bytes_atomically(&root.join(LIST), text.as_bytes())?)
}

/// The path of a listed name if that is a regular file below the folder and no part of the way is a link.
fn plain(root: &Path, name: &str) -> Option<PathBuf> {
    let mut path = root.to_path_buf();
    let mut parts = Path::new(name).components().peekable();
    while let Some(part) = parts.next() {
        let Component::Normal(part) = part else {
            return None;
        };
        path.push(part);
        let found = fs::symlink_metadata(&path).ok()?;
        let expected = match parts.peek() {
            Some(_) => found.is_dir(),
            None => found.is_file(),
        };
        if !expected {
            return None;
        }
    }
    (path != root).then_some(path)
}

/// Removes a listed file, and the folders above it that it leaves empty. With the list of a folder goes what
/// a run has written there. What is no longer a regular file is not garad's.
fn remove(root: &Path, name: &str) -> Result<()> {
    let Some(path) = plain(root, name) else {
        return Ok(());
    };
    let parent = path.parent().unwrap_or(root);
    if path.ends_with(LIST) {
        let mut listed = read_list(parent)?;
        let of_run = listed.iter().filter(|(_, by)| kind(by) == "run");
        for (name, _) in of_run {
            remove(parent, name)?;
        }
        listed.retain(|_, by| kind(by) != "run");
        if !listed.is_empty() {
            return write_list(parent, &listed);
        }
    }
    fs::remove_file(&path)?;
    let above = parent.ancestors().take_while(|folder| *folder != root);
    for folder in above {
        // One that holds other files stays.
        if fs::remove_dir(folder).is_err() {
            break;
        }
    }
    Ok(())
}

/// What a program that was killed left of listed files. Where it cannot be known that the program no longer
/// runs, there are none.
fn temporaries(root: &Path, listed: &BTreeMap<String, String>) -> Vec<PathBuf> {
    let processes = Path::new("/proc");
    if !processes.join("self").exists() {
        return Vec::new();
    }
    let folders = listed.keys().filter_map(|name| Path::new(name).parent());
    let folders: BTreeSet<&Path> = folders.collect();
    let mut found = Vec::new();
    for folder in folders {
        let entries = fs::read_dir(root.join(folder)).into_iter().flatten();
        for name in entries.flatten().map(|entry| entry.file_name()) {
            let Some((file, process)) = name.to_str().and_then(temporary_of) else {
                continue;
            };
            let ours = folder
                .join(file)
                .to_str()
                .is_some_and(|name| listed.contains_key(name));
            let left = folder.join(&name);
            let path = left.to_str().and_then(|left| plain(root, left));
            if ours && !processes.join(process.to_string()).exists() {
                found.extend(path);
            }
        }
    }
    found
}

#[cfg(test)]
mod tests;
