//! The program as a person or a script runs it.

#![allow(dead_code, reason = "each test file uses its share")]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

/// The program.
pub fn flexstage() -> Command {
    Command::new(env!("CARGO_BIN_EXE_flexstage"))
}

/// Run with these arguments to the end.
pub fn run<S: AsRef<std::ffi::OsStr>>(args: &[S]) -> Output {
    flexstage().args(args).stdin(Stdio::null()).output().unwrap()
}

/// What it printed, provided that it succeeded.
pub fn ok(out: Output) -> String {
    let words = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "exit {:?}: {words}", out.status.code());
    String::from_utf8(out.stdout).unwrap()
}

/// The line on standard error, provided that the exit status is 2 and there is only one line.
pub fn refused(out: Output) -> String {
    let words = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(2), "{words}");
    assert_eq!(words.trim_end().lines().count(), 1, "{words}");
    words
}

/// A virtual board that stays while commands come and go.
pub struct Board {
    child: Child,
    /// What `--connect` takes.
    pub address: String,
}

impl Board {
    /// Start one on any free port, with more options for it.
    pub fn start(options: &[&str]) -> Self {
        let mut child = flexstage()
            .args(["serve", "--virtual", "--listen", "127.0.0.1:0"])
            .args(options)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let first = lines.next().unwrap().unwrap();
        let address = first.rsplit(' ').next().unwrap().to_owned();
        // The pipe is read on, so that the server never waits for it.
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, address }
    }

    /// A command against it.
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = flexstage();
        command.args(args).args(["--connect", &self.address]).stdin(Stdio::null());
        command
    }

    /// Run a command against it.
    pub fn run(&self, args: &[&str]) -> Output {
        self.command(args).output().unwrap()
    }

    /// Switch it off.
    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// JSON that a command printed.
pub fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// A path as text.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
