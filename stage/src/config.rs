//! `flexstage config get|set|save`: settings of a board by name, checked before they are sent.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use flexstage::link::message::{Command, Reply};
use flexstage::{Config, Settings};
use telemetry::Device;
use toml::Value;

use crate::board::BoardArgs;
use crate::say::say;

/// Options of `flexstage config`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    board: BoardArgs,
    /// Machine-readable output.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand)]
enum Action {
    /// Print all settings, or those under a name like `axes.1.feedback` (axes from 1).
    Get {
        /// Name.
        name: Option<String>,
        /// Everything as a settings file, for `set --file` and `compare`.
        #[arg(long, conflicts_with = "name")]
        toml: bool,
    },
    /// Change settings: NAME=VALUE, any number of them, all or none.
    Set {
        /// Assignments like `axes.1.feedback.proportional_v_per_um=2.5` (axes from 1).
        #[arg(required_unless_present = "file")]
        assignments: Vec<String>,
        /// Take all settings from a TOML file first.
        #[arg(long)]
        file: Option<PathBuf>,
        /// Also write them to flash.
        #[arg(long)]
        save: bool,
    },
    /// Write the settings in effect to flash.
    Save,
    /// Say what differs between the board and a TOML file.
    Compare {
        /// The file.
        file: PathBuf,
    },
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let device = args.board.open()?;
    let settings = read(&device)?;
    let tree = Value::try_from(&settings)?;
    match args.action {
        Action::Get { toml: true, .. } => {
            crate::say::text(format_args!("{}", toml::to_string_pretty(&settings)?))
        }
        Action::Get { name, .. } => {
            let value = match &name {
                None => &tree,
                Some(name) => find(&tree, name)?,
            };
            print(name.as_deref(), value, args.json)
        }
        Action::Set { assignments, file, save } => {
            let mut tree = match file {
                Some(path) => Value::try_from(load(&path)?)?,
                None => tree,
            };
            for assignment in &assignments {
                assign(&mut tree, assignment)?;
            }
            let settings: Settings =
                tree.try_into().map_err(|e: toml::de::Error| anyhow::anyhow!("{}", e.message()))?;
            Config::build(&settings).map_err(|e| anyhow::anyhow!("{e}"))?;
            let Reply::Configured { tick, digest } =
                device.command(Command::SetSettings(settings))?
            else {
                bail!("the board did not say what took effect");
            };
            if args.json {
                say!("{}", serde_json::json!({"tick": tick, "digest": format!("{digest:08x}")}))?;
            } else {
                say!("settings {digest:08x} act from tick {tick}")?;
            }
            if save { save_to_flash(&device, args.json) } else { Ok(()) }
        }
        Action::Save => save_to_flash(&device, args.json),
        Action::Compare { file } => {
            let other = Value::try_from(load(&file)?)?;
            let mut lines = Vec::new();
            differences(&tree, &other, String::new(), &mut lines);
            if args.json {
                say!("{}", serde_json::to_string_pretty(&lines)?)?;
            } else if lines.is_empty() {
                say!("board and file agree")?;
            } else {
                for (name, board, file) in lines {
                    say!("{name}: board {board}, file {file}")?;
                }
            }
            Ok(())
        }
    }
}

/// Settings in effect.
pub fn read(device: &Device) -> anyhow::Result<Settings> {
    match device.command(Command::ReadSettings)? {
        Reply::Settings(settings) => Ok(settings),
        _ => bail!("{} does not answer with its settings", device.info().name),
    }
}

fn save_to_flash(device: &Device, json: bool) -> anyhow::Result<()> {
    let Reply::Saved { version, slot } = device.command(Command::Save)? else {
        bail!("the board did not confirm the save");
    };
    if json {
        say!("{}", serde_json::json!({"version": version, "slot": slot}))?;
    } else {
        say!("saved as number {version} in slot {slot}")?;
    }
    Ok(())
}

fn load(path: &Path) -> anyhow::Result<Settings> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let settings: Settings = toml::from_str(&text)
        .map_err(|e| anyhow::anyhow!("{}: {}", path.display(), e.message()))?;
    Config::build(&settings).map_err(|e| anyhow::anyhow!("{}: {e}", path.display()))?;
    Ok(settings)
}

/// Index of a list from a part of a name: axes and everything else count from 1.
fn index(part: &str) -> Option<usize> {
    part.parse::<usize>().ok().and_then(|i| i.checked_sub(1))
}

fn find<'a>(tree: &'a Value, name: &str) -> anyhow::Result<&'a Value> {
    let mut at = tree;
    for part in name.split('.') {
        let next = match at {
            Value::Table(table) => table.get(part),
            Value::Array(list) => index(part).and_then(|i| list.get(i)),
            _ => None,
        };
        at =
            next.with_context(|| format!("`{name}`: no setting `{part}`; there is {}", names(at)))?;
    }
    Ok(at)
}

fn names(value: &Value) -> String {
    match value {
        Value::Table(table) => table.keys().cloned().collect::<Vec<_>>().join(", "),
        Value::Array(list) => format!("1 to {}", list.len()),
        _ => "a single value here".into(),
    }
}

fn assign(tree: &mut Value, assignment: &str) -> anyhow::Result<()> {
    let (name, text) = assignment
        .split_once('=')
        .with_context(|| format!("`{assignment}`: expected NAME=VALUE"))?;
    let old = find(tree, name)?.clone();
    let bad = || format!("`{name}`: expected {}, found `{text}`", old.type_str());
    let new = match old {
        Value::Float(_) => Value::Float(text.trim().parse::<f64>().with_context(bad)?),
        Value::Integer(_) => Value::Integer(text.trim().parse::<i64>().with_context(bad)?),
        Value::Boolean(_) => Value::Boolean(text.trim().parse::<bool>().with_context(bad)?),
        _ => {
            let parsed: toml::Table = toml::from_str(&format!("v = {text}")).with_context(bad)?;
            parsed.get("v").cloned().with_context(bad)?
        }
    };
    let mut at = tree;
    for part in name.split('.') {
        let next = match at {
            Value::Table(table) => table.get_mut(part),
            Value::Array(list) => index(part).and_then(|i| list.get_mut(i)),
            _ => None,
        };
        at = next.with_context(|| format!("`{name}`: no such setting"))?;
    }
    *at = new;
    Ok(())
}

fn single(value: &Value) -> String {
    match value {
        // Settings are single precision: print no digit that is not theirs.
        Value::Float(x) => (*x as f32).to_string(),
        other => other.to_string(),
    }
}

fn print(name: Option<&str>, value: &Value, json: bool) -> anyhow::Result<()> {
    if json {
        say!("{}", serde_json::to_string_pretty(value)?)?;
    } else {
        let mut lines = Vec::new();
        flatten(value, name.unwrap_or_default().to_owned(), &mut lines);
        for (name, value) in lines {
            say!("{name} = {value}")?;
        }
    }
    Ok(())
}

fn flatten(value: &Value, name: String, out: &mut Vec<(String, String)>) {
    let join =
        |part: &str| if name.is_empty() { part.to_owned() } else { format!("{name}.{part}") };
    match value {
        Value::Table(table) => {
            table.iter().for_each(|(key, value)| flatten(value, join(key), out));
        }
        Value::Array(list) if !list.is_empty() => {
            let numbered = list.iter().enumerate();
            numbered.for_each(|(i, value)| flatten(value, join(&(i + 1).to_string()), out));
        }
        leaf => out.push((name, single(leaf))),
    }
}

fn differences(a: &Value, b: &Value, name: String, out: &mut Vec<(String, String, String)>) {
    let (mut left, mut right) = (Vec::new(), Vec::new());
    flatten(a, name.clone(), &mut left);
    flatten(b, name, &mut right);
    for (name, value) in &left {
        let other = right.iter().find(|(n, _)| n == name).map_or("nothing", |(_, v)| v);
        if other != value {
            out.push((name.clone(), value.clone(), other.to_owned()));
        }
    }
    for (name, value) in right.iter().filter(|(n, _)| !left.iter().any(|(m, _)| m == n)) {
        out.push((name.clone(), "nothing".into(), value.clone()));
    }
}
