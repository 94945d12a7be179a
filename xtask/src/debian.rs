//! Programs and libraries that come from Debian packages: found, or installed where that is allowed.

use std::path::Path;

use anyhow::{Result, bail};
use xshell::{Shell, cmd};

/// Something a step needs: it is there when `file` exists or `program` is on the path.
pub struct Need {
    /// Program name, or an absolute path of a file.
    pub program: &'static str,
    /// Debian packages that bring it.
    pub packages: &'static [&'static str],
}

impl Need {
    fn is_there(&self) -> bool {
        if self.program.starts_with('/') {
            return Path::new(self.program).exists();
        }
        std::env::var_os("PATH").is_some_and(|path| {
            std::env::split_paths(&path).any(|dir| dir.join(self.program).is_file())
        })
    }
}

/// Make sure that all of `needs` are there; installs what is missing when this is Debian and we are root.
///
/// # Errors
/// Names what is missing and the packages that would bring it.
pub fn ensure(shell: &Shell, needs: &[Need]) -> Result<()> {
    let missing = || needs.iter().filter(|need| !need.is_there()).collect::<Vec<_>>();
    let packages: Vec<&str> = missing().iter().flat_map(|need| need.packages).copied().collect();
    if packages.is_empty() {
        return Ok(());
    }
    if is_root() && Path::new("/usr/bin/apt-get").exists() {
        println!("installing {}", packages.join(" "));
        let wanted = &packages;
        let _env = shell.push_env("DEBIAN_FRONTEND", "noninteractive");
        cmd!(shell, "apt-get update -q").ignore_stdout().run()?;
        cmd!(shell, "apt-get install -q -y --no-install-recommends {wanted...}")
            .ignore_stdout()
            .run()?;
    }
    let left: Vec<_> = missing().iter().map(|need| need.program).collect();
    if left.is_empty() {
        return Ok(());
    }
    bail!("{} not found; the Debian packages {} bring it", left.join(", "), packages.join(" "));
}

fn is_root() -> bool {
    let shell = Shell::new();
    shell.is_ok_and(|shell| cmd!(shell, "id -u").quiet().read().is_ok_and(|id| id == "0"))
}
