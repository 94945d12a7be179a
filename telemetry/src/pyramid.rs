//! Min/max pyramid over a bounded stretch of one signal, so that drawing ten minutes costs as much as drawing one second.
//!
//! A plot of width W needs at most two values a pixel column. Level L keeps the smallest and largest of every 16^L
//! samples; a query takes the coarsest level that still has a block a column and merges what is left. Samples are
//! addressed by tick, lost ticks are NaN: the gap stays visible at every level because an all-NaN block has no extent.

/// Samples folded into one block of the next level.
const FOLD: u64 = 16;
/// Levels above the raw samples: blocks of 16, 256 and 4096.
const LEVELS: usize = 3;
/// Capacity is a multiple of the largest block, so that a block is overwritten as a whole.
const LARGEST_BLOCK: u64 = FOLD.pow(LEVELS as u32);

/// Smallest and largest finite value of a stretch; `min > max` when there was none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Smallest value.
    pub min: f32,
    /// Largest value.
    pub max: f32,
}

impl Extent {
    /// The extent of nothing.
    pub const EMPTY: Extent = Extent { min: f32::INFINITY, max: f32::NEG_INFINITY };

    /// Whether no finite value was seen.
    pub fn is_empty(self) -> bool {
        self.min > self.max
    }

    fn add(&mut self, value: f32) {
        // `f32::min` ignores NaN, which is how a lost tick looks.
        self.min = self.min.min(value);
        self.max = self.max.max(value);
    }

    fn merge(&mut self, other: Extent) {
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
    }
}

/// One column of a drawn trace: the stretch's first index and the extent of what lies in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// Index of the first sample of the column.
    pub start: u64,
    /// Number of samples in the column.
    pub len: u64,
    /// What lies in it.
    pub extent: Extent,
}

/// The last `capacity` samples of one signal with their extents.
#[derive(Clone, Debug)]
pub struct Pyramid {
    capacity: u64,
    /// Samples ever pushed: the index of the next one.
    next: u64,
    raw: Vec<f32>,
    levels: [Vec<Extent>; LEVELS],
}

impl Pyramid {
    /// A pyramid that keeps at least `capacity` samples (rounded up to a multiple of 4096).
    pub fn new(capacity: usize) -> Self {
        let capacity = (capacity as u64).max(1).div_ceil(LARGEST_BLOCK) * LARGEST_BLOCK;
        Self { capacity, next: 0, raw: Vec::new(), levels: Default::default() }
    }

    /// Samples that are kept.
    pub fn capacity(&self) -> u64 {
        self.capacity
    }

    /// Forget every sample; indices start at 0 again.
    pub fn clear(&mut self) {
        self.next = 0;
        self.raw.clear();
        self.levels.iter_mut().for_each(Vec::clear);
    }

    /// Index after the newest sample.
    pub fn end(&self) -> u64 {
        self.next
    }

    /// Oldest index that is still whole at every level.
    pub fn start(&self) -> u64 {
        if self.next <= self.capacity {
            0
        } else {
            (self.next - self.capacity).div_ceil(LARGEST_BLOCK) * LARGEST_BLOCK
        }
    }

    /// Bytes held now; never more than `capacity * 4 * 1.15`.
    pub fn bytes(&self) -> usize {
        self.raw.capacity() * size_of::<f32>()
            + self.levels.iter().map(|l| l.capacity() * size_of::<Extent>()).sum::<usize>()
    }

    /// Append a sample; NaN for a lost one.
    pub fn push(&mut self, value: f32) {
        let index = self.next;
        let slot = (index % self.capacity) as usize;
        if slot < self.raw.len() {
            self.raw[slot] = value;
        } else {
            reserve_bounded(&mut self.raw, self.capacity as usize);
            self.raw.push(value);
        }
        let mut block = 1;
        for level in &mut self.levels {
            block *= FOLD;
            let blocks = self.capacity / block;
            let slot = ((index / block) % blocks) as usize;
            if slot == level.len() {
                reserve_bounded(level, blocks as usize);
                level.push(Extent::EMPTY);
            } else if index.is_multiple_of(block) {
                level[slot] = Extent::EMPTY;
            }
            level[slot].add(value);
        }
        self.next += 1;
    }

    /// The sample at an index, NaN when lost, `None` outside what is held.
    pub fn get(&self, index: u64) -> Option<f32> {
        (index < self.next && index + self.capacity >= self.next)
            .then(|| self.raw[(index % self.capacity) as usize])
    }

    /// Raw samples of a stretch, clipped to what is held.
    pub fn slice(&self, from: u64, to: u64) -> Vec<f32> {
        let from = from.max(self.next.saturating_sub(self.capacity));
        (from..to.min(self.next)).map(|i| self.raw[(i % self.capacity) as usize]).collect()
    }

    /// At most about `2 * columns` columns that cover `from..to`, exact in their extremes.
    ///
    /// Columns keep to block borders, so that a scrolling trace does not flicker.
    pub fn columns(&self, from: u64, to: u64, columns: usize) -> Vec<Column> {
        let from = from.max(self.start());
        let to = to.min(self.next);
        if from >= to || columns == 0 {
            return Vec::new();
        }
        let per_column = ((to - from) / columns as u64).max(1);
        // The coarsest level with blocks no wider than a column.
        let level = (0..=LEVELS).rev().find(|&l| FOLD.pow(l as u32) <= per_column).unwrap_or(0);
        let block = FOLD.pow(level as u32);
        let step = per_column / block * block;
        let mut out = Vec::with_capacity(columns + 2);
        let mut start = from / step * step;
        while start < to {
            let mut extent = Extent::EMPTY;
            let stop = (start + step).min(self.next);
            if level == 0 {
                for index in start.max(from)..stop {
                    extent.add(self.raw[(index % self.capacity) as usize]);
                }
            } else {
                let blocks = self.capacity / block;
                for b in start.max(from / block * block) / block..stop.div_ceil(block) {
                    extent.merge(self.levels[level - 1][(b % blocks) as usize]);
                }
            }
            out.push(Column { start, len: step, extent });
            start += step;
        }
        out
    }

    /// Extent of a stretch.
    pub fn extent(&self, from: u64, to: u64) -> Extent {
        let mut all = Extent::EMPTY;
        for column in self.columns(from, to, 64) {
            all.merge(column.extent);
        }
        all
    }
}

/// Grow by doubling as `Vec` does, but never past what will ever be needed.
fn reserve_bounded<T>(vec: &mut Vec<T>, limit: usize) {
    if vec.len() == vec.capacity() {
        let wanted = (vec.len() * 2).max(4096).min(limit);
        vec.reserve_exact(wanted.saturating_sub(vec.len()).max(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_single_spike_survives_at_every_zoom() {
        let mut pyramid = Pyramid::new(1_000_000);
        for i in 0..1_000_000u64 {
            pyramid.push(if i == 654_321 { 9.0 } else { 0.0 });
        }
        for columns in [10, 100, 1500, 100_000] {
            let hit = pyramid
                .columns(0, 1_000_000, columns)
                .into_iter()
                .filter(|c| c.extent.max == 9.0)
                .collect::<Vec<_>>();
            assert_eq!(hit.len(), 1, "{columns} columns");
            assert!((hit[0].start..hit[0].start + hit[0].len).contains(&654_321));
        }
    }

    #[test]
    fn memory_stays_bounded_and_old_samples_go() {
        let mut pyramid = Pyramid::new(10_000);
        for i in 0..200_000 {
            pyramid.push(i as f32);
        }
        assert!(pyramid.bytes() <= 12_288 * 4 * 115 / 100, "{}", pyramid.bytes());
        assert_eq!(pyramid.get(0), None);
        assert_eq!(pyramid.get(199_999), Some(199_999.0));
        assert!(pyramid.end() - pyramid.start() >= 8192);
    }

    #[test]
    fn lost_ticks_leave_an_empty_column() {
        let mut pyramid = Pyramid::new(4096);
        for i in 0..4096 {
            pyramid.push(if (512..1024).contains(&i) { f32::NAN } else { 1.0 });
        }
        let columns = pyramid.columns(0, 4096, 16);
        assert!(columns[2].extent.is_empty() && columns[3].extent.is_empty());
        assert!(!columns[1].extent.is_empty() && !columns[4].extent.is_empty());
    }

    proptest! {
        #[test]
        fn extremes_equal_a_plain_scan(
            n in 1usize..9000, a in 0.0f64..1.0, b in 0.0f64..1.0, columns in 1usize..300, seed in 0u32..1000
        ) {
            let signal = |i: u64| ((i as u32).wrapping_mul(2_654_435_761).wrapping_add(seed) >> 8) as f32;
            let mut pyramid = Pyramid::new(4096);
            for i in 0..n as u64 {
                pyramid.push(signal(i));
            }
            let (lo, hi) = (pyramid.start(), pyramid.end());
            let mut from = lo + ((hi - lo) as f64 * a) as u64;
            let mut to = lo + ((hi - lo) as f64 * b) as u64;
            if from > to { std::mem::swap(&mut from, &mut to); }
            for c in pyramid.columns(from, to, columns) {
                // Columns keep to block borders: they may reach past the asked stretch, never past what is held.
                let scan: Vec<f32> = (c.start.max(lo)..(c.start + c.len).min(hi)).map(signal).collect();
                let max = scan.iter().copied().fold(f32::NEG_INFINITY, f32::max);
                prop_assert!(c.extent.max <= max);
                if c.start >= from && c.start + c.len <= to {
                    let min = scan.iter().copied().fold(f32::INFINITY, f32::min);
                    prop_assert_eq!(c.extent.max, max);
                    prop_assert_eq!(c.extent.min, min);
                }
            }
        }
    }
}
