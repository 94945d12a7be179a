//! A session looked at, and looked at again with other recordings where the first look left some of them out.
//!
//! What is found in the recordings that are fitted is checked on those that are held out. Some of these may hold a gap that the others
//! do not show: then they are fitted and others held out, and the look stands that closes more of the session. A second look
//! takes as long as the first one, and is not taken where something outside the catalogue accounts for what the first one came to on
//! every axis with a gap.

use host_sim::rig::Rig;
use indicatif::ProgressBar;

use crate::Error;
use crate::fitting::guess::Ranges;
use crate::fitting::knobs::EffectRef;
use crate::judge::accept::{self, AxisGapSize};
use crate::judge::strangers::Masked;
use crate::judge::{steady, strangers};
use crate::locate;
use crate::search::found::{self, Found};
use crate::search::wander::DRIFT;
use crate::session::energy::Energies;
use crate::session::floor::Kind;
use crate::session::scene::{Channel, Scene, Stack, TOLERANCE, Wanted};
use crate::session::split::{hold_out_last_third_of_gap, split, split_blocks};

/// What a reader is told where whole recordings that are held out would check nothing.
const LAST_THIRD: &str = "The gap, or that of an axis, shows in few recordings, each of them unlike the others: the end of every recording, \
                          with a third of its gap, was held out instead of whole recordings.";
/// ... and where a drift or the phase of a hum goes without a period in them, which nothing foretells.
const IN_BLOCKS: &str = "What goes without a period is known between two times of measurement, but not beyond: two fifths of every recording, in \
                               two parts, were held out instead of whole recordings.";

/// Share of the session's gap that causes without a period may leave for no other look to be taken.
const MOSTLY_OPEN: f64 = 0.1;

/// What all looks at a session share.
pub(crate) struct Looks<'a> {
    /// Rig as given.
    pub rig: &'a Rig,
    /// Catalogue.
    pub effects: &'a [EffectRef],
    /// What the session offers.
    pub ranges: &'a Ranges,
    /// Names that are not to be used, of strangers as well.
    pub exclude: &'a [String],
}

/// A look at a session.
#[derive(Clone)]
pub(crate) struct Looked {
    /// The session, with recordings held out.
    pub scene: Scene,
    /// What the rig as given leaves of it.
    pub nominal: Nominal,
    /// What a search found, before it is judged.
    pub found: Option<Found>,
}

/// What of a look is believed.
#[derive(Default)]
pub(crate) struct Judged {
    /// Causes that stand.
    pub found: Option<Found>,
    /// What passed for causes.
    pub masked: Option<Masked>,
    /// Whether causes were believed before something else was seen to pass for them.
    pub was_found: bool,
    /// What a reader should know about it.
    pub notes: Vec<String>,
}

impl Looks<'_> {
    /// Search a session whose recordings hold `excess`, and once more with others held out where that promises more. `by_blocks`: parts
    /// of recordings are held out instead of whole ones.
    pub(crate) fn run(
        &self,
        mut first: Looked,
        excess: &[f64],
        by_blocks: bool,
        bar: &ProgressBar,
    ) -> Result<(Looked, Judged), Error> {
        bar.set_message("screening the catalogue");
        let session = (&first.scene, self.rig);
        let gaps = &first.nominal.gaps;
        first.found = found::search(session, self.effects, self.ranges, bar, gaps, None)?;
        let missed = match &first.found {
            Some(f) => f.missed.clone(),
            // Nothing found in the fitted ones: the gap may be in the others alone.
            None => found::with_gap(&first.scene, excess, |c| c.held_out),
        };
        let mut notes = Vec::new();
        let believed = self.believed(&first, first.found.clone(), &mut notes)?;
        let open = self.left_open(&first, believed.as_ref())?;
        let judged = self.judge(&first, believed, notes)?;
        // What a stranger accounts for is the same with other recordings.
        let gaps = &first.nominal.gaps;
        let accounts_for_all = |masked: &Masked| {
            (0..gaps.len()).all(|axis| !gaps[axis].counts || masked.axes.contains(&axis))
        };
        let is_strange = judged.masked.as_ref().is_some_and(accounts_for_all);
        let wanders = first.found.as_ref().is_some_and(|found| !found.wandering().is_empty());
        let is_open = open > MOSTLY_OPEN * Self::gap_of(&first);
        let looks_again = (!missed.is_empty() || wanders && is_open)
            && first.scene.tracks.len() >= 3
            && !by_blocks;
        if is_strange || !looks_again || !self.fits(&first, excess)? || first.scene.work.is_spent()
        {
            return Ok((first, judged));
        }
        bar.set_message("looking again with other recordings");
        let second = self.second(&first, &missed, excess, bar)?;
        let mut notes = Vec::new();
        if second.scene.channels.len() > first.scene.channels.len() {
            let note = if wanders { IN_BLOCKS } else { LAST_THIRD };
            notes.push(note.into());
        }
        // The look stands that closes more of the whole session where it is believed.
        let believed = self.believed(&second, second.found.clone(), &mut notes)?;
        if self.left_open(&second, believed.as_ref())? < open {
            let judged = self.judge(&second, believed, notes)?;
            return Ok((second, judged));
        }
        Ok((first, judged))
    }

    /// A look for nothing but a gauge that drifts as chance has it, where no cause was believed; `None` if none is now.
    pub(crate) fn for_chance_drift(
        &self,
        looked: &Looked,
        excess: &[f64],
        by_blocks: bool,
        bar: &ProgressBar,
    ) -> Result<Option<(Looked, Judged)>, Error> {
        let drifts: Vec<EffectRef> =
            self.effects.iter().copied().filter(|e| e.info().name == DRIFT).collect();
        if drifts.is_empty() {
            return Ok(None);
        }
        let ranges = Ranges { chance_drift: true, ..self.ranges.clone() };
        let looks = Looks { effects: &drifts, ranges: &ranges, ..*self };
        let again = Looked { found: None, ..looked.clone() };
        let (drifting, believed) = looks.run(again, excess, by_blocks, bar)?;
        Ok(believed.found.is_some().then_some((drifting, believed)))
    }

    /// Whether a look accounts for the recordings that it was fitted to: what does not will not do better with others.
    fn fits(&self, look: &Looked, excess: &[f64]) -> Result<bool, Error> {
        let Looked { scene, nominal, found } = look;
        Ok(match found {
            Some(f) => {
                let after = scene.raw(&f.model.fit.rig, |_| true)?;
                let fitted = |c: &Channel| !c.held_out;
                let axes = self.rig.axes.len();
                let shrink = Energies::new(scene, &nominal.raw, &after, &fitted).gap(axes);
                accept::names(shrink.closed)
            }
            // Next to nothing of the gap shows in them.
            None => share_of_gap(scene, excess, |c| !c.held_out) < NEXT_TO_NOTHING,
        })
    }

    /// Another look, with recordings that the first one missed among the fitted ones.
    fn second(
        &self,
        first: &Looked,
        missed: &[usize],
        excess: &[f64],
        bar: &ProgressBar,
    ) -> Result<Looked, Error> {
        let mut scene = first.scene.clone();
        split(&mut scene, missed);
        let mut nominal = first.nominal.clone();
        let wanders = first.found.as_ref().is_some_and(|found| !found.wandering().is_empty());
        let is_unchecked =
            |axis: usize| nominal.gaps[axis].counts && !is_held_out_on(&scene, excess, axis);
        if wanders || !can_contradict(&scene, excess) || (0..self.rig.axes.len()).any(is_unchecked)
        {
            if wanders {
                split_blocks(&mut scene);
            } else {
                hold_out_last_third_of_gap(&mut scene, &nominal.raw);
            }
            scene.set_aside_memory(self.rig)?;
            let white = scene.residuals_at(self.rig, Wanted::ALL, |_| true)?;
            nominal = Nominal::new(&mut scene, self.rig, &white)?;
        }
        let session = (&scene, self.rig);
        let known = first.found.as_ref();
        let found = found::search(session, self.effects, self.ranges, bar, &nominal.gaps, known)?;
        Ok(Looked { scene, nominal, found })
    }

    /// What closes enough of a look to be believed.
    fn believed(
        &self,
        look: &Looked,
        found: Option<Found>,
        notes: &mut Vec<String>,
    ) -> Result<Option<Found>, Error> {
        let Some(found) = found else { return Ok(None) };
        let Looked { scene, nominal, .. } = look;
        found::abstain(self.rig, scene, found, &nominal.raw, &nominal.gaps, notes)
    }

    /// Energy of the whole session that the rig as given leaves.
    fn gap_of(look: &Looked) -> f64 {
        let raw = &look.nominal.raw;
        Energies::new(&look.scene, raw, raw, &|_: &Channel| true).excess().0
    }

    /// Energy of the whole session that causes leave; no causes, no end of it.
    fn left_open(&self, look: &Looked, found: Option<&Found>) -> Result<f64, Error> {
        let Some(found) = found else { return Ok(f64::INFINITY) };
        let everything = |_: &Channel| true;
        let after = look.scene.raw(&found.model.fit.rig, everything)?;
        Ok(Energies::new(&look.scene, &look.nominal.raw, &after, &everything).excess().1)
    }

    /// Take back what passes for causes.
    fn judge(
        &self,
        look: &Looked,
        believed: Option<Found>,
        mut notes: Vec<String>,
    ) -> Result<Judged, Error> {
        let Some(mut known) = believed else { return Ok(Judged { notes, ..Judged::default() }) };
        let Looked { scene, nominal, .. } = look;
        let masked = match strangers::unmask(scene, self.rig, self.exclude, &mut known)? {
            None => steady::unmask(scene, self.rig, &nominal.raw, &mut known)?,
            masked => masked,
        };
        let found = match (&masked, known.model.terms.is_empty()) {
            (None, _) => Some(known),
            (Some(_), true) => None,
            // What stays has to stand by itself.
            (Some(_), false) => self.believed(look, Some(known), &mut notes)?,
        };
        Ok(Judged { found, masked, was_found: true, notes })
    }
}

/// Share of the session's gap that the recordings held out must have to contradict a model.
const TO_CONTRADICT: f64 = 0.002;

/// Share of the session's gap in the fitted recordings below which a search that finds nothing there says nothing of the others: what
/// integrators differ by on edges is as much.
const NEXT_TO_NOTHING: f64 = 0.02;

/// Whether what is held out shows enough of the gap: what closes nothing there because there is nothing has not been checked.
pub(crate) fn can_contradict(scene: &Scene, excess: &[f64]) -> bool {
    let any = !found::with_gap(scene, excess, |c| c.held_out).is_empty();
    any && share_of_gap(scene, excess, |c| c.held_out) > TO_CONTRADICT
}

/// Whether some recording that is held out has a gap of its own on an axis, if any has.
fn is_held_out_on(scene: &Scene, excess: &[f64], axis: usize) -> bool {
    found::with_gap(scene, excess, |c| c.axis == axis).is_empty()
        || !found::with_gap(scene, excess, |c| c.axis == axis && c.held_out).is_empty()
}

/// Share of the gap of all positions that some channels hold.
fn share_of_gap(scene: &Scene, excess: &[f64], include: impl Fn(&Channel) -> bool) -> f64 {
    let of = |include: &dyn Fn(&Channel) -> bool| -> f64 {
        let positions = scene.channels.iter().zip(excess).filter(|(c, _)| c.kind == Kind::Position);
        positions.filter(|(c, _)| include(c)).map(|(_, excess)| excess).sum()
    };
    of(&include) / of(&|_| true).max(f64::MIN_POSITIVE)
}

/// What the rig as given leaves of the session.
#[derive(Clone)]
pub(crate) struct Nominal {
    /// Residuals over time.
    pub raw: Stack,
    /// Where they lie.
    pub cuts: locate::Cuts,
    /// Whether they are there before the stack, where a monitor tells.
    pub electrical: Vec<Option<bool>>,
    /// How large they are, axis by axis.
    pub gaps: Vec<AxisGapSize>,
}

impl Nominal {
    /// From residuals weighed by the noise alone; the channels are weighed for a search after that.
    pub(crate) fn new(scene: &mut Scene, rig: &Rig, white: &Stack) -> Result<Self, Error> {
        let raw = scene.raw(rig, |_| true)?;
        let cuts = locate::cuts(scene, &raw, white);
        let electrical = locate::electrical(scene, white);
        let gaps = accept::gaps(scene, white);
        for (channel, row) in scene.channels.iter_mut().zip(white) {
            if let Some(row) = row {
                let power = channel.band_power(row);
                channel.weigh(&power, TOLERANCE);
            }
        }
        Ok(Self { raw, cuts, electrical, gaps })
    }

    pub(crate) fn any_gap(&self) -> bool {
        self.gaps.iter().any(|g| g.counts)
    }
}
