//! Step response figures: delay, rise, overshoot, settling, steady error.
//!
//! Levels are estimated from the record (median before the step, median of the last fifth), so that noise and a
//! steady error do not move the 10 % and 90 % crossings. Definitions as in IEEE Std 181-2011 (rise 10-90 %, settling
//! into a band around the final level for good).

use serde::Serialize;

/// Figures of one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepMetrics {
    /// Level before the step, micrometres.
    pub from_um: f64,
    /// Level at the end, micrometres.
    pub to_um: f64,
    /// Time from the step of the reference to 10 % of the way, seconds.
    pub delay_s: f64,
    /// Time from 10 % to 90 %, seconds.
    pub rise_s: f64,
    /// Highest excursion beyond the final level, per cent of the step.
    pub overshoot_percent: f64,
    /// Time after which the position stays within 2 % of the final level (or the noise, if that is wider), seconds
    /// from the reference's step; `None` when it does not settle within the record.
    pub settling_s: Option<f64>,
    /// Half width of the settling band used, nanometres.
    pub band_nm: f64,
    /// Reference minus final level, nanometres; `None` without a reference.
    pub steady_error_nm: Option<f64>,
}

fn median(values: &[f32]) -> Option<f64> {
    let mut sorted: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    sorted.get(sorted.len() / 2).map(|&v| f64::from(v))
}

/// Figures of a step that happens at sample `at`.
///
/// Returns `None` when there are fewer than 5 samples before or 25 after, or no step above six times the noise.
pub fn step_metrics(
    position_um: &[f32],
    at: usize,
    sample_rate_hz: f64,
    reference_after_um: Option<f64>,
) -> Option<StepMetrics> {
    if at < 5 || position_um.len() < at + 25 {
        return None;
    }
    let before = &position_um[..at];
    let after = &position_um[at..];
    let tail = &after[after.len() * 4 / 5..];
    let (from, to) = (median(before)?, median(tail)?);
    let span = to - from;
    // Noise as the scatter of first differences in the tail: blind to slow creep.
    let differences: Vec<f32> = tail.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let noise = median(&differences)? / 0.954;
    if span.abs() < 6.0 * noise || span == 0.0 {
        return None;
    }
    let level = |x: f32| (f64::from(x) - from) / span;
    // Crossing time with interpolation between samples, in samples from the step.
    let crossing = |share: f64| -> Option<f64> {
        let i = after.iter().position(|&x| level(x) >= share)?;
        if i == 0 {
            return Some(0.0);
        }
        let (a, b) = (level(after[i - 1]), level(after[i]));
        Some(i as f64 - 1.0 + if b > a { (share - a) / (b - a) } else { 1.0 })
    };
    let (ten, ninety) = (crossing(0.1)?, crossing(0.9)?);
    let peak = after.iter().map(|&x| level(x)).filter(|l| l.is_finite()).fold(0.0, f64::max);
    let noise_share = 3.0 * noise / span.abs();
    let band = 0.02f64.max(noise_share);
    let last_outside = after.iter().rposition(|&x| (level(x) - 1.0).abs() > band);
    let settling = match last_outside {
        None => Some(0.0),
        // Still outside in the last fifth: not settled.
        Some(i) if i >= after.len() * 4 / 5 => None,
        Some(i) => Some((i + 1) as f64 / sample_rate_hz),
    };
    Some(StepMetrics {
        from_um: from,
        to_um: to,
        delay_s: ten / sample_rate_hz,
        rise_s: (ninety - ten) / sample_rate_hz,
        overshoot_percent: (100.0 * (peak - 1.0 - noise_share)).max(0.0),
        settling_s: settling,
        band_nm: band * span.abs() * 1e3,
        steady_error_nm: reference_after_um.map(|r| (r - to) * 1e3),
    })
}

/// First sample at which a reference jumps by at least `threshold_um` within one tick.
pub fn find_step(reference_um: &[f32], threshold_um: f32) -> Option<usize> {
    reference_um.windows(2).position(|w| (w[1] - w[0]).abs() >= threshold_um).map(|i| i + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_order_lag() {
        let fs = 10_000.0;
        let tau = 5e-3;
        let y: Vec<f32> = (0..2000)
            .map(|i| {
                if i < 100 {
                    1.0
                } else {
                    (3.0 - 2.0 * (-((i - 100) as f64) / fs / tau).exp()) as f32
                }
            })
            .collect();
        let m = step_metrics(&y, 100, fs, Some(3.01)).unwrap();
        assert!((m.rise_s - tau * 9f64.ln()).abs() < 2e-5, "{m:?}");
        assert!((m.settling_s.unwrap() - tau * 50f64.ln()).abs() < 2e-4, "{m:?}");
        assert_eq!(m.overshoot_percent, 0.0);
        assert!((m.steady_error_nm.unwrap() - 10.0).abs() < 0.1);
    }

    #[test]
    fn second_order_overshoot_both_ways() {
        let fs = 10_000.0;
        let (wn, zeta) = (500.0f64, 0.4f64);
        let wd = wn * (1.0 - zeta * zeta).sqrt();
        for sign in [1.0, -1.0] {
            let y: Vec<f32> = (0..3000)
                .map(|i| {
                    if i < 50 {
                        return 0.0;
                    }
                    let t = (i - 50) as f64 / fs;
                    let ring = (wd * t).cos() + zeta * wn / wd * (wd * t).sin();
                    (sign * (1.0 - (-zeta * wn * t).exp() * ring)) as f32
                })
                .collect();
            let m = step_metrics(&y, 50, fs, None).unwrap();
            let theory = 100.0 * (-std::f64::consts::PI * zeta / (1.0 - zeta * zeta).sqrt()).exp();
            assert!((m.overshoot_percent - theory).abs() < 0.2, "{m:?} {theory}");
        }
    }

    #[test]
    fn no_step_is_no_answer() {
        assert_eq!(step_metrics(&[1.0; 500], 100, 1e4, None), None);
        let drifting: Vec<f32> = (0..1000).map(|i| i as f32 * 1e-3).collect();
        let m = step_metrics(&drifting, 100, 1e4, None);
        assert!(m.is_none_or(|m| m.settling_s.is_none()));
    }
}
