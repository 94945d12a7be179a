//! The whole diagnosis, step by step: intake, floor, locate, split, search, accept, refit, report.

use host_sim::effects::{Effect, Place, catalogue};
use host_sim::rig::Rig;
use indicatif::{ProgressBar, ProgressStyle};
use recording::Session;

use crate::diagnosis::{Diagnosis, RecordingGap, Role, Verdict};
use crate::fitting::knobs::EffectRef;
use crate::judge::accept::{self, AxisGapSize};
use crate::judge::causes::causes_of;
use crate::judge::slow;
use crate::judge::strangers::Masked;
use crate::locate;
use crate::looks::{self, Judged, Looked, Looks, Nominal};
use crate::picture;
use crate::search::found::{self, Found};
use crate::session::dead::{self, Dead};
use crate::session::energy::Energies;
use crate::session::floor::Kind;
use crate::session::memory::interruptions;
use crate::session::scene::{Channel, Scene, Stack, Wanted};
use crate::session::split::{blocks_note, hold_out_last_third_of_gap, split};
use crate::session::{intake, past};
use crate::{Error, Options, rest};

/// What `flexstage diagnose` writes.
pub struct Outcome {
    /// `diagnosis.json`.
    pub diagnosis: Diagnosis,
    /// `rig.toml`: the rig with what was found added.
    pub rig: Rig,
    /// `report.html`.
    pub report: report::Report,
}

/// Everything that the report draws from.
pub struct Findings<'a> {
    /// Session and channels.
    pub scene: &'a Scene,
    /// Rig as given.
    pub nominal: &'a Rig,
    /// Rig with the causes.
    pub rig: &'a Rig,
    /// Raw residuals of the nominal rig.
    pub before: &'a Stack,
    /// Raw residuals of the corrected rig.
    pub after: &'a Stack,
    /// Cuts of the nominal gap.
    pub cuts: &'a locate::Cuts,
    /// Cuts of what is left.
    pub cuts_after: &'a locate::Cuts,
    /// Gap (nm, held out) after each cause is added in turn.
    pub staircase: &'a [(String, f64)],
    /// The answer.
    pub diagnosis: &'a Diagnosis,
    /// Names and scores of what else was tried.
    pub tried: &'a [(String, f64)],
}

pub(crate) fn bar(options: &Options) -> ProgressBar {
    if !options.progress {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new_spinner();
    if let Ok(style) =
        ProgressStyle::with_template("{spinner} {msg} ({pos} simulations, {elapsed})")
    {
        bar.set_style(style);
    }
    bar
}

/// Diagnose a session.
pub fn diagnose(rig: &Rig, session: &Session, options: &Options) -> Result<Outcome, Error> {
    let bar = bar(options);
    bar.set_message("reading the recordings");
    let (tracks, passed_over) = intake::tracks(rig, session)?;
    let mut scene = Scene::new(rig, tracks);
    bar.set_message("measuring the noise");
    let mut notes = passed_over;
    notes.extend(integrity_notes(&scene, rig));
    split(&mut scene, &[]);
    scene.set_aside_memory(rig)?;
    let everything = |_: &Channel| true;
    // Weights of noise alone first: they tell how large the gap is in each band.
    let mut white = scene.residuals_at(rig, Wanted::ALL, everything)?;
    let mut excess = found::excess(&scene, &white);
    let gapped = found::with_gap(&scene, &excess, |_| true);
    let mut by_blocks = false;
    if !gapped.is_empty() && !looks::can_contradict(&scene, &excess) {
        // What is held out must be able to contradict.
        if let [_, _, ..] = gapped[..] {
            let of_quietest = |c: &&mut Channel| c.track == gapped[0];
            scene.channels.iter_mut().filter(of_quietest).for_each(|c| c.held_out = true);
        } else if scene.channels.iter().any(|c| c.held_out && c.track != gapped[0]) {
            by_blocks = true;
            let raw = scene.raw(rig, everything)?;
            hold_out_last_third_of_gap(&mut scene, &raw);
            scene.set_aside_memory(rig)?;
            white = scene.residuals_at(rig, Wanted::ALL, everything)?;
            excess = found::excess(&scene, &white);
            notes.push(format!(
                "The gap shows in {} alone: the end of every recording, with a third of its gap, was held out instead of whole recordings.",
                scene.tracks[gapped[0]].file
            ));
        }
    }
    let nominal = Nominal::new(&mut scene, rig, &white)?;
    let effects: Vec<EffectRef> = catalogue()
        .iter()
        .copied()
        .filter(|e: &&'static dyn Effect| !options.exclude.iter().any(|x| x == e.info().name))
        .collect();
    let ranges = crate::fitting::guess::ranges(&scene, rig, &nominal.raw)?;
    if nominal.any_gap() && !by_blocks {
        notes.extend(blocks_note(&scene));
    }
    let mut looked = Looked { scene, nominal, found: None };
    let mut judged = Judged::default();
    let dead = if rig.output_map.is_none() {
        dead::axes(&looked.scene, &looked.nominal.raw)
    } else {
        Vec::new()
    };
    notes.extend(dead.iter().map(Dead::note));
    if looked.nominal.any_gap() && dead.is_empty() {
        past::tell(&mut looked.scene, rig, &effects, &ranges)?;
        let looks = Looks { rig, effects: &effects, ranges: &ranges, exclude: &options.exclude };
        (looked, judged) = looks.run(looked, &excess, by_blocks, &bar)?;
        if !judged.was_found {
            bar.set_message("looking for a gauge that drifts as chance has it");
            if let Some(drifting) = looks.for_chance_drift(&looked, &excess, by_blocks, &bar)? {
                (looked, judged) = drifting;
            }
        }
    }
    notes.append(&mut judged.notes);
    if let Some(passes) = looked.scene.work.ended_after() {
        notes.push(format!(
            "The search ended before everything was tried, after what amounts to {passes} simulations of the session: what is named is the best \
             until then."
        ));
    }
    let Judged { mut found, mut masked, was_found, .. } = judged;
    let Looked { scene, nominal, .. } = looked;
    if !was_found && rig.axes.len() > 1 && nominal.any_gap() && dead.is_empty() {
        bar.set_message("looking at slow motion alone");
        let asked = (&ranges, &options.exclude[..]);
        (found, masked) = slow::cross_axis(&scene, rig, &effects, asked, &bar)?;
    }

    bar.set_message("writing the answer");
    let outcome = answer(rig, &scene, &nominal, found, masked, notes)?;
    bar.finish_and_clear();
    Ok(outcome)
}

fn answer(
    rig: &Rig,
    scene: &Scene,
    nominal: &Nominal,
    found: Option<Found>,
    masked: Option<Masked>,
    mut notes: Vec<String>,
) -> Result<Outcome, Error> {
    let Nominal { raw: raw_before, cuts, electrical, gaps } = nominal;
    let axes = rig.axes.len();
    let everything = |_: &Channel| true;
    let held = |c: &Channel| c.held_out;
    let any_gap = gaps.iter().any(|g| g.counts);
    let mut final_rig = rig.clone();
    let mut raw_after = raw_before.clone();
    let mut honest_after = raw_before.clone();
    // What is promised is what a replay of single files gives: of the recording before it knows what the lead-in tells.
    let mut replayed_after = raw_before.clone();
    if let Some(f) = &found {
        raw_after = scene.raw(&f.whole.fit.rig, everything)?;
        honest_after = scene.raw(&f.model.fit.rig, everything)?;
        let fitted = &f.model.fit.rig;
        replayed_after = scene.file_by_file(fitted)?.raw(fitted, everything)?;
        final_rig = f.whole.fit.rig.clone();
    }
    let in_order = Energies::new(scene, raw_before, &honest_after, &held).gap(axes);
    let gap = Energies::new(scene, raw_before, &replayed_after, &held).gap(axes);
    let mut causes = Vec::new();
    let mut claimed = Vec::new();
    let mut staircase = Vec::new();
    if let Some(f) = &found {
        notes.extend(quiet_notes(f, gaps));
        notes.extend(hidden_notes(f));
        let (mut list, claims, stairs) = causes_of(rig, scene, f, raw_before, &honest_after)?;
        let mut order: Vec<usize> = (0..list.len()).collect();
        order.sort_by(|&a, &b| list[b].closes.total_cmp(&list[a].closes));
        for cause in &mut list {
            cause.closes *= gap.closed.clamp(0.0, 1.0);
        }
        causes = order.iter().map(|&k| list[k].clone()).collect();
        claimed = order.iter().map(|&k| claims[k].clone()).collect();
        staircase = stairs;
    }
    let white_after = scene.residuals_at(&final_rig, Wanted::ALL, everything)?;
    let left = accept::gaps(scene, &white_after);
    let band = found.as_ref().and_then(|f| f.band.clone());
    let verdict = match (any_gap, &band) {
        (false, _) => Verdict::NoGap,
        (true, Some(_)) => Verdict::PartlyExplained,
        (true, None) => accept::verdict(in_order.closed, causes.len(), &left),
    };
    let location = if verdict == Verdict::NoGap {
        Vec::new()
    } else {
        locate::locations(
            scene,
            cuts,
            &raw_after,
            (electrical, masked.as_ref()),
            (&causes, &claimed),
        )
    };
    let recordings = (0..scene.tracks.len())
        .map(|track| {
            let every = Energies::new(scene, raw_before, &replayed_after, &everything);
            let (before_nm, after_nm) = every.of_track(track);
            let role = if scene.channels.iter().any(|c| c.track == track && !c.held_out) {
                Role::Fit
            } else {
                Role::HeldOut
            };
            RecordingGap { file: scene.tracks[track].file.clone(), role, before_nm, after_nm }
        })
        .collect();
    let next_experiment = if causes.iter().any(|c| !c.indistinguishable_from.is_empty()) {
        found.as_ref().and_then(|f| f.standings.next.clone())
    } else {
        None
    };
    let mut in_order_nm = None;
    let past_known = scene.tracks.iter().any(|t| !t.past.is_empty());
    if past_known && causes.iter().any(|c| c.effect == "creep") {
        notes.push(if scene.runs_on {
            in_order_nm = Some(in_order.after_nm);
            format!(
                "Creep runs on from one recording to the next here. The figures are those of a replay of single files, which knows \
                 of it what the part before settle_s tells; taken in the session's order the same rig leaves {:.1} nm of held-out recordings.",
                in_order.after_nm
            )
        } else {
            "Every recording begins with a stack that no longer creeps from the one before.".into()
        });
    }
    let wandering = found.as_ref().map_or_else(Vec::new, Found::wandering);
    if !wandering.is_empty() {
        notes.push(format!(
            "{} goes without a period here. The rig file has it as it was in this session: what it will be in recordings made later, no model \
             tells, and the gap of those will not close by as much.",
            wandering.join(" and ")
        ));
    }
    let is_open = matches!(verdict, Verdict::Unexplained | Verdict::PartlyExplained);
    let rest = is_open.then(|| rest::rest(scene, raw_before, &honest_after));
    let diagnosis = Diagnosis {
        verdict,
        gap,
        location,
        causes,
        next_experiment,
        recordings,
        band,
        in_order_nm,
        looks_like: masked.map(|m| m.words),
        rest,
        notes,
    };
    let cuts_after = locate::cuts(scene, &raw_after, &white_after);
    let tried = found.as_ref().map(|f| f.tried.clone()).unwrap_or_default();
    let report = picture::report(&Findings {
        scene,
        nominal: rig,
        rig: &final_rig,
        before: raw_before,
        after: &raw_after,
        cuts,
        cuts_after: &cuts_after,
        staircase: &staircase,
        diagnosis: &diagnosis,
        tried: &tried,
    });
    Ok(Outcome { diagnosis, rig: final_rig, report })
}

/// What a reader should know about causes on axes that have no gap of their own.
fn quiet_notes(found: &Found, gaps: &[AxisGapSize]) -> Vec<String> {
    let named =
        found.model.terms.iter().flat_map(|term| term.places.iter().map(move |p| (term, *p)));
    let quiet = named.filter_map(|(term, place)| match place {
        Place::Axis(axis) if !gaps[axis].counts => Some((term.name(), axis)),
        _ => None,
    });
    let note = |(name, axis): (&str, usize)| {
        format!(
            "Axis {}: {name} is named there because other axes have it alike. What these recordings show of it on this axis is more than noise, \
             but less than what counts as a gap.",
            axis + 1
        )
    };
    quiet.map(note).collect()
}

/// What a reader should know about causes that others hide on an axis.
fn hidden_notes(found: &Found) -> Vec<String> {
    let is_named = |(name, axis): &&(&str, usize)| {
        let mut terms = found.model.terms.iter();
        terms.any(|term| term.name() == *name && term.axes().contains(axis))
    };
    let note = |(name, axis): &(&str, usize)| {
        format!(
            "Axis {}: {name} is named there because other axes have it alike. These recordings agree as well without it on this axis, where what else is \
             named takes it in.",
            axis + 1
        )
    };
    found.hidden.iter().filter(is_named).map(note).collect()
}

/// What a reader of the report should know about the recordings themselves.
fn integrity_notes(scene: &Scene, rig: &Rig) -> Vec<String> {
    let mut notes = Vec::new();
    for track in scene.tracks.iter() {
        if track.lost > 0 {
            let long = interruptions(track).first().map_or(String::new(), |hole| {
                format!(
                    " It was interrupted for {:.2} s: what a stack that turned meanwhile would remember of it was set aside.",
                    hole.len() as f64 / track.rate_hz
                )
            });
            notes.push(format!(
                "{}: {} ticks lost; the drive was held over them and nothing scored there.{long}",
                track.file, track.lost
            ));
        }
    }
    let follow: Vec<&str> =
        scene.tracks.iter().filter(|t| t.closed_loop).map(|t| t.file.as_str()).collect();
    if !follow.is_empty() {
        let which = if follow.len() == scene.tracks.len() && follow.len() > 1 {
            format!("All {} recordings", follow.len())
        } else {
            follow.join(", ")
        };
        notes.push(format!(
            "{which}: recorded with a setpoint; if the loop was closed, its noise is in the drive."
        ));
    }
    for (axis, noise) in scene.position_noise.iter().enumerate() {
        let stated = Kind::Position.stated(rig, axis);
        match noise {
            None => notes.push(format!("Axis {} was not measured.", axis + 1)),
            Some(n) if stated > 0.0 && (n.sigma > 2.0 * stated || n.sigma < 0.5 * stated) => notes
                .push(format!(
                    "Axis {}: the gauge noise measured is {:.2} nm, the rig file states {:.2} nm.",
                    axis + 1,
                    n.sigma * 1.0e3,
                    stated * 1.0e3
                )),
            Some(_) => {}
        }
    }
    if scene.monitor_noise.iter().all(Option::is_none) {
        notes.push("No amplifier monitor was recorded: drive and amplifier can be told from the stack only by their signature.".into());
    }
    notes
}
