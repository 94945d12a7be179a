//! The diagnosis of a probe session, as a process of its own, and its report in the browser.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How often a running diagnosis is asked whether it has ended.
const LOOK: Duration = Duration::from_millis(50);

/// Show a file with the program that the desktop has for it.
pub fn show_file(path: &Path) -> std::io::Result<()> {
    let program = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(target_os = "windows") {
        "explorer"
    } else {
        "xdg-open"
    };
    Command::new(program).arg(path).stdout(Stdio::null()).stderr(Stdio::null()).spawn().map(|_| ())
}

/// Run `flexstage diagnose` on a session: a minute of both cores must not share the window's memory. The report, and the verdict in a
/// sentence.
pub(super) fn diagnose_session(
    rig: &Path,
    folder: &Path,
    stop: &AtomicBool,
) -> Result<(PathBuf, String), String> {
    let program = std::env::current_exe().map_err(|e| format!("the program is gone: {e}"))?;
    let mut out = folder.as_os_str().to_owned();
    out.push("-diagnosis");
    let out = PathBuf::from(out);
    let child = Command::new(program)
        .arg("diagnose")
        .arg("--rig")
        .arg(rig)
        .arg(folder)
        .arg("--out")
        .arg(&out)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|e| format!("`flexstage diagnose` cannot be started: {e}"))?;
    wait(child, stop).map_err(|e| match e {
        Ended::Stopped => format!("stopped; the recordings are in {}", folder.display()),
        Ended::Failed(words) => words,
    })?;
    let text = std::fs::read_to_string(out.join("diagnosis.json"))
        .map_err(|e| format!("{}: {e}", out.join("diagnosis.json").display()))?;
    let json: serde_json::Value =
        serde_json::from_str(&text).map_err(|e| format!("diagnosis.json: {e}"))?;
    Ok((out.join("report.html"), sentence(&json)))
}

enum Ended {
    Stopped,
    Failed(String),
}

/// Wait for a process, or end it when asked to.
fn wait(mut child: Child, stop: &AtomicBool) -> Result<(), Ended> {
    let failed = |words: String| Err(Ended::Failed(words));
    // Read beside the wait: a full pipe would stop the process for ever.
    let words = child.stderr.take().map(|mut stderr| {
        std::thread::spawn(move || {
            let mut words = String::new();
            let _ = stderr.read_to_string(&mut words);
            words
        })
    });
    loop {
        match child.try_wait() {
            Ok(Some(status)) if status.success() => return Ok(()),
            Ok(Some(_)) => {
                let words = words.and_then(|w| w.join().ok()).unwrap_or_default();
                let last = words.lines().last().unwrap_or("`flexstage diagnose` failed");
                return failed(last.to_owned());
            }
            Ok(None) if stop.load(Ordering::Acquire) => {
                // It may have ended in this moment.
                let _ = child.kill();
                let _ = child.wait();
                return Err(Ended::Stopped);
            }
            Ok(None) => std::thread::sleep(LOOK),
            Err(error) => return failed(error.to_string()),
        }
    }
}

/// The verdict with its causes, what it did to the gap, and what is left.
fn sentence(json: &serde_json::Value) -> String {
    let causes: Vec<String> = json["causes"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|cause| {
            let axes: Vec<String> =
                cause["axes"].as_array().into_iter().flatten().map(|a| a.to_string()).collect();
            format!("{} (axis {})", cause["effect"].as_str().unwrap_or("?"), axes.join(", "))
        })
        .collect();
    let in_order = json["in_order_nm"]
        .as_f64()
        .map_or(String::new(), |nm| format!(" ({nm:.1} nm in the session's order)"));
    let looks_like =
        json["looks_like"].as_str().map_or(String::new(), |words| format!(". {words}"));
    let left: Vec<&str> = json["rest"]["words"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(serde_json::Value::as_str)
        .collect();
    let left = if left.is_empty() {
        String::new()
    } else {
        format!(". What is left: {}", left.join("; "))
    };
    format!(
        "{}{}, gap {:.1} nm before, {:.1} nm after{in_order}{looks_like}{left}",
        json["verdict"].as_str().unwrap_or("?"),
        if causes.is_empty() { String::new() } else { format!(": {}", causes.join(" + ")) },
        json["gap"]["before_nm"].as_f64().unwrap_or(f64::NAN),
        json["gap"]["after_nm"].as_f64().unwrap_or(f64::NAN),
    )
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::time::Instant;

    fn shell(script: &str) -> Child {
        Command::new("sh").args(["-c", script]).stderr(Stdio::piped()).spawn().unwrap()
    }

    #[test]
    fn a_process_is_waited_for_and_its_last_words_are_kept() {
        let stop = AtomicBool::new(false);
        assert!(wait(shell("exit 0"), &stop).is_ok());
        // More than a pipe holds, so that a wait without reading would hang.
        let talks = "i=0; while [ $i -lt 3000 ]; do echo a line of forty characters, more or less; \
                     i=$((i+1)); done >&2; echo the reason >&2; exit 2";
        match wait(shell(talks), &stop) {
            Err(Ended::Failed(words)) => assert_eq!(words, "the reason"),
            _ => panic!("expected a failure"),
        }
    }

    #[test]
    fn the_sentence_says_what_is_left() {
        let json = serde_json::json!({
            "verdict": "partly-explained",
            "causes": [{ "effect": "friction", "axes": [1, 3] }],
            "gap": { "before_nm": 120.0, "after_nm": 30.04 },
            "rest": { "words": ["dynamic coupling", "disturbances in a.parquet"] },
        });
        assert_eq!(
            sentence(&json),
            "partly-explained: friction (axis 1, 3), gap 120.0 nm before, 30.0 nm after. \
             What is left: dynamic coupling; disturbances in a.parquet"
        );
    }

    #[test]
    fn a_stop_ends_it_at_once() {
        let start = Instant::now();
        let ended = wait(shell("exec sleep 30"), &AtomicBool::new(true));
        assert!(matches!(ended, Err(Ended::Stopped)));
        assert!(start.elapsed() < Duration::from_secs(10));
    }
}
