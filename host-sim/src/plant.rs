//! The plant a tick at a time, with noise and rounding: what a controller, the emulator or the virtual board closes
//! its loop around.

use std::iter::repeat;

use crate::noise::Noise;
use crate::rig::Rig;
use crate::round::nearest;
use crate::simulate::SimError;
use crate::stages::group::Group;
use crate::stages::model::Model;
use crate::stages::sensor::SensorSim;
use crate::start::Initial;

/// How a plant is run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Rate of the ticks, Hz; `None`: the rig's.
    pub sample_rate_hz: Option<f64>,
    /// Seed of the noise.
    pub seed: u64,
    /// Start on the session's clock, s.
    pub start_s: f64,
    /// Whether readings carry noise and rounding.
    pub noise: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { sample_rate_hz: None, seed: 0, start_s: 0.0, noise: true }
    }
}

/// One axis at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// True displacement of the axis, m.
    pub true_m: f64,
    /// Reading of its sensor, m.
    pub sensed_m: f64,
    /// Reading of the amplifier output, V; without noise when the rig has no monitor.
    pub monitor_v: f64,
}

/// A rig being simulated.
///
/// ```
/// use host_sim::{Options, Plant, Rig};
/// let rig = Rig::named("handley").unwrap();
/// let mut plant = Plant::new(&rig, Options::default()).unwrap();
/// for _ in 0..1000 {
///     plant.step(&[60.0, 0.0, 0.0]);
/// }
/// assert!(plant.sample()[0].true_m > 5.0e-6);
/// ```
pub struct Plant {
    groups: Vec<Group>,
    sensors: SensorSim,
    /// Group and slot of each axis.
    place: Vec<(usize, usize)>,
    ports: Vec<Port>,
    /// Whether each sensor reads its own axis and adds its offset, no more.
    plain: bool,
    noise: Option<Noise>,
    samples: Vec<Sample>,
    readings_m: Vec<f64>,
    initial: Vec<Initial>,
    started: bool,
    sampled: bool,
    tick: u64,
    step_s: f64,
    start_s: f64,
}

/// Where an axis is at this tick, and noise and rounding of its two readings.
#[derive(Clone, Copy)]
struct Port {
    position_m: f64,
    output_v: f64,
    /// What its sensor adds if all sensors are plain, m.
    offset_m: f64,
    sensor: Reading,
    monitor: Reading,
}

#[derive(Clone, Copy)]
struct Reading {
    noise_rms: f64,
    resolution: f64,
    /// Steps of the resolution a unit; 0 without rounding.
    steps_per_unit: f64,
}

impl Reading {
    fn new(noise_rms: f64, resolution: f64) -> Self {
        let steps_per_unit = if resolution > 0.0 { resolution.recip() } else { 0.0 };
        Self { noise_rms, resolution, steps_per_unit }
    }

    #[inline]
    fn of(&self, value: f64, noise: &mut Noise) -> f64 {
        let value =
            if self.noise_rms > 0.0 { value + self.noise_rms * noise.draw() } else { value };
        if self.steps_per_unit > 0.0 {
            nearest(value * self.steps_per_unit) * self.resolution
        } else {
            value
        }
    }
}

impl Plant {
    /// Build a rig; at rest, depoled, until the first tick.
    pub fn new(rig: &Rig, options: Options) -> Result<Self, SimError> {
        rig.validate().map_err(|error| SimError(error.to_string()))?;
        let rate = options.sample_rate_hz.unwrap_or(rig.sample_rate_hz);
        if !(1.0..=1.0e6).contains(&rate) {
            return Err(SimError(format!("sample_rate_hz: expected 1 to 1000000, found {rate}")));
        }
        let step_s = 1.0 / rate;
        let mut model = Model::new(rig, step_s);
        let sensors = SensorSim::new(&mut model.axes, model.output_map.take());
        let groups = Group::split(model.axes, &model.springs, step_s, false);
        let n = rig.axes.len();
        let mut place = vec![(0, 0); n];
        for (group, members) in groups.iter().map(|group| &group.members).enumerate() {
            for (slot, &axis) in members.iter().enumerate() {
                place[axis] = (group, slot);
            }
        }
        let plain = sensors.plain_offsets_m().is_some();
        let port = |(axis, offset_m): (&crate::rig::Axis, f64)| Port {
            position_m: 0.0,
            output_v: 0.0,
            offset_m,
            sensor: Reading::new(axis.sensor.noise_rms_m, axis.sensor.resolution_m),
            monitor: axis.monitor.as_ref().map_or(Reading::new(0.0, 0.0), |monitor| {
                Reading::new(monitor.noise_rms_v, monitor.resolution_v)
            }),
        };
        let offsets_m = sensors.plain_offsets_m().into_iter().flatten().chain(repeat(0.0));
        let ports = rig.axes.iter().zip(offsets_m).map(port).collect();
        Ok(Self {
            groups,
            sensors,
            place,
            ports,
            plain,
            noise: options.noise.then(|| Noise::new(options.seed)),
            samples: vec![Sample::default(); n],
            readings_m: vec![0.0; n],
            initial: vec![Initial { amplifier_v: Some(0.0), ..Initial::default() }; n],
            started: false,
            sampled: false,
            tick: 0,
            step_s,
            start_s: options.start_s,
        })
    }

    /// Number of axes.
    pub fn axes(&self) -> usize {
        self.place.len()
    }

    /// Session time of this tick, s.
    pub fn time_s(&self) -> f64 {
        self.start_s + self.tick as f64 * self.step_s
    }

    /// Time from tick to tick, s.
    pub fn step_s(&self) -> f64 {
        self.step_s
    }

    /// State of an axis at this tick.
    pub fn state(&mut self, axis: usize) -> Initial {
        self.start();
        let (group, slot) = self.place[axis];
        self.groups[group].axes()[slot].state()
    }

    /// Begin from this state instead of a rested stack at 0 V. Only before the first tick: later calls restart the
    /// whole plant at this tick.
    pub fn set_initial(&mut self, axis: usize, initial: Initial) {
        self.initial[axis] = initial;
        self.started = false;
        self.sampled = false;
    }

    /// What is read at this tick, before its drive acts. Asked again in the same tick, the answer is the same.
    pub fn sample(&mut self) -> &[Sample] {
        self.start();
        if !self.sampled {
            self.read();
            self.sampled = true;
        }
        &self.samples
    }

    /// Hold a drive (V, one value an axis) to the next tick. A voltage that is not a number counts as 0 V.
    ///
    /// # Panics
    /// When there are fewer voltages than axes.
    pub fn advance(&mut self, drive_v: &[f64]) {
        self.start();
        // The noise of a tick is drawn even if nobody looks at it: the rest of the run does not depend on it.
        self.sample();
        self.tick += 1;
        let time_s = self.time_s();
        let command = |axis: usize| if drive_v[axis].is_finite() { drive_v[axis] } else { 0.0 };
        for group in &mut self.groups {
            group.advance(command, |_| None, time_s);
        }
        self.look();
        self.sampled = false;
    }

    /// `sample`, then `advance`.
    pub fn step(&mut self, drive_v: &[f64]) -> &[Sample] {
        self.advance(drive_v);
        &self.samples
    }

    #[inline]
    fn start(&mut self) {
        if !self.started {
            self.rest();
        }
    }

    #[cold]
    fn rest(&mut self) {
        self.started = true;
        let time_s = self.time_s();
        let initial = &self.initial;
        for group in &mut self.groups {
            let asked = |axis: usize| initial[axis].amplifier_v.unwrap_or(0.0);
            group.start(asked, |axis| &initial[axis], |_| None, time_s);
        }
        self.look();
    }

    /// Take over where every axis is.
    #[inline]
    fn look(&mut self) {
        for group in &self.groups {
            for (axis, &member) in group.axes().iter().zip(&group.members) {
                let port = &mut self.ports[member];
                port.position_m = axis.position_m();
                port.output_v = axis.output_v();
            }
        }
    }

    fn read(&mut self) {
        if self.plain {
            let ports = self.ports.iter().map(|port| (port, port.position_m + port.offset_m));
            read_with(&mut self.noise, &mut self.samples, ports);
            return;
        }
        let (time_s, ports) = (self.time_s(), &self.ports);
        self.sensors.read(|axis| ports[axis].position_m, time_s, |_| true, &mut self.readings_m);
        let ports = self.ports.iter().zip(self.readings_m.iter().copied());
        read_with(&mut self.noise, &mut self.samples, ports);
    }
}

/// Noise and rounding: samples from each axis and what its sensor would read without them (m).
#[inline]
fn read_with<'a>(
    noise: &mut Option<Noise>,
    samples: &mut [Sample],
    ports: impl Iterator<Item = (&'a Port, f64)>,
) {
    for (sample, (port, sensed_m)) in samples.iter_mut().zip(ports) {
        let (true_m, monitor_v) = (port.position_m, port.output_v);
        *sample = match noise {
            None => Sample { true_m, sensed_m, monitor_v },
            Some(noise) => Sample {
                true_m,
                sensed_m: port.sensor.of(sensed_m, noise),
                monitor_v: port.monitor.of(monitor_v, noise),
            },
        };
    }
}
