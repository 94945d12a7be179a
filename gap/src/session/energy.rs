//! Size of the gap before and after, in nanometres, with intervals from a block bootstrap.

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use crate::diagnosis::{AxisGap, Gap};
use crate::session::floor::Kind;
use crate::session::scene::{Channel, Scene, Stack};

/// Energy beyond noise from which a channel has a gap, as a share of the noise's.
pub(crate) const HAS_GAP: f64 = 0.1;
/// Blocks that a channel is cut into for the bootstrap.
const BLOCKS_PER_CHANNEL: usize = 16;
/// Bootstrap draws.
const DRAWS: usize = 600;

/// Energy of one stretch of one channel, nm^2 times samples.
#[derive(Debug, Clone, Copy)]
struct Block {
    axis: usize,
    track: usize,
    before: f64,
    after: f64,
    floor: f64,
    samples: f64,
}

/// Raw residuals (units of the noise) of the channels that `include` lets through, before and after.
pub struct Energies {
    blocks: Vec<Block>,
}

impl Energies {
    /// From raw residual rows as [`Scene::raw`] gives them. Where the memory of the stack is unknown, whitened rows count
    /// instead: a constant that nobody could know is not part of the gap.
    pub fn new(
        scene: &Scene,
        before: &Stack,
        after: &Stack,
        include: &dyn Fn(&Channel) -> bool,
    ) -> Self {
        let mut blocks = Vec::new();
        for (c, channel) in scene.channels.iter().enumerate() {
            if channel.kind != Kind::Position || !include(channel) {
                continue;
            }
            let (Some(b), Some(a)) = (&before[c], &after[c]) else { continue };
            let nm = (channel.sigma * 1.0e3).powi(2);
            let floor = channel.raw_floor() / channel.range.len() as f64;
            let length = b.len().div_ceil(BLOCKS_PER_CHANNEL).max(1);
            for (b, a) in b.chunks(length).zip(a.chunks(length)) {
                let energy =
                    |row: &[f32]| nm * row.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>();
                blocks.push(Block {
                    axis: channel.axis,
                    track: channel.track,
                    before: energy(b),
                    after: energy(a),
                    floor: nm * floor * b.len() as f64,
                    samples: channel.present_share * b.len() as f64,
                });
            }
        }
        Self { blocks }
    }

    fn sums<'b>(blocks: impl Iterator<Item = &'b Block>) -> Block {
        let mut sum =
            Block { axis: 0, track: 0, before: 0.0, after: 0.0, floor: 0.0, samples: 0.0 };
        for b in blocks {
            sum.before += b.before;
            sum.after += b.after;
            sum.floor += b.floor;
            sum.samples += b.samples;
        }
        sum
    }

    /// Before and after of one recording, nm.
    pub fn of_track(&self, track: usize) -> (f64, f64) {
        let sum = Self::sums(self.blocks.iter().filter(|b| b.track == track));
        let n = sum.samples.max(1.0);
        ((sum.before / n).sqrt(), (sum.after / n).sqrt())
    }

    /// The figures of `diagnosis.json`.
    pub fn gap(&self, axes: usize) -> Gap {
        let sum = Self::sums(self.blocks.iter());
        let n = sum.samples.max(1.0);
        let mut rng = StdRng::seed_from_u64(0x6761_7000);
        let mut draws: Vec<f64> = (0..DRAWS)
            .map(|_| {
                let drawn = (0..self.blocks.len())
                    .map(|_| &self.blocks[rng.random_range(0..self.blocks.len())]);
                closed(&Self::sums(drawn))
            })
            .collect();
        draws.sort_by(f64::total_cmp);
        let at = |q: f64| {
            draws.get(((draws.len() as f64 - 1.0) * q).round() as usize).copied().unwrap_or(0.0)
        };
        Gap {
            before_nm: (sum.before / n).sqrt(),
            after_nm: (sum.after / n).sqrt(),
            floor_nm: (sum.floor / n).sqrt(),
            closed: closed(&sum),
            closed_ci95: [at(0.025), at(0.975)],
            per_axis: (0..axes)
                .filter_map(|axis| {
                    let sum = Self::sums(self.blocks.iter().filter(|b| b.axis == axis));
                    (sum.samples > 0.0).then(|| AxisGap {
                        axis: axis + 1,
                        before_nm: (sum.before / sum.samples).sqrt(),
                        after_nm: (sum.after / sum.samples).sqrt(),
                        floor_nm: (sum.floor / sum.samples).sqrt(),
                        closed: closed(&sum),
                    })
                })
                .collect(),
        }
    }

    /// Energy that is gone afterwards, by axis, nm^2 times samples.
    pub fn closed_on(&self, axes: usize) -> Vec<f64> {
        let mut closed = vec![0.0; axes];
        for block in &self.blocks {
            closed[block.axis] += block.before - block.after;
        }
        closed.iter().map(|energy| energy.max(0.0)).collect()
    }

    /// Energy beyond the floor before and after, nm^2 times samples.
    pub fn excess(&self) -> (f64, f64) {
        let sum = Self::sums(self.blocks.iter());
        (sum.before - sum.floor, sum.after - sum.floor)
    }
}

/// Energy of what the positions differ by between two simulations, by axis, nm^2 times samples. Both as [`Scene::raw`] gives them.
pub(crate) fn moved_on(scene: &Scene, from: &Stack, to: &Stack, axes: usize) -> Vec<f64> {
    let mut moved = vec![0.0; axes];
    for (channel, rows) in scene.channels.iter().zip(from.iter().zip(to)) {
        let (Kind::Position, (Some(from), Some(to))) = (channel.kind, rows) else { continue };
        let nm = (channel.sigma * 1.0e3).powi(2);
        let squares = from.iter().zip(to).map(|(&a, &b)| f64::from(b - a).powi(2));
        moved[channel.axis] += nm * squares.sum::<f64>();
    }
    moved
}

/// `1 - (after^2 - floor^2) / (before^2 - floor^2)`; zero where there was no gap to close.
fn closed(sum: &Block) -> f64 {
    let before = sum.before - sum.floor;
    // A gap of less than a thousandth of the noise energy has no meaningful share.
    if before <= 1.0e-3 * sum.floor { 0.0 } else { 1.0 - (sum.after - sum.floor) / before }
}
