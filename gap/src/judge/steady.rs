//! Time constants that are no constants.
//!
//! A dead time that wanders, a link that is late now and then: the catalogue's constant of the same kind closes some of such a gap, and
//! its name would send the owner to look for a fixed lag. So each time constant that is named is let differ from one short window of time
//! to the next, and what that alone takes off shows whether there was one constant. Over the truth generator, where the dead time wanders
//! 0.54 to 0.84 of what is left goes, and that is 12 to 35 % of the gap's energy; a lag of second order leaves a per cent of the gap, of
//! which up to 0.4 goes (its best constant depends on the frequencies of a recording).

use host_sim::effects::Effect;
use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::knobs::{Knob, Target, axes_seen};
use crate::judge::strangers::Masked;
use crate::search::found::{Found, keep};
use crate::search::worth::WORTH_ABSOLUTE;
use crate::session::floor::Kind;
use crate::session::scene::{Channel, Scene, Stack};

/// Effects that are one time, by the parameter that is it.
const TIMES: [(&str, &str); 3] = [
    ("drive-delay", "delay_s"),
    ("sensor-bandwidth", "time_constant_s"),
    ("amplifier-bandwidth", "ratio"),
];
/// Lengths of the windows, s.
const WINDOWS_S: [f64; 3] = [0.0125, 0.05, 0.2];
/// Share of the nominal gap's energy on its axes that a cause has to leave before this is asked.
const OPEN: f64 = 0.02;
/// Share of what is left on the axes of a cause that its wandering has to account for.
const MOST: f64 = 0.45;
/// Step of the derivative, in the natural scale of the parameter.
const STEP: f64 = 0.05;

/// Take back time constants that are not the same at all times; the one that wanders most is told of.
pub(crate) fn unmask(
    scene: &Scene,
    rig: &Rig,
    raw_before: &Stack,
    found: &mut Found,
) -> Result<Option<Masked>, Error> {
    let model = &found.model;
    let positions = |c: &Channel| c.kind == Kind::Position;
    let times = |name: &str| TIMES.iter().any(|(effect, _)| *effect == name);
    if !model.terms.iter().any(|term| times(term.name())) {
        return Ok(None);
    }
    let left = scene.raw(&model.fit.rig, positions)?;
    let mut worst: Option<(usize, f64)> = None;
    let mut gone: Vec<&'static str> = Vec::new();
    for (t, term) in model.terms.iter().enumerate().filter(|(_, term)| times(term.name())) {
        let mut windows = [0.0; WINDOWS_S.len()];
        let mut axes = 0;
        for (nth, knob) in model.knob_range(t).zip(&model.fit.knobs[model.knob_range(t)]) {
            let Some((effect, place)) = time_of(knob) else { continue };
            let seen = axes_seen(rig, effect, place);
            axes |= seen;
            let mut values = model.fit.values.clone();
            let step = if knob.log { STEP * values[nth] } else { STEP * knob.scale };
            values[nth] += step;
            let later = crate::fitting::fit::rig_with(rig, &model.fit.knobs, &values)?;
            let here = |c: &Channel| positions(c) && seen >> c.axis & 1 == 1;
            let moved = scene.raw(&later, here)?;
            for (c, channel) in scene.channels.iter().enumerate() {
                let (Some(left), Some(moved)) = (&left[c], &moved[c]) else { continue };
                let rate_hz = scene.tracks[channel.track].rate_hz;
                for (saved, window_s) in windows.iter_mut().zip(WINDOWS_S) {
                    let length = ((window_s * rate_hz) as usize).max(16);
                    let pieces = left.chunks(length).zip(moved.chunks(length));
                    *saved += pieces.map(|(left, moved)| saved_by_change(left, moved)).sum::<f64>();
                }
            }
        }
        let open = excess(scene, &left, axes);
        if open < WORTH_ABSOLUTE || open < OPEN * excess(scene, raw_before, axes) {
            continue;
        }
        let share = windows.into_iter().fold(0.0, f64::max) / open;
        if share > MOST {
            gone.push(term.name());
            if worst.is_none_or(|(_, most)| share > most) {
                worst = Some((t, share));
            }
        }
    }
    let Some((t, share)) = worst else { return Ok(None) };
    let term = &model.terms[t];
    let masked = Masked {
        stage: term.effect.info().stage.name(),
        axes: term.axes(),
        words: format!(
            "{} would account for some of the gap, but it changes in time: a constant that may differ from one twentieth of a second to the \
             next takes off another {:.0} % of what is left. The catalogue has constants only, so no cause is named for it.",
            term.name(),
            100.0 * share.min(1.0)
        ),
    };
    keep(rig, found, |_, alone| !gone.contains(&alone.name()))?;
    Ok(Some(masked))
}

/// Effect and place of a knob that is a time.
fn time_of(knob: &Knob) -> Option<(&'static dyn Effect, host_sim::effects::Place)> {
    let Target::Effect { effect, place, index } = &knob.target else { return None };
    let info = effect.info();
    let is_time = TIMES.contains(&(info.name, info.parameters[*index].name));
    is_time.then_some((*effect, *place))
}

/// Energy beyond noise of the positions of some axes, noise variances.
fn excess(scene: &Scene, stack: &Stack, axes: u32) -> f64 {
    let rows = stack.iter().zip(&scene.channels);
    rows.filter(|(_, c)| c.kind == Kind::Position && axes >> c.axis & 1 == 1)
        .filter_map(|(row, c)| Some((row.as_ref()?, c)))
        .map(|(row, c)| row.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() - c.samples())
        .sum()
}

/// Energy beyond chance that a change of the parameter takes off one window of a residual. `moved` is the residual after a small change.
/// What is constant or grows evenly over the window does not count on either side: a drift, or a loop's branch, follows any derivative
/// over a short time.
fn saved_by_change(left: &[f32], moved: &[f32]) -> f64 {
    let left = without_trend(left.iter().map(|&x| f64::from(x)));
    let change = without_trend(moved.iter().map(|&x| f64::from(x)));
    let change: Vec<f64> = change.iter().zip(&left).map(|(moved, left)| moved - left).collect();
    let norm: f64 = change.iter().map(|x| x * x).sum();
    if norm < 1.0e-9 {
        return 0.0;
    }
    left.iter().zip(&change).map(|(x, y)| x * y).sum::<f64>().powi(2) / norm - 1.0
}

/// Values without their mean and slope.
fn without_trend(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    let count = values.len() as f64;
    let middle = (count - 1.0) / 2.0;
    let mean = values.iter().sum::<f64>() / count;
    let spread = count * (count * count - 1.0) / 12.0;
    let rise = values.iter().enumerate().map(|(i, x)| (i as f64 - middle) * x).sum::<f64>();
    let slope = if spread > 0.0 { rise / spread } else { 0.0 };
    for (i, x) in values.iter_mut().enumerate() {
        *x -= mean + slope * (i as f64 - middle);
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNT: usize = 500;

    fn row(of: impl Fn(f64) -> f64) -> Vec<f32> {
        (0..COUNT).map(|i| of(i as f64 / COUNT as f64) as f32).collect()
    }

    fn wave(turns: f64) -> f64 {
        (9.0 * std::f64::consts::TAU * turns).sin()
    }

    #[test]
    fn what_the_parameter_makes_is_saved_whole() {
        let left = row(|t| 3.0 * wave(t) + 5.0 + 7.0 * t);
        let moved = row(|t| 3.0 * wave(t) + 5.0 + 7.0 * t + 0.01 * wave(t));
        let energy = 9.0 * COUNT as f64 / 2.0;
        let saved = saved_by_change(&left, &moved);
        assert!((saved / energy - 1.0).abs() < 0.01, "{saved} of {energy}");
    }

    #[test]
    fn a_trend_is_no_sign_of_a_change() {
        let left = row(|t| 5.0 + 70.0 * t);
        let moved = row(|t| 5.0 + 71.0 * t + 0.01 * wave(t));
        let saved = saved_by_change(&left, &moved);
        assert!(saved.abs() < 2.0, "{saved}");
    }
}
