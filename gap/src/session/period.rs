//! Whether a drive repeats with the period that its recording states.
//!
//! What differs from period to period is taken for noise that no model can explain. A wrong period makes noise of the motion itself: hundreds of
//! nanometres of "noise", beside which no gap is one.

use host_sim::rig::Rig;
use recording::Recording;

/// Part of a period that shows whether it is one, and samples.
const LEAST_PART: f64 = 0.2;
const FEWEST: usize = 32;
/// What the drive may differ by from period to period, as a share of what it moves, rms,
const DIFFERS: f64 = 1.0e-3;
/// and in units of the gauge noise at rest: a closed loop drives what it reads.
const NOISES: f64 = 3.0;

/// What a drive says of the period that its recording states.
pub(super) enum Told {
    /// Nothing: none is stated, or the drive stands still, or too little of it is there.
    Nothing,
    /// It repeats.
    Repeats,
    /// It does not; what a reader should know of that.
    Otherwise(String),
}

/// What a drive (V, on the uniform clock, of every axis) says of the stated period. `is_there`: which samples were recorded; `settle`: those of
/// the lead-in.
pub(super) fn told(
    rig: &Rig,
    recording: &Recording,
    drive_v: &[Vec<f64>],
    is_there: &[bool],
    settle: usize,
) -> Told {
    let Some(period_s) = recording.meta.period_s else { return Told::Nothing };
    let samples = (period_s * recording.meta.sample_rate_hz).round() as usize;
    let n = is_there.len();
    // What comes before the first whole period, an approach or a lead-in, need not repeat.
    let from = n.saturating_sub(samples).max(settle + samples);
    let from = if from + FEWEST > n && n >= 2 * samples {
        n - samples + (LEAST_PART * samples as f64) as usize
    } else {
        from
    };
    let pairs = || {
        let both = move |k: &usize| is_there[*k] && is_there[*k - samples];
        (from..n).filter(both)
    };
    // Too little of it to be told, one way or the other.
    if samples == 0 || pairs().count() < FEWEST {
        return Told::Nothing;
    }
    let mut moves = false;
    let otherwise = drive_v.iter().zip(&rig.axes).enumerate().find_map(|(number, (v, axis))| {
        let many = pairs().count() as f64;
        let rms = |of: &dyn Fn(usize) -> f64| {
            (pairs().map(|k| of(k).powi(2)).sum::<f64>() / many).sqrt()
        };
        let mean = pairs().map(|k| v[k]).sum::<f64>() / many;
        let moves_v = rms(&|k| v[k] - mean);
        let differs_v = rms(&|k| v[k] - v[k - samples]);
        moves |= moves_v > 0.0 || differs_v > 0.0;
        let noise_v = axis.sensor.noise_rms_m / axis.rest_m_per_v().abs();
        (differs_v > DIFFERS * moves_v + NOISES * noise_v).then(|| {
            format!(
                "period_s = {period_s} s was ignored: the drive of axis {} does not repeat with it. From one period to the next it differs by \
                 {differs_v:.3} V rms, where it moves by {moves_v:.3} V rms. Correct or remove period_s.",
                number + 1
            )
        })
    });
    match otherwise {
        Some(note) => Told::Otherwise(note),
        None if moves => Told::Repeats,
        None => Told::Nothing,
    }
}

/// The same of all recordings of a session of which it has to be said, with their file names.
pub(super) fn note(said: &[(&str, String)]) -> Option<String> {
    let [(file, words), others @ ..] = said else { return None };
    let others: Vec<&str> = others.iter().map(|(file, _)| *file).collect();
    Some(match others.len() {
        0 => format!("{file}: {words}"),
        _ => format!("{file}: {words} The same goes for that of {}.", others.join(", ")),
    })
}
