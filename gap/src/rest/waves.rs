//! Recordings as Fourier lines: drives, readings and residuals of every block.

use std::collections::BTreeMap;

use realfft::RealFftPlanner;
use realfft::num_complex::Complex;

use crate::session::floor::Kind;
use crate::session::intake::Track;
use crate::session::scene::{Scene, Stack};

/// Fourier lines of one signal, bin by bin.
pub(super) type Line = Vec<Complex<f64>>;

/// One period, or one windowed stretch, of a recording. Readings in nm, drives in volts, all over samples of the block.
pub(super) struct Block {
    /// Held out from the fits.
    pub held_out: bool,
    /// Group of recordings of one drive level.
    pub level: usize,
    /// Drive of every axis.
    pub drive: Vec<Line>,
    /// Measured position of every axis.
    pub measured: Vec<Line>,
    /// Measured minus simulated with the rig as given.
    pub before: Vec<Line>,
    /// Measured minus simulated with the causes.
    pub after: Vec<Line>,
    /// Variance of a line of every axis that does not repeat, nm^2.
    pub noise: Vec<Vec<f64>>,
}

/// A session in the frequency domain.
#[derive(Default)]
pub(super) struct Waves {
    /// Distance of two lines, Hz.
    pub step_hz: f64,
    /// Whole periods without a window: lines do not leak.
    pub periodic: bool,
    /// Sum of squared lines to mean square of samples.
    pub to_mean_square: f64,
    /// Root mean square of the moving drives of each level, volts, rising.
    pub levels_v: Vec<f64>,
    /// The blocks.
    pub blocks: Vec<Block>,
}

/// Longest block of a recording that is not periodic.
const STRETCH: usize = 4096;
/// Shortest block worth a spectrum.
const SHORTEST: usize = 512;
/// Levels are apart when the drives differ by this factor.
const NEXT_LEVEL: f64 = 1.25;

/// Scored stretch of a recording in which every axis was measured: its track, range and channels by axis.
struct Stretch {
    track: usize,
    range: std::ops::Range<usize>,
    channels: Vec<usize>,
    drive_rms_v: f64,
}

/// Blocks of all recordings that share the commonest rate and period. Empty where there are none.
pub(super) fn waves(scene: &Scene, before: &Stack, after: &Stack) -> Waves {
    let mut kinds: BTreeMap<(u64, usize, bool), Vec<Stretch>> = BTreeMap::new();
    for stretch in stretches(scene) {
        let track = &scene.tracks[stretch.track];
        let period = track.period_s.map(|s| (s * track.rate_hz).round() as usize);
        let (len, periodic) = match period {
            Some(n) if (SHORTEST..=stretch.range.len()).contains(&n) => (n, true),
            _ => (STRETCH, false),
        };
        if stretch.range.len() >= len {
            kinds.entry((track.rate_hz.to_bits(), len, periodic)).or_default().push(stretch);
        }
    }
    let samples = |of: &Vec<Stretch>| of.iter().map(|s| s.range.len()).sum::<usize>();
    let Some(((rate, len, periodic), mut of)) = kinds.into_iter().max_by_key(|(_, of)| samples(of))
    else {
        return Waves::default();
    };
    of.sort_by(|a, b| a.drive_rms_v.total_cmp(&b.drive_rms_v));
    let mut waves = Waves {
        step_hz: f64::from_bits(rate) / len as f64,
        periodic,
        // One-sided; the Hann window keeps 3/8 of the power.
        to_mean_square: 2.0 / (len as f64).powi(2) / if periodic { 1.0 } else { 0.375 },
        ..Waves::default()
    };
    let mut lowest_v = f64::NAN;
    let mut rms: Vec<Vec<f64>> = Vec::new();
    for stretch in of {
        if lowest_v.is_nan() || stretch.drive_rms_v > NEXT_LEVEL * lowest_v {
            lowest_v = stretch.drive_rms_v;
            rms.push(Vec::new());
        }
        if let Some(of_level) = rms.last_mut() {
            of_level.push(stretch.drive_rms_v);
        }
        blocks(scene, (before, after), &stretch, (len, periodic), rms.len() - 1, &mut waves.blocks);
    }
    waves.levels_v = rms.iter().map(|v| v.iter().sum::<f64>() / v.len() as f64).collect();
    waves
}

fn stretches(scene: &Scene) -> Vec<Stretch> {
    let axes = scene.position_noise.len();
    let mut by_range: BTreeMap<(usize, usize, usize), Vec<Option<usize>>> = BTreeMap::new();
    for (c, channel) in scene.channels.iter().enumerate() {
        if channel.kind == Kind::Position {
            let key = (channel.track, channel.range.start, channel.range.end);
            by_range.entry(key).or_insert_with(|| vec![None; axes])[channel.axis] = Some(c);
        }
    }
    by_range
        .into_iter()
        .filter_map(|((track, start, end), channels)| {
            let channels: Vec<usize> = channels.into_iter().collect::<Option<_>>()?;
            let range = start..end;
            let drive_rms_v = drive_rms_v(&scene.tracks[track], &range);
            (drive_rms_v > 0.0).then_some(Stretch { track, range, channels, drive_rms_v })
        })
        .collect()
}

/// Root mean square over samples and moving drives of what they differ by from their means, volts.
pub(super) fn drive_rms_v(track: &Track, range: &std::ops::Range<usize>) -> f64 {
    let drives = track.drive_v.iter().map(|drive| deviation(&drive[range.clone()]));
    let moving: Vec<f64> = drives.filter(|&v| v > 0.0).collect();
    (moving.iter().map(|v| v * v).sum::<f64>() / moving.len().max(1) as f64).sqrt()
}

fn deviation(series: &[f64]) -> f64 {
    let mean = series.iter().sum::<f64>() / series.len().max(1) as f64;
    (series.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / series.len().max(1) as f64).sqrt()
}

fn blocks(
    scene: &Scene,
    (before, after): (&Stack, &Stack),
    stretch: &Stretch,
    (len, periodic): (usize, bool),
    level: usize,
    out: &mut Vec<Block>,
) {
    let track = &scene.tracks[stretch.track];
    let total = stretch.range.len();
    // The last period has settled best; stretches overlap by half.
    let first = if periodic { total - len } else { 0 };
    for start in (first..=total - len).step_by(len / 2) {
        let here = start..start + len;
        let absolute = stretch.range.start + start..stretch.range.start + start + len;
        if !track.present[absolute.clone()].iter().all(|&p| p) {
            continue;
        }
        let of_row = |stack: &Stack, c: usize| -> Option<Line> {
            let nm = scene.channels[c].sigma * 1.0e3;
            let row = &stack[c].as_ref()?[here.clone()];
            line(row.iter().map(|&x| f64::from(x) * nm), periodic)
        };
        let of_rows = |stack: &Stack| -> Option<Vec<Line>> {
            stretch.channels.iter().map(|&c| of_row(stack, c)).collect()
        };
        let of_position = |axis: usize, at: std::ops::Range<usize>| -> Option<Line> {
            let position = track.position_um[axis].as_ref()?;
            line(position[at].iter().map(|&um| f64::from(um) * 1.0e3), periodic)
        };
        let axes = 0..stretch.channels.len();
        let drive: Option<Vec<Line>> = track
            .drive_v
            .iter()
            .map(|v| line(v[absolute.clone()].iter().copied(), periodic))
            .collect();
        let measured: Option<Vec<Line>> =
            axes.clone().map(|axis| of_position(axis, absolute.clone())).collect();
        let noise = axes
            .map(|axis| {
                let white = (scene.channels[stretch.channels[axis]].sigma * 1.0e3).powi(2)
                    * len as f64
                    * if periodic { 1.0 } else { 0.375 };
                let earlier = (periodic && absolute.start >= len)
                    .then(|| of_position(axis, absolute.start - len..absolute.start))
                    .flatten();
                match (earlier, measured.as_ref()) {
                    // Half of the energy of the difference of two periods.
                    (Some(earlier), Some(measured)) => earlier
                        .iter()
                        .zip(&measured[axis])
                        .map(|(a, b)| 0.5 * (a - b).norm_sqr())
                        .collect(),
                    _ => vec![white; len / 2 + 1],
                }
            })
            .collect();
        let (Some(drive), Some(measured), Some(before), Some(after)) =
            (drive, measured, of_rows(before), of_rows(after))
        else {
            continue;
        };
        let held_out = scene.channels[stretch.channels[0]].held_out;
        out.push(Block { held_out, level, drive, measured, before, after, noise });
    }
}

/// Fourier lines of a series without its mean.
fn line(series: impl Iterator<Item = f64>, periodic: bool) -> Option<Line> {
    let mut input: Vec<f64> = series.collect();
    let n = input.len() as f64;
    let mean = input.iter().sum::<f64>() / n;
    for (i, x) in input.iter_mut().enumerate() {
        let hann = 0.5 - 0.5 * (std::f64::consts::TAU * i as f64 / n).cos();
        *x = (*x - mean) * if periodic { 1.0 } else { hann };
    }
    let fft = RealFftPlanner::<f64>::new().plan_fft_forward(input.len());
    let mut output = fft.make_output_vec();
    fft.process(&mut input, &mut output).ok()?;
    Some(output)
}
