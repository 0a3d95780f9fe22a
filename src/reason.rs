//! An error and its causes in one line.

/// The messages of an error and of its causes, outermost first, each said once: many errors of libraries repeat their
/// cause in their own message.
#[must_use]
pub fn reason(error: &anyhow::Error) -> String {
    let mut said = String::new();
    for cause in error.chain() {
        let text = cause.to_string();
        if said.is_empty() {
            said = text;
        } else if !said.contains(&text) {
            said = format!("{said}: {text}");
        }
    }
    said
}

#[cfg(test)]
mod tests {
    use super::reason;
    use anyhow::anyhow;

    #[test]
    fn every_cause_is_said_once() {
        let error = anyhow!("permission denied");
        assert_eq!(reason(&error), "permission denied", "alone");
        let error = error.context("rgb.txt: permission denied");
        assert_eq!(reason(&error), "rgb.txt: permission denied", "repeated");
        let error = error.context("frame 3");
        assert_eq!(
            reason(&error),
            "frame 3: rgb.txt: permission denied",
            "a new message in front"
        );
    }
}
