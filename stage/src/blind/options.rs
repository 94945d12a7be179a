//! The options under which the cases of a folder were drawn, kept beside them: an interrupted run goes on with the same ones, and answers
//! to other cases are never taken for its own.

use std::fs;
use std::path::Path;

use anyhow::{Context, bail};
use serde_json::{Map, Value, json};

use super::Args;

const FILE: &str = "options.json";

impl Args {
    /// Everything that decides what a case is and what answers it. How many cases there are is not among it: a case is the same in a
    /// larger set.
    fn kept(&self) -> Map<String, Value> {
        let kept = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "--seed": self.seed,
            "--min-ratio": self.min_ratio,
            "--max-ratio": self.max_ratio,
            "--sessions": format!("{:?}", self.sessions).to_lowercase(),
            "--other-rigs": self.other_rigs,
            "--without-monitor": self.without_monitor,
            "--weights": self.weights,
            "--only": self.only,
            "--further-forms": self.further_forms,
            "--faults": format!("{:?}", self.faults).to_lowercase(),
            "--leave-one-out": self.leave_one_out,
        });
        kept.as_object().cloned().unwrap_or_default()
    }

    /// Keep the options in a folder, or refuse one that holds cases of others.
    pub(super) fn keep(&self, folder: &Path) -> anyhow::Result<()> {
        let (path, now) = (folder.join(FILE), self.kept());
        let option = if self.write_only.is_some() { "--write-only" } else { "--out" };
        let choose = format!("choose another folder ({option}) or remove this one");
        if !path.exists() {
            if folder.join(".labels").exists() || folder.join("answers").exists() {
                bail!(
                    "{}: expected a new folder or one with {FILE}, found cases of unknown options: {choose}",
                    folder.display()
                );
            }
            let text = serde_json::to_string_pretty(&now)? + "\n";
            return crate::diagnose::write_all(folder, &[(FILE, text)]);
        }
        let text = fs::read(&path).with_context(|| format!("{}: cannot read", path.display()))?;
        let before: Map<String, Value> = serde_json::from_slice(&text).with_context(|| {
            format!("{}: expected the options of the cases beside it; {choose}", path.display())
        })?;
        for (name, now) in &now {
            let before = before.get(name).unwrap_or(&Value::Null);
            if before != now {
                bail!("{}: holds cases of {name} {before}, not {now}: {choose}", folder.display());
            }
        }
        Ok(())
    }
}
