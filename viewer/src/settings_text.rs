//! Settings by dotted name: `axes.0.feedback.proportional_v_per_um`. One list for the editor, the file comparison and messages.

use flexstage::Settings;
use toml::Value;

/// Leaves of the settings: dotted name and value as text, in the order of the structure.
pub fn leaves(settings: &Settings) -> Vec<(String, String)> {
    let mut out = Vec::new();
    if let Ok(value) = Value::try_from(settings) {
        walk(&value, String::new(), &mut out);
    }
    out
}

fn walk(value: &Value, name: String, out: &mut Vec<(String, String)>) {
    let join =
        |part: &str| if name.is_empty() { part.to_owned() } else { format!("{name}.{part}") };
    match value {
        Value::Table(table) => {
            for (key, value) in table {
                walk(value, join(key), out);
            }
        }
        Value::Array(list) if !list.is_empty() => {
            for (i, value) in list.iter().enumerate() {
                walk(value, join(&i.to_string()), out);
            }
        }
        leaf => out.push((name, text(leaf))),
    }
}

/// Single-precision numbers without the digits that only double precision shows.
fn text(value: &Value) -> String {
    match value {
        Value::Float(x) => (*x as f32).to_string(),
        other => other.to_string(),
    }
}

/// What differs: name, value of `a`, value of `b`.
pub fn differences(a: &Settings, b: &Settings) -> Vec<(String, String, String)> {
    let (a, b) = (leaves(a), leaves(b));
    let value = |list: &[(String, String)], name: &str| {
        list.iter().find(|(n, _)| n == name).map_or("-".to_owned(), |(_, v)| v.clone())
    };
    let mut out: Vec<(String, String, String)> = a
        .iter()
        .map(|(name, left)| (name.clone(), left.clone(), value(&b, name)))
        .filter(|(_, left, right)| left != right)
        .collect();
    out.extend(
        b.iter()
            .filter(|(name, _)| !a.iter().any(|(n, _)| n == name))
            .map(|(name, right)| (name.clone(), "-".to_owned(), right.clone())),
    );
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_changed_gain_is_one_line() {
        let a = Settings::default();
        let mut b = a.clone();
        b.axes[1].feedback.proportional_v_per_um += 1.5;
        let lines = differences(&a, &b);
        assert_eq!(lines.len(), 1);
        assert_eq!(lines[0].0, "axes.1.feedback.proportional_v_per_um");
        assert!(leaves(&a).len() > 60);
    }
}
