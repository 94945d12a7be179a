//! The arbitrary waveform.

use super::waves::clip_q30;
use crate::TABLE_POINTS;
use crate::math::ONE_Q30;
use crate::settings::{Check, SettingsError};

/// Arbitrary waveform: up to 1024 points over one period.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    points: [i32; TABLE_POINTS],
    len: u32,
}

impl Table {
    /// A flat line.
    pub const EMPTY: Self = Self { points: [0; TABLE_POINTS], len: 0 };

    /// Take over the points of one period, each from -1 to 1. Nothing changes if one of them is not.
    pub fn set(&mut self, points: &[f32]) -> Result<(), SettingsError> {
        let check = Check::new("table");
        check.range("points", points.len() as f32, 4.0, TABLE_POINTS as f32, "points")?;
        self.write(0, points)?;
        self.set_len(points.len())
    }
    /// Take over some points, each from -1 to 1, from index `offset` on; the number of points in use stays. Nothing changes if one
    /// of them cannot be used.
    pub fn write(&mut self, offset: usize, points: &[f32]) -> Result<(), SettingsError> {
        let check = Check::new("table");
        let end = offset.saturating_add(points.len());
        check.range("points", end as f32, 0.0, TABLE_POINTS as f32, "points")?;
        for point in points {
            check.range("points", *point, -1.0, 1.0, "of the amplitude")?;
        }
        for (to, from) in self.points.iter_mut().skip(offset).zip(points) {
            *to = (from * ONE_Q30 as f32) as i32;
        }
        Ok(())
    }
    /// Use this many points.
    pub fn set_len(&mut self, len: usize) -> Result<(), SettingsError> {
        let check = Check::new("table");
        check.range("points", len as f32, 4.0, TABLE_POINTS as f32, "points")?;
        self.len = len as u32;
        Ok(())
    }
    /// Number of points.
    pub fn len(&self) -> usize {
        self.len as usize
    }
    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    #[inline(always)]
    fn point(&self, index: u32) -> i64 {
        let index = if index >= self.len { index.wrapping_sub(self.len) } else { index };
        match self.points.get(index as usize) {
            Some(point) => *point as i64,
            None => 0,
        }
    }

    /// Catmull-Rom interpolation: through every point, velocity continuous.
    #[inline(always)]
    pub(super) fn at(&self, phase: u32) -> i32 {
        let place = phase as u64 * self.len as u64;
        let index = (place >> 32) as u32;
        let t = ((place as u32) >> 2) as i64; // Q30
        let p0 = self.point(index.wrapping_add(self.len).wrapping_sub(1));
        let p1 = self.point(index);
        let p2 = self.point(index.wrapping_add(1));
        let p3 = self.point(index.wrapping_add(2));
        // Horner of p1 + t/2 (p2 - p0 + t (2p0 - 5p1 + 4p2 - p3 + t (3p1 - p0 - 3p2 + p3))); each bracket < 2^34.
        let c3 = 3 * (p1 - p2) + p3 - p0;
        let c2 = 2 * p0 - 5 * p1 + 4 * p2 - p3;
        // Operands are reduced to 33 bits before the products, which therefore fit 63.
        let inner = c2 + (((c3 >> 2) * t) >> 28);
        let slope = (p2 - p0) + (((inner >> 2) * t) >> 28);
        clip_q30(p1 + (((slope >> 2) * t) >> 29))
    }
}
