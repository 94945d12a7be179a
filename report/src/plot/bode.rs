//! Frequency responses: magnitude over phase, with coherence where it was measured.

use plotters::prelude::SeriesLabelPosition;

use super::{Figure, LinePlot, Series, draw};

/// Magnitude (dB) and phase (degrees) over logarithmic frequency (Hz).
#[derive(Clone)]
pub struct Bode {
    magnitude: LinePlot,
    phase: LinePlot,
    coherence: Option<LinePlot>,
}

impl Bode {
    /// An empty Bode plot.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            // Most responses fall: what is free is at the lower left. One legend serves all strips.
            magnitude: LinePlot::new(title)
                .y("magnitude (dB)")
                .log_x()
                .legend(Some(SeriesLabelPosition::LowerLeft)),
            phase: LinePlot::new("").x("frequency (Hz)").y("phase (deg)").log_x().legend(None),
            coherence: None,
        }
    }

    /// One response: frequencies (Hz), magnitudes (dB), phases (degrees, unwrapped by the caller), of equal length.
    #[must_use]
    pub fn trace(self, name: &str, freq_hz: &[f64], mag_db: &[f64], phase_deg: &[f64]) -> Self {
        self.draw(Series::line, name, freq_hz, mag_db, phase_deg)
    }

    /// The same, dashed: a prediction over what was measured, which shows through it where both agree.
    #[must_use]
    pub fn dashed(self, name: &str, freq_hz: &[f64], mag_db: &[f64], phase_deg: &[f64]) -> Self {
        self.draw(Series::dashed, name, freq_hz, mag_db, phase_deg)
    }

    fn draw(
        mut self,
        style: fn(String, Vec<(f64, f64)>) -> Series,
        name: &str,
        freq_hz: &[f64],
        mag_db: &[f64],
        phase_deg: &[f64],
    ) -> Self {
        let pairs = |values: &[f64]| freq_hz.iter().copied().zip(values.iter().copied()).collect();
        self.magnitude = self.magnitude.series(style(name.to_owned(), pairs(mag_db)));
        self.phase = self.phase.series(style(name.to_owned(), pairs(phase_deg)));
        self
    }

    /// Coherence (0 to 1) over frequency (Hz), drawn as a third strip.
    #[must_use]
    pub fn coherence(mut self, freq_hz: &[f64], coherence: &[f64]) -> Self {
        let points = freq_hz.iter().copied().zip(coherence.iter().copied()).collect();
        let plot = LinePlot::new("").x("frequency (Hz)").y("coherence").log_x().y_range(0.0, 1.05);
        self.coherence = Some(plot.series(Series::line("coherence", points)));
        self.phase = self.phase.x("");
        self
    }

    /// A vertical mark in all strips, e.g. the crossover.
    #[must_use]
    pub fn mark(mut self, freq_hz: f64, label: &str) -> Self {
        self.magnitude = self.magnitude.vline(freq_hz, label);
        self.phase = self.phase.vline(freq_hz, "");
        self
    }
}

impl Figure for Bode {
    fn svg(&self) -> String {
        let height = if self.coherence.is_some() { 720 } else { 560 };
        draw((720, height), |area| {
            let (top, rest) = area.split_vertically(300);
            let (middle, bottom) = rest.split_vertically(260);
            self.magnitude.paint(&top)?;
            self.phase.paint(&middle)?;
            self.coherence.as_ref().map_or(Ok(()), |plot| plot.paint(&bottom))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn has_three_strips_when_coherence_is_known() {
        let freq = [1.0, 10.0, 100.0];
        let bode = Bode::new("loop")
            .trace("measured", &freq, &[0.0, -1.0, -20.0], &[0.0, -20.0, -150.0])
            .dashed("predicted", &freq, &[0.1, -1.1, -21.0], &[0.0, -21.0, -151.0])
            .mark(30.0, "crossover");
        assert_eq!(bode.svg().matches("predicted").count(), 1, "one legend for all strips");
        assert!(!bode.svg().contains("coherence"));
        let svg = bode.coherence(&freq, &[1.0, 0.99, 0.9]).svg();
        for word in ["magnitude", "phase", "coherence", "crossover"] {
            assert!(svg.contains(word), "{word}");
        }
    }
}
