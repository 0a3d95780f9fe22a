//! Ctrl-C (SIGINT) and SIGTERM: the work ends between two frames, and what there is of its results is written. A
//! second one ends the program at once.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use thiserror::Error;

/// Exit code of a command that was interrupted.
pub const EXIT_CODE: u8 = 130;

static ASKED: AtomicBool = AtomicBool::new(false);

/// The end of a command that was interrupted: how far it came, and what was written.
#[derive(Debug, Error)]
#[error("{0}")]
pub struct Interrupted(pub String);

impl Interrupted {
    /// Before there was anything to write: what an earlier run wrote stays.
    #[must_use]
    pub fn before(what: &str) -> Self {
        Self(format!("interrupted before {what}; nothing is written"))
    }
}

/// From now on a signal sets [`asked`] instead of ending the program.
///
/// # Errors
/// Those of the operating system.
pub fn listen() -> io::Result<()> {
    for signal in [SIGINT, SIGTERM] {
        // First the action for the second signal: it looks at what the first one has set.
        flag::register_conditional_shutdown(signal, i32::from(EXIT_CODE), &ASKED)?;
        flag::register(signal, &ASKED)?;
    }
    Ok(())
}

/// Whether the work is to end. Never without [`listen`].
#[must_use]
pub fn asked() -> bool {
    ASKED.load(Ordering::Relaxed)
}

/// A file beyond the limit on its size (`ulimit -f`) is an error of its write, not the end of the program.
///
/// # Errors
/// Those of the operating system.
pub fn survive_file_size_limit() -> io::Result<()> {
    #[cfg(unix)]
    {
        static EXCEEDED: AtomicBool = AtomicBool::new(false);
        flag::register(signal_hook::consts::SIGXFSZ, &EXCEEDED)?;
    }
    Ok(())
}
