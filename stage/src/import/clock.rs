//! Sample rate and sample numbers from a column of times.
//!
//! Times are printed with few digits and jitter: one step says little about the rate, and a long step is lost samples only where
//! it is long by a whole period. So a clock is led along the rows, like a phase-locked loop, and every row gets the tick that is
//! nearest to it; the rate is that of the straight line through all of them. What cannot be told is said, not guessed.

use anyhow::{bail, ensure};

/// Steps of one tick, in multiples of the median step, by which the period is first guessed.
const ONE_TICK: std::ops::RangeInclusive<f64> = 0.45..=1.55;
/// How much of a row's deviation the led clock takes over.
const PHASE: f64 = 0.1;
/// Over longer steps (ticks) a first period may miscount: rows before and after say more about it.
const FAR: f64 = 20.0;
/// Rms deviation from the ticks, in periods, up to which they are told apart (an even spread between two ticks has 0.29).
const MOST_JITTER: f64 = 0.2;
/// Share of rows beyond which "lost samples" between times printed no finer than the period are more likely rounding.
const MANY: f64 = 0.25;
/// Rounding moves a time by up to half the last digit (and a little).
const ROUNDED: f64 = 0.501;
/// So many lost samples do not lie as evenly as rounding lays them.
const FEW: usize = 3;

/// Where the times come from, for errors.
pub(super) struct Source<'a> {
    /// The table.
    pub file: &'a std::path::Path,
    /// Its column.
    pub column: &'a str,
    /// Number of its first row that is taken, from 1.
    pub first_row: usize,
}

/// Sample rate (Hz) and sample numbers (from 0) of times (s).
pub(super) fn clock(times_s: &[f64], source: &Source) -> anyhow::Result<(f64, Vec<u64>)> {
    let place = format!("{}: column `{}`", source.file.display(), source.column);
    ensure!(times_s.len() > 1, "{place}: expected times of at least two rows, found one row");
    let row = |index: usize| index + source.first_row;
    if let Some(at) = times_s.iter().position(|time| !time.is_finite()) {
        bail!("{place}, row {}: expected a time in seconds, found {}", row(at), times_s[at]);
    }
    if let Some(at) = times_s.windows(2).position(|pair| pair[1] <= pair[0]) {
        let (before, found) = (times_s[at], times_s[at + 1]);
        let why = if before == found {
            "; if they are printed with too few digits, write more, or give --rate instead of --time where no sample is lost"
        } else {
            ""
        };
        bail!(
            "{place}, row {}: expected times that increase, more than {before} s, found {found} s{why}",
            row(at + 1)
        );
    }
    let since: Vec<f64> = times_s.iter().map(|time| time - times_s[0]).collect();
    let largest = times_s[0].abs().max(times_s[times_s.len() - 1].abs());
    let printed_s = resolution_s(&since, largest);
    let mut line = Line { start_s: 0.0, period_s: guess_s(&since) };
    // Led three times: with the period of the stretches between long holes, and then with that of all rows.
    let mut ticks = line.follow(&since);
    for far in [FAR, f64::INFINITY] {
        line = Line::through(&ticks, &since, far);
        ticks = line.follow(&since);
    }
    if printed_s > 0.9 * line.period_s {
        // The ticks are those of the last printed digit, and any time lies on one of them.
        let long = ticks.windows(2).filter(|pair| pair[1] - pair[0] > 1.0).count();
        let rows: Vec<f64> = (0..since.len()).map(|row| row as f64).collect();
        let even = Line::through(&rows, &since, f64::INFINITY);
        if long >= FEW && even.most(&rows, &since) * even.period_s <= ROUNDED * printed_s {
            (line, ticks) = (even, rows);
        } else if long as f64 > MANY * since.len() as f64 {
            bail!(
                "{place}: expected times finer than the steps between them, found {printed_s} s for steps of about {:.3e} s: too coarse to \
                 tell lost samples from rounding; write more digits, or give --rate instead of --time where no sample is lost",
                since[since.len() - 1] / (since.len() - 1) as f64
            );
        }
    }
    let advice =
        "a sample clock is expected; give --rate instead of --time where no sample is lost";
    if let Some(at) = ticks.windows(2).position(|pair| pair[1] <= pair[0]) {
        bail!(
            "{place}, row {}: {} s is as near to the tick of the row before as to its own, at about {:.6} Hz: too irregular to tell lost \
             samples from jitter; {advice}",
            row(at + 1),
            times_s[at + 1],
            1.0 / line.period_s
        );
    }
    let jitter = line.rms(&ticks, &since);
    let as_rounded = line.most(&ticks, &since) * line.period_s <= ROUNDED * printed_s;
    if jitter > MOST_JITTER && !as_rounded {
        bail!(
            "{place}: times deviate from ticks of about {:.6} Hz by {:.0} % of a period (rms): too irregular to tell lost samples from \
             jitter; {advice}",
            1.0 / line.period_s,
            100.0 * jitter
        );
    }
    let span = ticks[ticks.len() - 1] - ticks[0];
    ensure!(
        span <= 100.0 * since.len() as f64 + 1.0e6,
        "{place}: {} rows at about {:.6} Hz span {:.3e} s: expected a sample clock, found more than 99 % of its ticks lost",
        since.len(),
        1.0 / line.period_s,
        since[since.len() - 1]
    );
    let ticks: Vec<u64> = ticks.iter().map(|tick| (tick - ticks[0]) as u64).collect();
    Ok((plain(1.0 / line.period_s, jitter, since.len()), ticks))
}

/// Ticks and the times at which they fall.
#[derive(Clone, Copy)]
struct Line {
    /// Time of tick 0, s.
    start_s: f64,
    /// From tick to tick, s.
    period_s: f64,
}

impl Line {
    /// Least squares; the period from the stretches between steps of more than `far` ticks.
    fn through(ticks: &[f64], since: &[f64], far: f64) -> Self {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (mut along, mut square, mut from) = (0.0, 0.0, 0);
        for to in 1..=ticks.len() {
            if to < ticks.len() && ticks[to] - ticks[to - 1] <= far {
                continue;
            }
            let (ticks, since) = (&ticks[from..to], &since[from..to]);
            let (tick, time) = (mean(ticks), mean(since));
            for (k, t) in ticks.iter().zip(since) {
                along += (k - tick) * (t - time);
                square += (k - tick).powi(2);
            }
            from = to;
        }
        if square == 0.0 && far.is_finite() {
            return Self::through(ticks, since, f64::INFINITY);
        }
        let period_s = along / square;
        Self { start_s: mean(since) - mean(ticks) * period_s, period_s }
    }

    /// The tick of every row, by a clock that starts on this line and is led along the rows.
    fn follow(self, since: &[f64]) -> Vec<f64> {
        let period = self.period_s;
        let mut tick = (-self.start_s / period).round();
        let mut expected = self.start_s + tick * period;
        let mut ticks = Vec::with_capacity(since.len());
        for time in since {
            let steps = ((time - expected) / period).round();
            tick += steps;
            expected += steps * period;
            let ahead = time - expected;
            expected += PHASE * ahead;
            ticks.push(tick);
        }
        ticks
    }

    /// Deviations of the rows, in periods.
    fn deviations(self, ticks: &[f64], since: &[f64]) -> impl Iterator<Item = f64> {
        ticks.iter().zip(since).map(move |(k, t)| (t - self.start_s) / self.period_s - k)
    }

    fn most(self, ticks: &[f64], since: &[f64]) -> f64 {
        self.deviations(ticks, since).fold(0.0, |most, ahead| most.max(ahead.abs()))
    }

    fn rms(self, ticks: &[f64], since: &[f64]) -> f64 {
        let energy: f64 = self.deviations(ticks, since).map(|ahead| ahead * ahead).sum();
        (energy / ticks.len() as f64).sqrt()
    }
}

/// A first period, s: the mean of the steps that are about as long as most.
fn guess_s(since: &[f64]) -> f64 {
    let steps = || since.windows(2).map(|pair| pair[1] - pair[0]);
    let mut sorted: Vec<f64> = steps().collect();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[(sorted.len() - 1) / 2];
    let (sum, count) = steps()
        .filter(|step| ONE_TICK.contains(&(step / median)))
        .fold((0.0, 0.0), |(sum, count), step| (sum + step, count + 1.0));
    sum / count
}

/// The power of ten that all times are multiples of, s; 0 where they have more digits than that can tell.
fn resolution_s(since: &[f64], largest_s: f64) -> f64 {
    for decimals in 0..=9 {
        let scale = 10.0_f64.powi(decimals);
        let slack = 1.0e-3 + 4.0 * f64::EPSILON * largest_s * scale;
        let whole = |time: &f64| (time * scale - (time * scale).round()).abs() <= slack;
        if slack < 0.1 && since.iter().all(whole) {
            return 1.0 / scale;
        }
    }
    0.0
}

/// The rate with the fewest digits that the times do not tell from this one, Hz.
fn plain(rate_hz: f64, jitter: f64, rows: usize) -> f64 {
    // Four standard errors of the line's slope.
    let slack = (4.0 * 12.0_f64.sqrt() * jitter / (rows as f64).powf(1.5)).clamp(1.0e-12, 1.0e-4);
    (0..=9)
        .filter_map(|digits| format!("{rate_hz:.digits$e}").parse::<f64>().ok())
        .find(|plain| (plain / rate_hz - 1.0).abs() <= slack)
        .unwrap_or(rate_hz)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    use rand::{RngExt, SeedableRng, rngs::SmallRng};

    fn of(times: &[f64]) -> anyhow::Result<(f64, Vec<u64>)> {
        let source = Source { file: Path::new("a.csv"), column: "time", first_row: 1 };
        clock(times, &source)
    }

    fn rounded(time: f64, decimals: usize) -> f64 {
        format!("{time:.decimals$}").parse().unwrap()
    }

    /// Rows 0 to 19999 without those that are lost.
    fn kept(lost: &[std::ops::Range<u64>]) -> Vec<u64> {
        (0..20_000).filter(|tick| lost.iter().all(|hole| !hole.contains(tick))).collect()
    }

    #[test]
    fn few_digits_and_jitter_are_no_lost_samples() {
        let mut rng = SmallRng::seed_from_u64(3);
        let mut gauss = move || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        for lost in [&[][..], &[700..701, 9000..9017, 12_000..16_000]] {
            let rows = kept(lost);
            for (rate, decimals, jitter) in [
                (3000.0, 4, 0.0),
                (3000.0, 5, 0.02),
                (1000.0, 7, 0.1),
                (1000.0, 3, 0.0),
                (128.0, 4, 0.05),
                (5600.0, 4, 0.0),
                (10_000.0, 12, 0.0),
                (0.5, 2, 0.0),
            ] {
                let epoch = if rate == 3000.0 { 1.7e9 } else { 0.0 };
                let times: Vec<f64> = rows
                    .iter()
                    .map(|tick| epoch + rounded((*tick as f64 + jitter * gauss()) / rate, decimals))
                    .collect();
                let (found, ticks) = of(&times).unwrap();
                let place = format!("{rate} Hz, {decimals} decimals, jitter {jitter}: {found}");
                assert!((found / rate - 1.0).abs() < 1e-6, "{place}");
                let false_ones = ticks.iter().zip(&rows).filter(|(a, b)| a != b).count();
                assert_eq!(false_ones, 0, "{place}");
            }
        }
    }

    /// Between rows less than two last digits apart even steps are rounding, and uneven ones may be anything.
    #[test]
    fn digits_as_coarse_as_the_samples() {
        let times = |rate: f64, rows: &[u64]| -> Vec<f64> {
            rows.iter().map(|tick| rounded(*tick as f64 / rate, 4)).collect()
        };
        for rate in [9000.0, 8000.0, 7000.0] {
            let (found, ticks) = of(&times(rate, &kept(&[]))).unwrap();
            assert_eq!((found, ticks[19_999]), (rate, 19_999));
        }
        let said = of(&times(7000.0, &kept(&[500..600, 650..700]))).unwrap_err().to_string();
        assert!(said.contains("column `time`") && said.contains("too coarse"), "{said}");
        let said = of(&times(20_000.0, &kept(&[]))).unwrap_err().to_string();
        assert!(said.contains("column `time`, row") && said.contains("digits"), "{said}");
        // On the digits' own grid samples may be lost.
        let (found, ticks) =
            of(&times(10_000.0, &kept(&[5..6, 80..90, 400..401, 417..418]))).unwrap();
        assert_eq!((found, ticks[19_986]), (10_000.0, 19_999));
    }

    #[test]
    fn what_is_no_clock_is_said_of_the_times() {
        let mut rng = SmallRng::seed_from_u64(3);
        let wild: Vec<f64> =
            (0..3000).map(|row| f64::from(row) + 0.9 * rng.random::<f64>()).collect();
        let jump: Vec<f64> =
            (0..100).map(|row| if row < 99 { f64::from(row) } else { 1e12 }).collect();
        for (times, words) in [
            (&[0.0, 0.1, 0.05, 0.2][..], "row 3: expected times that increase"),
            (&[0.0, 0.1, f64::NAN, 0.2], "row 3: expected a time"),
            (&[0.0, 0.0, 0.0], "row 2"),
            (&[0.5], "two rows"),
            (&wild, "too irregular"),
            (&jump, "99 %"),
        ] {
            let said = of(times).unwrap_err().to_string();
            assert!(said.starts_with("a.csv: column `time`") && said.contains(words), "{said}");
            assert!(!said.contains('\n') && !said.contains("tick`"), "{said}");
        }
    }
}
