//! Sensors: what each one sees of the axes, then its blocks in physical order, then its offset. Without noise and
//! rounding, which `Plant` adds.

use super::model::{AxisModel, SensorBlock};

/// All sensors of a rig.
pub struct SensorSim {
    map: Option<Vec<Vec<f64>>>,
    channels: Vec<Channel>,
    bare_m: Vec<f64>,
    /// Each reads its own axis and adds its offset, no more.
    plain: bool,
}

struct Channel {
    offset_m: f64,
    blocks: Vec<Box<dyn SensorBlock>>,
}

impl SensorSim {
    /// Take the sensors out of the axes' models.
    pub fn new(axes: &mut [AxisModel], map: Option<Vec<Vec<f64>>>) -> Self {
        let channels: Vec<Channel> = axes
            .iter_mut()
            .map(|axis| Channel {
                offset_m: axis.sensor.offset_m,
                blocks: std::mem::take(&mut axis.sensor.blocks),
            })
            .collect();
        let plain = map.is_none() && channels.iter().all(|channel| channel.blocks.is_empty());
        Self { map, bare_m: vec![0.0; channels.len()], channels, plain }
    }

    /// What each sensor adds to the displacement of its own axis, if that is all that any of them does, m.
    pub fn plain_offsets_m(&self) -> Option<impl Iterator<Item = f64>> {
        self.plain.then(|| self.channels.iter().map(|channel| channel.offset_m))
    }

    /// Axes whose displacement sensor `sensor` depends on.
    pub fn axes_of(&self, sensor: usize) -> Vec<usize> {
        let n = self.channels.len();
        let others = self.channels[sensor].blocks.iter().filter_map(|block| block.needs());
        let sensors: Vec<usize> = others.chain([sensor]).collect();
        (0..n).filter(|&axis| sensors.iter().any(|&s| self.sees(s, axis))).collect()
    }

    fn sees(&self, sensor: usize, axis: usize) -> bool {
        match &self.map {
            None => sensor == axis,
            Some(map) => map[sensor][axis] != 0.0,
        }
    }

    /// Whether nothing but the map and the offset lies between the displacements and the reading of a sensor.
    pub fn is_bare(&self, sensor: usize) -> bool {
        self.channels[sensor].blocks.is_empty()
    }

    /// All readings of a sensor that is bare, from the displacements of each axis.
    pub fn bare_readings(
        &self,
        sensor: usize,
        displacement_m: &[&[f64]],
        samples: usize,
    ) -> Vec<f64> {
        let mut readings = match &self.map {
            None => displacement_m[sensor].to_vec(),
            Some(map) => {
                let mut sum = vec![0.0; samples];
                for (weight, axis) in map[sensor].iter().zip(displacement_m) {
                    if *weight != 0.0 {
                        sum.iter_mut().zip(*axis).for_each(|(sum, x)| *sum += weight * *x);
                    }
                }
                sum
            }
        };
        let offset_m = self.channels[sensor].offset_m;
        readings.iter_mut().for_each(|x| *x += offset_m);
        readings
    }

    /// Read the sensors for which `wanted` says so, at session time `time_s`, into `readings_m`.
    #[inline]
    pub fn read(
        &mut self,
        displacement_m: impl Fn(usize) -> f64,
        time_s: f64,
        wanted: impl Fn(usize) -> bool,
        readings_m: &mut [f64],
    ) {
        if !self.plain {
            self.read_all(displacement_m, time_s, wanted, readings_m);
            return;
        }
        for ((sensor, channel), reading_m) in self.channels.iter().enumerate().zip(readings_m) {
            if wanted(sensor) {
                *reading_m = displacement_m(sensor) + channel.offset_m;
            }
        }
    }

    /// `read` in general.
    fn read_all(
        &mut self,
        displacement_m: impl Fn(usize) -> f64,
        time_s: f64,
        wanted: impl Fn(usize) -> bool,
        readings_m: &mut [f64],
    ) {
        let n = self.channels.len();
        match &self.map {
            None => {
                for (axis, bare) in self.bare_m.iter_mut().enumerate() {
                    *bare = displacement_m(axis);
                }
            }
            Some(map) => {
                for (row, bare) in map.iter().zip(&mut self.bare_m) {
                    *bare = (0..n)
                        .filter(|&axis| row[axis] != 0.0)
                        .map(|axis| row[axis] * displacement_m(axis))
                        .sum();
                }
            }
        }
        for (sensor, channel) in self.channels.iter_mut().enumerate() {
            if !wanted(sensor) {
                continue;
            }
            let mut value = self.bare_m[sensor];
            for block in &mut channel.blocks {
                value = block.read(value, &self.bare_m, time_s);
            }
            readings_m[sensor] = value + channel.offset_m;
        }
    }
}
