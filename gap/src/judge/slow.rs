//! Axes that move with each other's drive: a search in slow motion alone, when nothing accounts for the whole gap.
//!
//! A mechanism with resonances that nobody modelled hides what is plain below them: that an axis follows its neighbours.
//! The fast bands are left out, step by step, until couplings between axes (with a delay or lag beside them) close what is left
//! on held-out recordings. Only couplings are named this way: the neighbours' drives are independent evidence, which no unknown
//! fault of an axis itself imitates. A gauge that tilts as the neighbours move does: strangers are asked for here as elsewhere.

use host_sim::effects::Scope;
use host_sim::rig::Rig;
use indicatif::ProgressBar;

use crate::Error;
use crate::diagnosis::Band;
use crate::fitting::guess::Ranges;
use crate::fitting::knobs::EffectRef;
use crate::fitting::model::Term;
use crate::judge::strangers::{self, Masked};
use crate::judge::{accept, ambiguity, monitors};
use crate::search::found::{Found, refit};
use crate::search::screen::Gain;
use crate::search::select::Search;
use crate::session::energy::Energies;
use crate::session::floor::Kind;
use crate::session::pyramid::{MOST_LEFT_OUT, low_pass, share_kept};
use crate::session::scene::{Channel, Scene, Stack};

/// Linear effects that may stand beside a coupling.
const BESIDE: [&str; 4] =
    ["drive-delay", "amplifier-bandwidth", "sensor-bandwidth", "viscoelasticity"];

/// Share of the gap that some coupling has to promise, by a straight line, for a search.
const LEAST_PROMISE: f64 = 0.02;

/// Couplings that account for slow motion, or what passed for them.
pub(crate) fn cross_axis(
    scene: &Scene,
    rig: &Rig,
    effects: &[EffectRef],
    (ranges, exclude): (&Ranges, &[String]),
    bar: &ProgressBar,
) -> Result<(Option<Found>, Option<Masked>), Error> {
    let couples = |e: &EffectRef| e.info().scope != Scope::Axis;
    let few: Vec<EffectRef> =
        effects.iter().copied().filter(|e| couples(e) || BESIDE.contains(&e.info().name)).collect();
    let everything = |_: &Channel| true;
    let raw = scene.raw(rig, everything)?;
    for left_out in 1..=MOST_LEFT_OUT {
        let mut slow = scene.clone();
        slow.leave_out(left_out);
        let fitted = |c: &Channel| !c.held_out;
        let tick = || bar.inc(1);
        let mut search = Search::new(&slow, rig, &few, ranges, &fitted, &tick)?;
        let gains = search.screen.test(&slow, &search.base, None);
        let promised = |gains: &[Gain]| gains.iter().map(|g| g.gain).sum::<f64>();
        let couplings = few.iter().zip(&gains).filter(|(e, _)| couples(e));
        let promise = couplings.map(|(_, gains)| promised(gains)).fold(0.0, f64::max);
        if promise < LEAST_PROMISE * search.gap {
            continue;
        }
        let Some(model) = search.run()? else { continue };
        if !model.terms.iter().any(|t| couples(&t.effect)) {
            continue;
        }
        let after = scene.raw(&model.fit.rig, everything)?;
        let band = band(scene, &raw, &after, left_out);
        if band.before_nm < 2.0 * band.floor_nm || !accept::explains(band.closed()) {
            continue;
        }
        let per_axis = Energies::new(scene, &raw, &after, &everything).gap(rig.axes.len()).per_axis;
        let missing = monitors::contradicted(rig, scene, [&raw, &after], &per_axis);
        let reached: Vec<usize> = model.terms.iter().flat_map(Term::axes).collect();
        if reached.iter().any(|&axis| missing[axis].is_some()) {
            continue;
        }
        let standings = ambiguity::standings(&search, &model);
        let whole = refit(&slow, rig, &model)?;
        let mut found = Found {
            model,
            whole,
            standings,
            tried: Vec::new(),
            missed: Vec::new(),
            band: Some(band),
            hidden: Vec::new(),
        };
        let masked = strangers::unmask(&slow, rig, exclude, &mut found)?;
        return Ok((masked.is_none().then_some(found), masked));
    }
    Ok((None, None))
}

/// Gap of held-out positions in the bands that are left.
pub(crate) fn band(scene: &Scene, before: &Stack, after: &Stack, left_out: usize) -> Band {
    let mut sums = [0.0; 3];
    let mut samples = 0.0;
    let mut rate_hz: f64 = 0.0;
    let share = share_kept(left_out);
    for (c, channel) in scene.channels.iter().enumerate() {
        let (Some(b), Some(a)) = (&before[c], &after[c]) else { continue };
        if channel.kind != Kind::Position || !channel.held_out {
            continue;
        }
        rate_hz = rate_hz.max(scene.tracks[channel.track].rate_hz);
        let nm2 = (channel.sigma * 1.0e3).powi(2);
        samples += channel.samples();
        for (sum, row) in sums.iter_mut().zip([b, a]) {
            let slow = low_pass(row, share);
            *sum += nm2 * slow.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>();
        }
        sums[2] += nm2
            * (left_out..channel.levels.count())
                .map(|l| channel.unrepeatable[l] * channel.levels.range(l).len() as f64)
                .sum::<f64>();
    }
    let [before_nm, after_nm, floor_nm] = sums.map(|sum| (sum / f64::max(samples, 1.0)).sqrt());
    Band { below_hz: 0.5 * rate_hz * share, before_nm, after_nm, floor_nm }
}
