//! Faults on a schedule, as `cargo xtask emulate --fault` asks for them: `gauge-open:2@20-25` is the gauge of axis 2,
//! broken from 20 s to 25 s of emulated time.

use std::fmt;
use std::str::FromStr;

use anyhow::{Context, Error, Result, bail, ensure};
use clap::ValueEnum;
use flexstage::AXES;

use crate::bench::Bench;
use crate::board::{AmplifierFault, GaugeFault};
use crate::time::{Time, from_seconds, milliseconds};

/// What can be broken, under the name it has on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    GaugeOpen,
    GaugeShort,
    GaugeStuck,
    GaugeNoisy,
    Pushed,
    AmplifierDead,
    AmplifierRailed,
    MonitorOff,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.to_possible_value().map_or(Ok(()), |name| f.write_str(name.get_name()))
    }
}

/// A part that breaks, and when.
#[derive(Clone, Debug, PartialEq)]
pub struct ScheduledFault {
    kind: Kind,
    /// Axis, from 0.
    axis: usize,
    from: Time,
    to: Option<Time>,
    /// Whether it is broken now.
    acts: bool,
}

impl FromStr for ScheduledFault {
    type Err = Error;

    /// `KIND:AXIS@FROM` or `KIND:AXIS@FROM-TO`, axis from 1, times in emulated seconds.
    fn from_str(text: &str) -> Result<Self> {
        let form = || {
            format!("{text:?}: expected KIND:AXIS@FROM or KIND:AXIS@FROM-TO, as gauge-open:2@20-25")
        };
        let (kind, rest) = text.split_once(':').with_context(form)?;
        let (axis, when) = rest.split_once('@').with_context(form)?;
        let Ok(kind) = Kind::from_str(kind, false) else {
            let known: Vec<String> = Kind::value_variants().iter().map(Kind::to_string).collect();
            bail!("{kind:?}: expected one of {}", known.join(", "));
        };
        let axis: usize = axis.parse().ok().with_context(form)?;
        ensure!((1..=AXES).contains(&axis), "axis {axis}: expected 1 to {AXES}");
        let time = |s: &str| -> Result<Time> {
            let s: f64 = s.parse().ok().with_context(form)?;
            ensure!((0.0..=1.0e6).contains(&s), "{s} s: expected 0 to 1000000");
            Ok(from_seconds(s))
        };
        let (from, to) = match when.split_once('-') {
            Some((from, to)) => (time(from)?, Some(time(to)?)),
            None => (time(when)?, None),
        };
        ensure!(to.is_none_or(|to| to > from), "{text:?}: ends before it begins");
        Ok(Self { kind, axis: axis - 1, from, to, acts: false })
    }
}

impl ScheduledFault {
    /// Break or mend what the time asks for, and say so on the terminal.
    pub fn follow(&mut self, bench: &Bench) {
        let now = bench.now();
        let wanted = now >= self.from && self.to.is_none_or(|to| now < to);
        if wanted == self.acts {
            return;
        }
        self.acts = wanted;
        let (kind, axis) = (self.kind, self.axis);
        let what = if wanted { "breaks" } else { "is whole again" };
        println!("{:11.3} ms {kind} of axis {} {what}", milliseconds(now), axis + 1);
        let mut board = bench.board.0.borrow_mut();
        // A gauge freezes at what it read last, mid-scale before the first sample.
        let frozen = board.newest.map_or(crate::board::TOP_CODE / 2, |tick| tick.gauge[axis]);
        let board = &mut *board;
        let (gauge, amplifier) = (&mut board.gauge_fault[axis], &mut board.amplifier_fault[axis]);
        match kind {
            Kind::GaugeOpen => *gauge = wanted.then_some(GaugeFault::Open),
            Kind::GaugeShort => *gauge = wanted.then_some(GaugeFault::Short),
            Kind::GaugeStuck => *gauge = wanted.then_some(GaugeFault::Stuck(frozen)),
            Kind::GaugeNoisy => *gauge = wanted.then_some(GaugeFault::Noisy(5_000)),
            Kind::Pushed => *gauge = wanted.then_some(GaugeFault::Pushed(30.0)),
            Kind::AmplifierDead => *amplifier = wanted.then_some(AmplifierFault::Dead),
            Kind::AmplifierRailed => *amplifier = wanted.then_some(AmplifierFault::Railed(150.0)),
            Kind::MonitorOff => *amplifier = wanted.then_some(AmplifierFault::Monitor(40.0)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_schedule_is_read_as_it_is_written() {
        let fault: ScheduledFault = "gauge-open:2@20-25.5".parse().unwrap();
        let expected = ScheduledFault {
            kind: Kind::GaugeOpen,
            axis: 1,
            from: from_seconds(20.0),
            to: Some(from_seconds(25.5)),
            acts: false,
        };
        assert_eq!(fault, expected);
        let fault: ScheduledFault = "amplifier-dead:3@0".parse().unwrap();
        assert_eq!((fault.axis, fault.to), (2, None));
    }

    #[test]
    fn what_cannot_be_scheduled_is_refused_with_the_reason() {
        for (text, reason) in [
            ("gauge-open", "expected KIND:AXIS@FROM"),
            ("gauge-open:1", "expected KIND:AXIS@FROM"),
            ("gauge-loose:1@2", "expected one of gauge-open"),
            ("gauge-open:4@2", "expected 1 to 3"),
            ("gauge-open:1@5-4", "ends before it begins"),
            ("gauge-open:1@NaN", "expected 0 to"),
        ] {
            let error = text.parse::<ScheduledFault>().unwrap_err().to_string();
            assert!(error.contains(reason), "{text}: {error}");
        }
    }
}
